"""The faults that the benchmark of the doctor makes."""

from toy_rgbd import CAMERA
from toy_stereo import toy_rig

from benchmarks.doctor import depth_faults, pair_faults
from stereo.depth import Depths
from stereo.doctor.hypotheses import HYPOTHESES
from stereo.recording import DepthCamera


def test_every_fault_is_made_under_the_name_of_a_hypothesis_and_hardly_a_hypothesis_is_left_out() -> None:
    head = DepthCamera(CAMERA, "", "structured-light", lambda depth: depth, None, Depths())
    made = {fault.name for fault in (*pair_faults(toy_rig()), *depth_faults(head))} - {""}
    names = {hypothesis.name for hypothesis in HYPOTHESES}
    assert made <= names
    left_out = {name for name in names - made if "not registered" not in name}
    assert left_out == {f"the camera lies on its {side} side" for side in ("left", "right")} | {
        "depth counts 1000 values per metre"
    }
