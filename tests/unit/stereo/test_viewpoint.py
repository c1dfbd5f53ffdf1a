"""Cameras that look elsewhere than before, that shake, or that stand still, whatever people and light hide."""

from itertools import cycle, islice

import cv2
import numpy as np
import pytest

from calib.types import U8
from stereo.viewpoint import STANDS, Standing, Sway, Viewpoints, view_of_most

WIDTH, FOCAL_WIDTHS = 640, 0.8
DEGREE_PX = WIDTH * FOCAL_WIDTHS * np.tan(np.radians(1.0))


def room(right_px: float = 0.0, down_px: float = 0.0, person_px: int = 0) -> U8:
    """(480, 640) uint8 patches of grey, moved, with a plain person of some width in front."""
    coarse = np.random.default_rng(3).integers(60, 200, (60, 80), dtype=np.uint8)
    whole = cv2.resize(coarse, (800, 600), interpolation=cv2.INTER_CUBIC)
    move = np.array([[1.0, 0.0, right_px - 80.0], [0.0, 1.0, down_px - 60.0]])
    image = cv2.warpAffine(whole, move, (WIDTH, 480))
    image[:, 200 : 200 + person_px] = 90
    return image


STILL = Viewpoints([(room(), room())], FOCAL_WIDTHS)


Shot = tuple[U8, ...]
BLANK = (np.zeros((480, WIDTH), np.uint8),) * 2


def turned(degrees: float, axis: tuple[float, float, float] = (0.0, 1.0, 0.0), zoom: float = 1.0) -> U8:
    """(480, 640) uint8 of the room when the camera has turned and zoomed."""
    focal_px = WIDTH * FOCAL_WIDTHS
    pinhole = np.array([[focal_px, 0.0, WIDTH / 2], [0.0, focal_px, 240.0], [0.0, 0.0, 1.0]])
    rotation, _ = cv2.Rodrigues(-np.radians(degrees) * np.array(axis))
    move = pinhole @ np.diag([zoom, zoom, 1.0]) @ rotation @ np.linalg.inv(pinhole)
    return cv2.warpPerspective(room(), move, (WIDTH, 480))


def moved(shot: Shot, viewpoints: Viewpoints = STILL) -> str | None:
    """How a lasting shot is of another view, in words; None where it cannot be said."""
    turns = viewpoints.turns(shot)
    return None if turns is None else STANDS.move(turns, turns)


@pytest.mark.parametrize(
    ("left", "right", "said"),
    [
        (room(), room(), ""),
        (room(person_px=300), room(person_px=300), ""),
        (room() // 2, room() // 2 + 100, ""),
        (room(1.0), room(1.0), ""),  # a mast in the wind
        (room(3 * DEGREE_PX), room(3 * DEGREE_PX), "the cameras have rotated by 3 degrees"),
        (room(), room(down_px=2.0), "the right camera has rotated by 0.22 degrees"),
        (room(2.0, person_px=200), room(), "the left camera has rotated by 0.22 degrees"),
    ],
    ids=["still", "person", "other light", "sway", "both", "right", "left"],
)
def test_camera_that_has_rotated_is_named(left, right, said):
    assert moved((left, right)) == said


@pytest.mark.parametrize("degrees", [1.0, 2.0, 5.0, 10.0, 18.0])
@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)], ids=["pan", "tilt", "roll"])
def test_angle_of_a_camera_that_has_turned_is_measured(degrees, axis):
    if axis[2] and degrees > 5.0:
        pytest.skip("corners are followed through small rolls only")
    turns = Viewpoints([(room(),)], FOCAL_WIDTHS).turns((turned(degrees, axis),))
    np.testing.assert_allclose(np.degrees(turns[0, :3]), np.multiply(degrees, axis), atol=0.05 * degrees + 0.02)


def test_zoom_is_named():
    assert moved((turned(0.0, zoom=1.05),) * 2) == "the cameras have zoomed by 5.0%"


def test_dark_or_other_images_say_nothing():
    other = np.random.default_rng(4).integers(0, 255, (480, WIDTH), dtype=np.uint8)
    assert moved((np.zeros_like(other), room())) is None
    assert moved((other, other)) is None


def test_shots_of_the_view_that_most_show_are_kept():
    before, after = (room(), room()), (room(), room(4.0))
    view = view_of_most([before] * 5 + [after] * 3, FOCAL_WIDTHS)
    assert view.usual == [0, 1, 2, 3, 4]
    assert view.elsewhere == dict.fromkeys([5, 6, 7], "the right camera has rotated by 0.45 degrees")


def test_shots_of_another_place_show_another_view():
    other = np.ascontiguousarray(room()[::-1, ::-1])
    view = view_of_most([(room(),)] * 5 + [(other,)] * 3, FOCAL_WIDTHS)
    assert view.usual == [0, 1, 2, 3, 4]
    assert view.elsewhere == dict.fromkeys([5, 6, 7], "the camera shows another view")


