"""Counts and occupancy: committed scenes, random rooms and views, the pavement clip, and frames with a wrong number."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import main_benchmarks as main
from benchmarks.counting import (
    RULES,
    SINGLE,
    CountingTable,
    all_rooms,
    count_frames,
    full_truth,
    passages,
    pavement_truth,
    strict_accuracy,
    table_of,
    view_rules,
)
from benchmarks.options import scene_files
from benchmarks.random_scenes.generator import VIEWS, random_scene
from calib.errors import InputError
from planview.counting.geometry import RulePlane
from planview.counting.rules import parse_rules
from planview.counting.scoring import CountScores, OccupancyGroup, crossing_scores
from planview.synthetic.camera import ground_camera
from planview.trajectories.table import positions_table, read_tracks, read_truth


def test_every_scene_with_rules_is_scored_unless_named() -> None:
    names = {path.name for path in scene_files((), SINGLE, RULES)}
    assert {"door_oblique.rules.toml", "conference.rules.toml"} <= names
    assert scene_files(["corridor"], SINGLE, RULES) == [SINGLE / "corridor.rules.toml"]
    with pytest.raises(InputError, match="found 'attic'"):
        scene_files(["attic"], SINGLE, RULES)


def test_accuracy_and_occupancy_below_the_limits_are_not_ok() -> None:
    truth = pavement_truth()
    scores = CountScores(
        {"y = 200": crossing_scores(truth, truth[:-1], 1.0)},
        {"room": [OccupancyGroup("0", 10, 90.0, 0.1, 0.1), OccupancyGroup("10+", 0, None, None, None)]},
    )
    table = table_of("pavement", scores)
    (wire,), (zone,) = table.crossings, table.occupancy
    assert (wire["true"], wire["accuracy"], wire["ok"]) == ("1+8", pytest.approx(8 / 9), False)
    assert (zone["right_percent"], zone["ok"]) == (90.0, False)


def test_pavement_truth_is_eight_up_and_one_down() -> None:
    ways = [event.direction for event in pavement_truth()]
    assert (ways.count("right_to_left"), ways.count("left_to_right")) == (8, 1)


def test_passages_are_found_where_the_line_is_last_passed() -> None:
    y = np.array([2.0, 1.0, -0.1, 0.1, -1.0])
    frame = np.arange(5)
    there = positions_table(frame, np.ones(5, dtype=np.int64), np.column_stack([y, y]), timestamp_s=frame / 10)
    (event,) = passages(there)
    assert (event.frame, event.direction) == (4, "left_to_right")
    back = positions_table(frame, np.ones(5, dtype=np.int64), np.column_stack([y, np.abs(y)]), timestamp_s=frame / 10)
    assert passages(back) == []


@pytest.mark.parametrize(
    ("word", "value", "message"),
    [("--frames", "0", "expected at least 1"), ("--rooms", "-1", "expected numbers from 0")],
)
def test_bad_numbers_of_frames_and_seeds_are_refused(capsys, word, value, message):
    with pytest.raises(SystemExit, match="2"):
        main(["counting", word, value])
    assert f"{word}: {message}" in capsys.readouterr().err


def _table(name: str, frames: int, right: float) -> CountingTable:
    return table_of(name, CountScores({}, {"room": [OccupancyGroup("3-5", frames, right, 0.1, 0.1)]}))


def test_ranges_of_all_rooms_weigh_frames_alike_and_one_room_has_none():
    *rooms, together = all_rooms([_table("a", 100, 100.0), _table("b", 300, 96.0)]).occupancy
    assert [row["recording"] for row in rooms] == ["a", "b"]
    assert (together["frames"], together["right_percent"]) == (400, pytest.approx(97.0))
    assert together["ok"] and len(all_rooms([_table("a", 100, 100.0)]).occupancy) == 1


def test_view_that_nobody_crosses_is_right_when_nobody_is_counted():
    assert strict_accuracy(crossing_scores([], [], 2.0)) == 1.0


def test_every_view_is_found_and_drawn_and_an_unknown_one_refused():
    assert VIEWS / "bus_door.toml" in scene_files((), VIEWS)
    with pytest.raises(InputError, match="found 'moon'"):
        scene_files(["moon"], VIEWS)


def test_zone_of_a_nearly_horizontal_view_is_floor():
    view = random_scene("views", 1, VIEWS / "lobby.toml")
    camera = ground_camera(view.scene.camera)
    (zone,) = parse_rules(view_rules(view), RulePlane(camera), "line").zones
    assert zone.plane == "floor"


def test_truth_has_the_boxes_of_whole_silhouettes(tmp_path: Path):
    header = "frame,id,x_m,y_m,height_m,visible,left_px,top_px,width_px,height_px,full_left_px,full_top_px"
    path = tmp_path / "truth.csv"
    path.write_text(f"{header},full_width_px,full_height_px\n0,1,0,0,1.7,0.5,10,10,5,5,8,6,9,20\n")
    assert full_truth(path).box_px.tolist() == [[8, 6, 9, 20]]


TRUTH = "frame,timestamp_s,id,x_m,y_m,height_m,visible\n0,0,1,,,,1\n1,0.1,1,,,,1\n1,0.1,2,,,,0.1\n2,0.2,1,,,,1\n"
TRACKS = "frame,timestamp_s,id,x_m,y_m,state\n0,0,7,,,tentative\n1,0.1,7,,,confirmed\n2,0.2,7,,,confirmed\n"


@pytest.mark.parametrize(
    ("tracks", "frames", "wrong", "too_few"),
    [(TRACKS, 4, 1, 1), (TRACKS, 1, 1, 1), (TRACKS + "2,0.2,8,,,confirmed\n", 4, 2, 1)],
    ids=["too few confirmed", "the end of the recording", "too many"],
)
def test_frames_with_too_few_or_too_many_tracks_are_wrong(tmp_path, tracks, frames, wrong, too_few):
    (tmp_path / "truth.csv").write_text(TRUTH)
    (tmp_path / "tracks.csv").write_text(tracks)
    counts = count_frames(read_tracks(tmp_path / "tracks.csv"), read_truth(tmp_path / "truth.csv"), frames)
    assert counts == {"frames": frames, "wrong": wrong, "too_few": too_few, "error": wrong / frames}
