import math

import numpy as np
import pytest
from toy_tracks import positions_table

from calib.errors import InputError
from calib.ground_camera import GroundCamera
from calib.types import U8
from planview.drawing.image import ImagePainter
from planview.drawing.people import ARROW_M, AXIS_M, Snapshot, facing_line, snapshot_at
from planview.drawing.plan import PlanBounds, PlanPainter, bounds_of
from planview.drawing.rules import Rule, rules_of
from planview.drawing.style import STRIP_PX, Entry, Labels, as_bgr, with_legend
from planview.trajectories.plot import person_rgb
from planview.trajectories.state import TrackState

CAMERA = GroundCamera(640, 480, 500.0, 3.0, math.radians(60))
GREY: U8 = np.full((480, 640, 3), 128, np.uint8)


def has(picture: U8, colour: tuple[int, int, int]) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    return (picture == as_bgr(colour)).all(axis=2)


RGB = np.array([person_rgb(i) for i in range(1, 60)], float)


def test_colours_of_neighbouring_ids_are_far_apart():
    assert np.abs(np.diff(RGB, axis=0)).sum(axis=1).min() > 100


def test_colours_of_people_are_legible_on_white():
    assert (RGB @ (0.299, 0.587, 0.114)).max() < 155


def test_box_is_drawn_in_the_colour_of_the_id_where_the_track_says_also_in_an_enlarged_image():
    person = TrackState(3, "confirmed", box_px=(100, 50, 60, 200))
    found = has(ImagePainter(None)(GREY, Snapshot(0, 0.0, [person])), person_rgb(3))
    rows, cols = np.nonzero(found)
    assert (cols.min(), rows.max()) == pytest.approx((99, 251), abs=1)
    assert not found[100:240, 110:150].any()
    person = TrackState(3, "confirmed", box_px=(50, 25, 30, 100))
    picture = ImagePainter(None)(GREY[::2, ::2].copy(), Snapshot(0, 0.0, [person]))
    assert picture.shape == GREY.shape
    assert np.nonzero(has(picture, person_rgb(3)))[1].min() == pytest.approx(99, abs=1)


def test_metre_grid_passes_through_the_pixel_of_its_crossing():
    plain = ImagePainter(CAMERA)(GREY, Snapshot(0, 0.0, []))
    gridded = ImagePainter(CAMERA, bounds=PlanBounds(-2, 3, 2, 8))(GREY, Snapshot(0, 0.0, []))
    at = np.round(CAMERA.project(np.array([1.0, 5.0, 0.0]))).astype(int)
    assert (plain == 128).all()
    assert gridded[at[1], at[0], 0] > 150


def test_rule_beyond_the_view_draws_nothing():
    behind = Rule("gate", True, True, np.array([(-1.0, -50.0), (1.0, -50.0)]))
    assert (ImagePainter(CAMERA, [behind])(GREY, Snapshot(0, 0.0, [])) == 128).all()


def test_labels_do_not_cover_one_another():
    picture = np.zeros((100, 200, 3), np.uint8)
    labels = Labels(picture)
    labels.put("11", (50, 60), (255, 0, 0))
    labels.put("22", (50, 60), (0, 255, 0))
    blue, green = ((picture[..., c] > 200) & (picture.sum(axis=2) < 300) for c in (2, 1))
    assert blue.sum() == pytest.approx(green.sum(), rel=0.3)


def test_moment_holds_everything_of_one_frame():
    frame, ids = np.array([0, 0, 1, 1, 2]), np.array([1, 2, 1, 2, 1])
    tracks = positions_table(frame, ids, np.arange(10.0).reshape(5, 2), timestamp_s=frame / 10)
    snapshot = snapshot_at(tracks, 1, 5, tracks)
    assert [person.track_id for person in snapshot.people] == [1, 2]
    assert snapshot.trails[1].tolist() == [[0, 1], [4, 5]]
    assert (snapshot.time_s, len(snapshot.truth)) == (0.1, 2)
    tracks.state[2] = "tentative"
    assert [person.track_id for person in snapshot_at(tracks, 1, 5).people] == [2]


def test_plan_view_shows_a_person_at_the_place_within_a_margin():
    paint = PlanPainter(PlanBounds(0, 0, 10, 10), (200, 200))
    found = has(paint(Snapshot(0, 0.0, [TrackState(4, "confirmed", 7.0, 2.0)])), person_rgb(4))
    assert found[160, 140]
    bounds = bounds_of(np.array([(0.0, 1.0), (np.nan, 2.0)]), np.array([(4.0, 3.0)]))
    assert (bounds.x_min_m, bounds.y_max_m) == pytest.approx((-0.6, 3.6))


def test_a_line_without_a_head_shows_the_axis_of_somebody_who_may_be_back_to_front():
    person = TrackState(4, "confirmed", 1.0, 5.0, facing_deg=90.0, facing_confidence=0.89)
    line = facing_line(person)
    assert line.tolist() == [[1.0, 5.0 - AXIS_M], [1.0, 5.0 + AXIS_M]]
    painter = PlanPainter(PlanBounds(0, 4, 2, 6), (200, 200))
    seen = has(painter(Snapshot(0, 0.0, [person])), person_rgb(4))
    assert seen[70, 100]
    assert seen[130, 100]
    assert not seen[75, 95:99].any()


def test_arrow_points_from_a_person_to_where_the_chest_does():
    person = TrackState(4, "confirmed", 1.0, 5.0, facing_deg=90.0)
    arrow = facing_line(person)
    assert arrow.tolist() == [[1.0, 5.0], pytest.approx([1.0, 5.0 + ARROW_M])]
    assert facing_line(TrackState(4, "confirmed", 1.0, 5.0)) is None
    above = has(PlanPainter(PlanBounds(0, 4, 2, 6), (200, 200))(Snapshot(0, 0.0, [person])), person_rgb(4))
    assert above[60, 100]
    assert not above[140, 100]
    assert not above[100, 140]
    seen = has(ImagePainter(CAMERA)(GREY, Snapshot(0, 0.0, [person])), person_rgb(4))
    at = np.round(CAMERA.project(np.array([1.0, 5.25, 0.0]))).astype(int)
    assert seen[at[1], at[0]]


def test_rules_of_counts_are_drawn_as_they_were_given():
    counts = {"gate": {"kind": "tripwire", "plane": "floor", "points": [[0, 0], [1, 0]]}, "q": {"kind": "queue"}}
    (rule,) = rules_of(counts)
    assert (rule.name, rule.is_line, rule.on_floor) == ("gate", True, True)


@pytest.mark.parametrize("points", [[[0, 1e308], [1, 1]], [[0, 1], [2]], "x", [[0, "a"]]])
def test_points_that_no_rule_has_are_refused(points):
    with pytest.raises(InputError, match="rule 'a'"):
        rules_of({"a": {"kind": "zone", "plane": "floor", "points": points}})


def test_legend_lies_below_the_picture():
    picture = np.full((50, 300), 128, np.uint8)
    shown = with_legend(picture, [Entry((255, 0, 0), "above"), Entry((0, 0, 255), "below")])
    assert shown.shape == (50 + STRIP_PX, 300, 3)
    assert (shown[:50] == 128).all()
    assert all((shown[50:] == colour).all(axis=2).any() for colour in ((0, 0, 255), (255, 0, 0)))


def test_long_legend_goes_on_in_another_strip():
    picture = np.zeros((50, 120, 3), np.uint8)
    assert with_legend(picture, [Entry((9, 9, 9), "a long meaning")] * 3).shape[0] == 50 + 3 * STRIP_PX