def test_shots_of_a_camera_that_shakes_are_of_one_view():
    swings = islice(cycle([0.0, 0.6, 0.1, -0.5, 0.3, -0.6]), 24)
    view = view_of_most([(turned(degrees),) * 2 for degrees in swings], FOCAL_WIDTHS)
    assert (len(view.usual), view.elsewhere) == (24, {})
    assert 0.2 < view.sway.together_deg < 0.6


BLANKS = {"black": 0, "grey": 128, "white": 255}


@pytest.mark.parametrize("level", BLANKS.values(), ids=BLANKS)
@pytest.mark.parametrize("blank_at", [0, 3, 12], ids=["first", "middle", "last"])
def test_blank_shot_is_of_no_view(level, blank_at):
    shots = [(room(), room())] * 7 + [(room(4.0), room(4.0))] * 5
    blank = np.full((480, WIDTH), level, np.uint8)
    shots.insert(blank_at, (blank, blank))
    view = view_of_most(shots, 0.3)
    seen = [number for number in range(len(shots)) if number != blank_at]
    assert (view.usual, [*view.elsewhere]) == (seen[:7], seen[7:])


def test_all_shots_are_kept_where_none_shows_another_view():
    blank, seen = (np.full((480, WIDTH), 128, np.uint8),), (room(),)
    view = view_of_most([blank, seen, blank, seen], FOCAL_WIDTHS)
    assert (view.usual, view.elsewhere) == ([0, 1, 2, 3], {})


def watch(standing: Standing, shots: list[Shot], fps: float = 10.0) -> list[bool]:
    return [standing.update(frame, frame / fps, shot) for frame, shot in enumerate(shots)]


def test_standing_names_the_first_frame_of_another_view_until_the_first_is_back():
    standing = Standing(STILL)
    stands = watch(standing, [(room(), room())] * 20 + [(room(20.0), room(20.0))] * 20 + [(room(), room())] * 20)
    assert stands[:20] == [True] * 20
    assert stands[25:40] == [False] * 15
    assert stands[55:] == [True] * 5
    assert 20 <= standing.first[0] <= 25
    assert standing.how == "the cameras have rotated by 2.2 degrees"
    assert standing.moved_frames + standing.swayed_frames == stands.count(False)


def test_standing_holds_what_it_saw_while_too_little_shows():
    away = (room(20.0), room(20.0))
    assert watch(Standing(STILL), [(room(), room())] * 10 + [BLANK] * 30) == [True] * 40
    assert watch(Standing(STILL), [away] * 20 + [BLANK] * 30)[10:] == [False] * 40


@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0)], ids=["pan", "roll"])
@pytest.mark.parametrize("swing_deg", [0.3, 0.5, 0.8])
def test_camera_that_shakes_stands(swing_deg, axis):
    standing = Standing(STILL)
    swings = islice(cycle([0.0, 1.0, 0.3, -1.0, -0.3]), 40)
    assert all(watch(standing, [(turned(swing_deg * swing, axis),) * 2 for swing in swings], fps=4.0))
    assert standing.sway.together_deg == pytest.approx(0.51 * swing_deg, rel=0.25)


@pytest.mark.parametrize("cameras", [1, 2])
def test_camera_that_swings_out_of_its_view_is_paused_until_it_is_back(cameras):
    standing = Standing(Viewpoints([(room(),) * cameras], FOCAL_WIDTHS))
    swings = [0.0] * 11 + [1.5, -1.5, 0.7] + [0.2] * 19
    stands = watch(standing, [(turned(degrees),) * cameras for degrees in swings])
    assert stands == [True] * 11 + [False] * 3 + [True] * 19
    assert (standing.swayed_frames, standing.first) == (3, None)


def test_camera_that_stands_has_no_sway():
    standing = Standing(STILL)
    watch(standing, [(room(), room())] * 20)
    assert standing.sway == Sway(0.0, 0.0)


def test_shaking_camera_that_turns_for_good_is_named():
    standing = Standing(STILL)
    swings = [*islice(cycle([0.3, -0.3]), 20), *islice(cycle([2.3, 1.7]), 12)]
    stands = watch(standing, [(turned(degrees),) * 2 for degrees in swings], fps=4.0)
    assert stands[:20] == [True] * 20
    assert stands[24:] == [False] * 8


def test_scene_that_changes_bit_by_bit_is_one_view():
    other = np.ascontiguousarray(room()[:, ::-1])
    shots = list[Shot]()
    for column in range(0, WIDTH, 20):
        image = room()
        image[:, :column] = other[:, :column]
        shots.append((image, image))
    assert all(watch(Standing(STILL), [*shots, *[(other, other)] * 10], fps=4.0))


def test_resumed_standing_goes_on_with_the_view_that_it_has_accepted():
    standing, resumed = (Standing(Viewpoints([], FOCAL_WIDTHS)) for _ in range(2))
    watch(standing, [(room(),)] * 10)
    resumed.set_state(standing.state())
    later = [(room(20.0),)] * 10
    for frame, shot in enumerate(later, start=10):
        assert resumed.update(frame, frame / 10, shot) == standing.update(frame, frame / 10, shot)
    assert (resumed.first, resumed.how) == (standing.first, "the camera has rotated by 2.2 degrees")
