"""Cameras that look elsewhere than before: both of a head, one of them, or none, whatever people hide."""

import cv2
import numpy as np
import pytest

from calib.types import U8
from stereo.viewpoint import Standing, Viewpoints, of_one_viewpoint

WIDTH, FOCAL_WIDTHS = 640, 0.8
DEGREE_PX = WIDTH * FOCAL_WIDTHS * np.tan(np.radians(1.0))


def room(right_px: float = 0.0, down_px: float = 0.0, person_px: int = 0) -> U8:
    """(480, 640) uint8 patches of grey, moved, with a plain person of some width in front."""
    coarse = np.random.default_rng(3).integers(60, 200, (60, 80), dtype=np.uint8)
    whole = cv2.resize(coarse, (800, 600), interpolation=cv2.INTER_CUBIC)
    move = np.array([[1.0, 0.0, right_px - 80.0], [0.0, 1.0, down_px - 60.0]])
    image = np.asarray(cv2.warpAffine(whole, move, (WIDTH, 480)), dtype=np.uint8)
    image[:, 200 : 200 + person_px] = 90
    return image


STILL = Viewpoints([(room(), room())], FOCAL_WIDTHS)


@pytest.mark.parametrize(
    ("left", "right", "said"),
    [
        (room(), room(), ""),
        (room(person_px=300), room(person_px=300), ""),
        (room(1.0), room(1.0), ""),  # a mast in the wind
        (room(3 * DEGREE_PX), room(3 * DEGREE_PX), "the cameras have rotated by 3 degrees"),
        (room(), room(down_px=2.0), "the right camera has rotated by 0.22 degrees"),
        (room(2.0, person_px=200), room(), "the left camera has rotated by 0.22 degrees"),
    ],
    ids=["still", "person", "sway", "both", "right", "left"],
)
def test_camera_that_has_rotated_is_named(left: U8, right: U8, said: str) -> None:
    assert STILL.moved((left, right)) == said


def test_dark_or_other_images_say_nothing() -> None:
    other = np.random.default_rng(4).integers(0, 255, (480, WIDTH), dtype=np.uint8)
    assert STILL.moved((np.zeros_like(other), room())) is None and STILL.moved((other, other)) is None


def test_shots_of_the_view_that_most_show_are_kept() -> None:
    before, after = (room(), room()), (room(), room(4.0))
    usual, others = of_one_viewpoint([before, after, before], FOCAL_WIDTHS)
    assert usual == [0, 2] and others == {1: "the right camera has rotated by 0.45 degrees"}


BLANK = {"black": 0, "grey": 128, "white": 255}


@pytest.mark.parametrize("level", BLANK.values(), ids=BLANK)
@pytest.mark.parametrize("blank_at", [0, 2, 4], ids=["first", "middle", "last"])
def test_blank_shot_is_of_no_view_and_hides_none(level: int, blank_at: int) -> None:
    shots = [(room(), room())] * 3 + [(room(4.0), room(4.0))] * 2
    blank = np.full((480, WIDTH), level, np.uint8)
    shots.insert(blank_at, (blank, blank))
    usual, others = of_one_viewpoint(shots, 0.3)
    seen = [number for number in range(len(shots)) if number != blank_at]
    assert (usual, [*others]) == (seen[:3], seen[3:])


def test_all_shots_are_kept_where_none_shows_another_view() -> None:
    blank, seen = (np.full((480, WIDTH), 128, np.uint8),), (room(),)
    assert of_one_viewpoint([blank, seen, blank, seen], FOCAL_WIDTHS) == ([0, 1, 2, 3], {})


def test_standing_names_the_first_frame_and_holds_what_it_saw_while_too_little_shows() -> None:
    standing, dark = Standing(STILL), (np.zeros((480, WIDTH), np.uint8),) * 2
    shots = [(room(), room()), (room(20.0), room(20.0)), dark, (room(), room()), dark]
    found = [standing.update(k, k / 10, shot) for k, shot in enumerate(shots)]
    assert found == [True, False, False, True, True]
    assert standing.first == (1, 0.1) and standing.moved_frames == 2
    assert standing.how == "the cameras have rotated by 2.2 degrees"
