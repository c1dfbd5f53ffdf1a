"""How a long rerun recording is kept small."""

import pytest

from planview.output.rerun.parts import DOUBLED_MAX, rarer


@pytest.mark.parametrize(("written", "step"), [(0, 1), (499, 1), (500, 2), (750, 4), (875, 8)])
def test_images_become_rarer_whenever_half_of_the_room_left_is_used(written: int, step: int) -> None:
    assert rarer(written, room=1000) == step


def test_images_stay_when_the_room_is_used_up() -> None:
    assert rarer(5000, room=1000) == 2**DOUBLED_MAX
