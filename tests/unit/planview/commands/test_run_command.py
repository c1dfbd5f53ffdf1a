"""Which calibration ``planview run`` takes for that of one camera."""

from pathlib import Path

import pytest
from toy_stereo import toy_rig

from calib.formats import write_rig
from calib.ground_camera import GroundCamera, save_ground_camera
from planview.commands.run import TrackingOptions, _is_of_one_camera


@pytest.mark.parametrize("name", ["camera.toml", "street.toml"])
def test_a_camera_above_the_floor_is_known_by_its_keys(tmp_path: Path, name: str) -> None:
    save_ground_camera(GroundCamera(320, 240, 200.0, 3.0, 0.8), tmp_path / name)
    assert _is_of_one_camera(tmp_path / name, TrackingOptions(tracker="ellipse-particle"))


def test_a_rig_is_that_of_a_pair_but_to_a_tracker_of_one_camera(tmp_path: Path) -> None:
    write_rig(toy_rig(), tmp_path / "rig.toml", "rig")
    assert not _is_of_one_camera(tmp_path / "rig.toml", TrackingOptions())
    assert not _is_of_one_camera(tmp_path, TrackingOptions())
    assert _is_of_one_camera(tmp_path / "rig.toml", TrackingOptions(tracker="human-model"))
