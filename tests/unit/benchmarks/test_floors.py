"""Floors that are little of the picture."""

import pytest

from benchmarks.floors import ANGLE_OFF_DEG, HEIGHT_OFF_M, errors_of, floor_of, low_room


@pytest.mark.parametrize("seed", [1, 11], ids=["nobody moves", "somebody walks"])
def test_floor_of_a_level_camera_is_found_among_larger_walls(seed: int) -> None:
    room = low_room(seed)
    assert room.share < 0.07
    height_m, angle_deg = errors_of(floor_of(room), room.floor)
    assert height_m < HEIGHT_OFF_M and angle_deg < ANGLE_OFF_DEG
