"""Counting: rules, totals, tables."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_tracks import positions_table

from calib.camera import Camera
from calib.errors import InputError
from calib.ground_camera import GroundCamera
from calib.pose import SE3
from calib.rig import Floor, StereoRig, save_rig
from calib.world import save_world
from planview.counting.events import Direction, Event
from planview.counting.rules import (
    AnalyticsParams,
    Outline,
    RulePlane,
    Rules,
    load_rules,
    parse_rules,
    plane_of,
)
from planview.counting.stream import Analytics
from planview.counting.totals import INTERVALS_MAX, count_tracks, crossing_scores, occupancy_groups
from planview.trajectories.clock import Clock
from planview.trajectories.state import TrackState
from planview.trajectories.table import Trajectories, TrajectoryCollector, row_states, table_of
from stereo.depth import RectifiedGeometry

CAMERA = GroundCamera(640, 480, 500.0, 3.0, math.radians(60))
SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])


def rules_file(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "rules.toml"
    path.write_text(text)
    return path


WIRE = '[[tripwire]]\nname = "door"\nfrom_m = [0, 0]\nto_m = [2, 0]\n'
ZONE = '[[zone]]\nname = "till"\npolygon_m = [[0, 0], [2, 0], [2, 2]]\n'


def test_rules_keep_metres_as_they_are(tmp_path):
    rules = load_rules(rules_file(tmp_path, WIRE + ZONE + '[queue]\nname = "q"\nzone = "till"\n'))
    assert rules.names == ["door", "till", "q"]
    assert rules.tripwires[0].plane == "floor"
    np.testing.assert_array_equal(rules.tripwires[0].points, [[0, 0], [2, 0]])


def test_zone_may_repeat_its_first_point():
    zone = {"name": "z", "polygon_m": [[0, 0], [2, 0], [2, 2], [0, 2], [0, 0]]}
    assert len(load_rules({"zone": [zone]}).zones[0].points) == 4


def test_zone_may_surround_the_whole_view():
    zone = {"name": "all", "polygon_m": [[-500, -500], [500, -500], [500, 500], [-500, 500]]}
    assert parse_rules({"zone": [zone]}, RulePlane(GroundCamera(640, 480, 500.0, 3.0, 0.0)), "r").zones


def placed_wire(plane: RulePlane, from_px: list[float], to_px: list[float]) -> Any:
    return parse_rules({"tripwire": [{"name": "w", "from_px": from_px, "to_px": to_px}]}, plane, "r").tripwires[0]


def test_pixels_go_to_the_floor_of_a_known_camera():
    placed = placed_wire(RulePlane(CAMERA), [100, 300], [500, 300])
    assert placed.plane == "floor"
    pixels = CAMERA.project(np.column_stack([placed.points, np.zeros(2)]))
    np.testing.assert_allclose(pixels, [[100, 300], [500, 300]], atol=1e-6)


def test_pixels_stay_pixels_without_a_camera():
    assert placed_wire(RulePlane(image_size=(400, 400)), [0, 200], [400, 200]).plane == "image"


def test_line_in_the_image_goes_on_beyond_the_border_where_it_ends():
    placed = placed_wire(RulePlane(image_size=(320, 240)), [100, 50], [100, 239])
    assert placed.counted.tolist() == [[100, 50], [100, 559]]
    assert placed.points.tolist() == [[100, 50], [100, 239]]  # as it is shown and written


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "at least one [[tripwire]] or [[zone]], found an empty file"),
        ("[[tripwire]\n", "expected a rules.toml, found"),
        ('[[line]]\nname = "a"\n', "tables named tripwire, zone or queue, found 'line'"),
        ("tripwire = 3\n", "tripwire: should be a valid list, found 3"),
        ('[[tripwire]]\nname = "a"\nfrom_m = [1, 1]\nto_m = [1, 1]\n', "'a', found a line of zero length"),
        ('[[tripwire]]\nname = "a"\nfrom_m = [1, 1]\n', "from_m and to_m, or from_px and to_px, in tripwire 'a'"),
        ('[[tripwire]]\nname = "a"\n', "found neither"),
        ('[[tripwire]]\nname = "a"\nfrom_m = [1, 1]\nto_px = [1, 2]\n', "found from_m, to_px"),
        ('[[tripwire]]\nname = "a"\nfrom_m = [1, nan]\nto_m = [1, 2]\n', "tripwire 'a'"),
        ('[[tripwire]]\nname = "a"\nfrom_m = ["x", 1]\nto_m = [1, 2]\n', "found 'x'"),
        ('[[tripwire]]\nname = "a"\nfrom_m = [1, 1]\nto_m = [1, 2]\nhysteresis = 1\n', "unknown name hysteresis in"),
        ("[[tripwire]]\nfrom_m = [1, 1]\nto_m = [1, 2]\n", "expected name in tripwire number 1, found none"),
        (WIRE + '[[zone]]\nname = "door"\npolygon_m = [[0, 0], [2, 0], [2, 2]]\n', "found 'door' twice"),
        (ZONE + '[[queue]]\nname = "q"\nzone = "kiosk"\n', "queue 'q' to name one of the zones (till), found 'kiosk'"),
        ('[[zone]]\nname = "z"\npolygon_m = [[0, 0], [1, 0]]\n', "at least 3 points in zone 'z', found 2"),
        ('[[zone]]\nname = "z"\npolygon_m = [[0, 0], [1, 1], [2, 2]]\n', "found points on a line"),
        ('[[zone]]\nname = "z"\npolygon_m = [[0, 0], [2, 2], [2, 0], [0, 2]]\n', "does not cross itself in zone 'z'"),
        ('[[zone]]\nname = "z"\n', "polygon_m or polygon_px in zone 'z', found neither"),
    ],
)
def test_bad_rules_get_one_sentence_that_names_the_file(tmp_path, text, sentence):
    with pytest.raises(InputError) as caught:
        load_rules(rules_file(tmp_path, text))
    assert sentence in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "rules.toml"))
    assert "\n" not in str(caught.value)


STEEP = RulePlane(GroundCamera(640, 480, 500.0, 3.0, math.radians(80)))


@pytest.mark.parametrize(
    ("rule", "plane", "sentence"),
    [
        ({"from_px": [700, 10], "to_px": [900, 10]}, STEEP, "inside the view of 640x480 pixels"),
        ({"from_px": [100, 5], "to_px": [200, 5]}, STEEP, "above the horizon"),
        ({"from_m": [-1, -5], "to_m": [1, -5]}, STEEP, "inside the view"),
        ({"from_m": [50, 5], "to_m": [50, 6]}, STEEP, "inside the view"),
        ({"from_px": [0.5, 0.25], "to_px": [0.5, 0.9]}, RulePlane(), "found fractions of the image, up to 0.9"),
        ({"from_m": [1, 2], "to_m": [3, 2]}, RulePlane(None, (640, 480), has_floor=False), "has no metres"),
    ],
)
def test_line_outside_the_view_or_in_another_unit_is_refused(rule, plane, sentence):
    with pytest.raises(InputError, match=sentence):
        parse_rules({"tripwire": [{"name": "w", **rule}]}, plane, "r")


def test_rules_that_no_track_comes_near_are_doubted():
    tracks = positions_table(np.arange(50), np.ones(50), np.column_stack([np.zeros(50), np.linspace(1, 9, 50)]))
    for scale, doubted in ((1.0, False), (100.0, True)):
        rule = {"name": "w", "from_m": [-3.0 * scale, 5.0 * scale], "to_m": [3.0 * scale, 5.0 * scale]}
        note = parse_rules({"tripwire": [rule]}, RulePlane(), "r").far_rule_note(tracks)
        assert ("within 491 m of rule 'w'" in note) == bool(note) == doubted


def test_depth_in_an_outline_is_the_distance_to_it_with_a_sign():
    x, y = np.array([[1.0, 0.25], [3.0, 1.0], [-3.0, -4.0]]).T
    assert Outline(SQUARE).depth(x, y) == pytest.approx([0.25, -1.0, -5.0])
    assert Outline(SQUARE).inner_radius() == pytest.approx(1.0, abs=0.1)
    notched = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]])
    assert np.sign(Outline(notched).depth(np.array([2.0, 0.5]), np.array([2.0, 1.0]))).tolist() == [-1, 1]


@pytest.mark.parametrize("name", ["=HYPERLINK(1)", "@door", "-1+1", "+door", "a\tb", "a\x1b[31m"])
def test_name_that_a_spreadsheet_or_terminal_would_act_on_is_refused(name):
    rule = {"name": name, "from_m": [0, 0], "to_m": [1, 0]}
    with pytest.raises(InputError, match="begins with none of"):
        parse_rules({"tripwire": [rule]}, RulePlane(), "rules.toml")


# Two metres above the floor, straight down: image right is +x, image up is +y.
DOWN = SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 2.0]))
# Looking along +y, level: the horizon is the middle row.
LEVEL = SE3(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), np.array([0.0, 0.0, 2.0]))
GEOMETRY = RectifiedGeometry(640, 480, 400.0, 400.0, 319.5, 239.5, 0.1)


def test_floor_of_an_overhead_camera_projects_to_its_pixels():
    camera = GEOMETRY.above(DOWN)
    pixels = np.array([[319.5, 239.5], [519.5, 239.5], [319.5, 139.5]])
    floor = camera.back_project(pixels)
    np.testing.assert_allclose(floor, [[0, 0], [1, 0], [0, 0.5]], atol=1e-12)
    np.testing.assert_allclose(camera.project(np.column_stack([floor, np.zeros(3)])), pixels)


def test_level_camera_sees_no_floor_above_the_horizon_or_behind_it():
    camera = GEOMETRY.above(LEVEL)
    assert np.isnan(camera.back_project(np.array([[319.5, 100.0]]))).all()
    assert np.isnan(camera.project(np.array([[0.0, -1.0, 0.0]]))).all()


def test_plane_of_a_rig_reads_its_world(tmp_path):
    lens = Camera(640, 480, 400.0, 400.0, 319.5, 239.5)
    save_rig(StereoRig(lens, lens, SE3(np.eye(3), np.array([-0.1, 0.0, 0.0]))), tmp_path / "rig.toml")
    with pytest.raises(InputError, match=r"world\.toml"):
        plane_of(None, tmp_path / "rig.toml")
    save_world(Floor(DOWN), tmp_path / "world.toml")
    plane = plane_of(None, tmp_path / "rig.toml")
    placed = placed_wire(plane, [319.5, 239.5], [519.5, 239.5])
    np.testing.assert_allclose(placed.points, [[0, 0], [1, 0]], atol=0.01)


def tracks_at(times: list[float]) -> Trajectories:
    collector = TrajectoryCollector()
    for frame, time in enumerate(times):
        collector.add(frame, time, (TrackState(1, "confirmed", 0.0, 0.0, 0.0, 0.0, 1.7),))
    return collector.trajectories()


def test_intervals_are_longer_where_the_clock_has_jumped():
    rules = parse_rules({"tripwire": [{"name": "door", "from_m": [0, 1], "to_m": [1, 1]}]}, RulePlane(), "rules.toml")
    counted = count_tracks(tracks_at([0.0, 0.1, 1.6e9]), rules).to_json()
    assert len(counted["rules"]["door"]["intervals"]) == INTERVALS_MAX
    assert counted["interval_s"] == pytest.approx(counted["duration_s"] / INTERVALS_MAX)


def crossing(moment: float, direction: Direction = "left_to_right") -> Event:
    return Event(round(moment * 10), moment, "door", "crossing", 1, direction)


def test_crossings_match_the_nearest_of_their_direction():
    true = [crossing(1.0), crossing(2.0), crossing(10.0, "right_to_left")]
    found = [crossing(2.3), crossing(1.2), crossing(10.1, "right_to_left")]
    scores = crossing_scores(true, found, 1.0)
    assert (scores.matched, scores.precision, scores.recall, scores.accuracy) == (3, 1.0, 1.0, 1.0)
    assert scores.timing_mean_s == pytest.approx(0.2)
    assert scores.timing_std_s == pytest.approx(np.std([0.2, 0.3, 0.1]))


def test_as_many_crossings_match_as_can():
    # The nearest pair (2.0, 2.1) would leave 1.2 and 2.9 without partners in the window.
    scores = crossing_scores([crossing(1.2), crossing(2.0)], [crossing(2.1), crossing(2.9)], 0.95)
    assert scores.matched == 2


def test_misses_cancel_extras_in_the_total_alone():
    scores = crossing_scores([crossing(t) for t in (1, 2, 3, 4)], [crossing(t) for t in (1, 2, 3, 50)], 1.0)
    assert scores.accuracy == 1.0
    assert scores.strict_accuracy == 0.5
    assert (scores.precision, scores.recall) == (0.75, 0.75)


def test_wrong_direction_is_distinguished_from_a_miss():
    scores = crossing_scores([crossing(1.0)], [crossing(1.1, "right_to_left")], 1.0)
    assert (scores.matched, scores.wrong_direction) == (0, 1)
    assert (scores.true_left_to_right, scores.found_right_to_left) == (1, 1)


def test_no_crossings_have_no_scores():
    scores = crossing_scores([], [], 1.0)
    assert (scores.accuracy, scores.precision, scores.recall, scores.timing_mean_s) == (None, None, None, None)


@pytest.mark.parametrize(("true", "found", "accuracy"), [(16, 17, 0.938), (54, 41, 0.759)])
def test_accuracy_is_that_of_the_papers_table_3(true, found, accuracy):
    scores = crossing_scores([crossing(float(i)) for i in range(true)], [crossing(float(i)) for i in range(found)], 0.4)
    assert scores.accuracy == pytest.approx(accuracy, abs=0.001)


def test_occupancy_is_grouped_by_the_true_number_as_in_table_4():
    true = np.array([0, 0, 1, 2, 4, 4, 12])
    found = np.array([0, 1, 1, 2, 3, 5, 10])
    groups = {group.people: group for group in occupancy_groups(true, found)}
    assert (groups["0"].right_percent, groups["0"].mean_difference) == (50.0, 0.5)
    assert groups["1-2"].right_percent == 100.0
    assert (groups["3-5"].mean_difference, groups["3-5"].mean_absolute_difference) == (0.0, 1.0)
    assert (groups["6-9"].frames, groups["6-9"].right_percent) == (0, None)
    assert groups["10+"].mean_difference == -2.0


People = dict[str, int]
Stays = dict[str, list[str]]
RULES = {
    "tripwire": [{"name": "door", "from_m": [-1, 0], "to_m": [1, 0]}],
    "zone": [{"name": "room", "polygon_m": [[-1, -1], [1, -1], [1, 1], [-1, 1]]}],
}


def wild_tracks(seed: int) -> Trajectories:
    """People near a door who are lost, hidden, exchanged and given new ids all the time."""
    rng = np.random.default_rng(seed)
    rows = []
    for person in range(4):
        place, track_id, away = rng.uniform(-1.5, 1.5, 2), person + 1, 0
        for frame in range(int(rng.integers(0, 20)), 1100):
            place = np.clip(place + rng.normal(0, 0.12, 2), -1.6, 1.6)
            away = max(0, away - 1) if rng.random() > 0.03 else int(rng.integers(1, 40))
            if rng.random() < 0.01:
                track_id = int(rng.integers(1, 30))
            state = rng.choice(["confirmed", "lost", "tentative"], p=[0.9, 0.07, 0.03])
            if not away and all(row[:2] != (frame, track_id) for row in rows[-2000:]):
                rows.append((frame, track_id, *place, state))
    columns = dict(zip(("frame", "id", "x_m", "y_m", "state"), zip(*rows, strict=True), strict=True))
    return table_of(columns | {"timestamp_s": np.array(columns["frame"]) / 10}, "wild")


def every_frame(tracks: Trajectories, rules: Rules, params: AnalyticsParams) -> tuple[list[Event], Stays, People]:
    counter, events, states = Analytics(rules, params), [], row_states(tracks, slice(None))
    for frame in np.unique(tracks.frame).tolist():
        rows = np.flatnonzero(tracks.frame == frame).tolist()
        events += counter.update(frame, frame / 10, [states[row] for row in rows])
    stays = {name: sorted(map(str, map(vars, stays))) for name, stays in counter.stays.items()}
    return sorted(events, key=str), stays, counter.people


@pytest.mark.parametrize("seed", range(2))
def test_counts_of_a_table_are_those_of_every_frame(seed):
    tracks, params = wild_tracks(seed), AnalyticsParams(min_age_s=0.3)
    rules = parse_rules(RULES, RulePlane(), "r")
    counts = count_tracks(tracks, rules, params, clock=Clock(tracks, 10.0))
    events, stays, people = every_frame(tracks, rules, params)
    assert len(events) > 5
    assert sorted(counts.events, key=str) == events
    assert counts.people == people
    assert {name: sorted(map(str, map(vars, stays))) for name, stays in counts.stays.items()} == stays
