import numpy as np
import pytest
from toy_stereo import ToyWorld, toy_rig

from benchmarks.correction import head_error_m
from calib.rig import Floor
from stereo.rectify import Rectifier


def test_heads_are_where_they_are_by_the_true_rig_and_off_by_another() -> None:
    true, floor = toy_rig(), Floor(ToyWorld().world_SE3_left)
    assert head_error_m(true, floor, Rectifier(true), floor) == pytest.approx(0.0, abs=1e-9)
    longer = toy_rig(baseline_m=0.132)  # a tenth more of baseline puts all a tenth farther away
    assert 0.1 < head_error_m(true, floor, Rectifier(longer), floor) < 0.6
    assert np.isfinite(head_error_m(true, floor, Rectifier(toy_rig(rotation_deg=(0.0, 0.0, 0.3))), floor))
