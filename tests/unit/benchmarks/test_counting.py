"""Counts and occupancy: committed scenes, wrong numbers of people, and the naive tracker."""

import numpy as np
import pytest

from benchmarks.__main__ import main_benchmarks as main
from benchmarks.counting import RULES, SINGLE, count_frames, score_rows
from benchmarks.options import scene_files
from benchmarks.peaks import PeakTracker, peaks
from calib.errors import InputError
from planview.counting.events import Event
from planview.counting.totals import CountScores, OccupancyGroup, crossing_scores
from planview.maps.grid import Grid, MapParams
from planview.maps.plan_view import FloorPoints, PlanViewMaps, plan_view
from planview.tracking.base import Observation
from planview.trajectories.table import read_tracks, read_truth


def test_every_scene_with_rules_is_scored_unless_named() -> None:
    names = {path.name for path in scene_files((), SINGLE, RULES)}
    assert {"door_oblique.rules.toml", "conference.rules.toml"} <= names
    assert scene_files(["corridor"], SINGLE, RULES) == [SINGLE / "corridor.rules.toml"]
    with pytest.raises(InputError, match="found 'attic'"):
        scene_files(["attic"], SINGLE, RULES)


def test_accuracy_and_occupancy_below_the_limits_are_not_ok() -> None:
    truth = [Event(frame, frame / 30, "door", "crossing", frame, "right_to_left") for frame in range(0, 270, 30)]
    scores = CountScores(
        {"door": crossing_scores(truth, truth[:-1], 1.0)},
        {"room": [OccupancyGroup("0", 10, 90.0, 0.1, 0.1), OccupancyGroup("10+", 0, None, None, None)]},
    )
    rows = score_rows("hall", scores)
    (wire,), (zone,) = rows["crossings"], rows["occupancy"]
    assert (wire["true"], wire["accuracy"], wire["ok"]) == ("0+9", pytest.approx(8 / 9), False)
    assert (zone["right_percent"], zone["ok"]) == (90.0, False)


@pytest.mark.parametrize(("word", "value"), [("--frames", "0"), ("--rooms", "-1")])
def test_bad_numbers_of_frames_and_seeds_are_refused(capsys, word, value):
    with pytest.raises(SystemExit, match="2"):
        main(["counting", word, value])
    assert "expected --frames from 1, --rooms from 0" in capsys.readouterr().err


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


def observed(frame: int, timestamp_s: float, *people: tuple[float, float]) -> Observation:
    return Observation(frame, timestamp_s, build_maps=lambda: maps_from(*people))


def walked(tracker, ways, n=8):
    """Tracks after n frames of 0.1 s over straight ways (x, y, vx, vy)."""
    for i in range(n):
        at = [(x + 0.1 * i * vx, y + 0.1 * i * vy) for x, y, vx, vy in ways]
        tracks = tracker.update(observed(i, 0.1 * i, *at))
    return tracks


def maps_from(*people: tuple[float, float]) -> PlanViewMaps:
    """People at (x, y) straight below or next to a camera, 1.7 m tall: discs of 0.15 m that are sampled each 2 cm."""
    grid = Grid.covering(0.0, 0.0, 4.0, 4.0, 0.04)
    steps = 0.02 * np.arange(-7, 8)
    disc = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    disc = disc[np.hypot(*disc.T) < 0.15]
    xy = np.concatenate([np.empty((0, 2)), *(np.array(p) + disc for p in people)])
    xyz = np.column_stack([xy, np.full(len(xy), 1.7)]).astype(np.float32)
    points = FloorPoints(xyz, np.full(len(xyz), 0.001, np.float32), np.arange(len(xyz), dtype=np.int32))
    return plan_view([points], grid, MapParams())


def test_peak_is_the_head_of_a_person_also_shoulder_to_shoulder():
    (peak,) = peaks(maps_from((2.0, 2.0)))
    assert peak == pytest.approx((2.0, 2.0, 1.7), abs=0.1)
    assert len(peaks(maps_from((1.7, 2.0), (2.2, 2.0)))) == 2


def test_walkers_keep_their_ids_and_are_confirmed_after_some_frames():
    tracker, ways = PeakTracker(), [(1.0, 1.0, 1.0, 0.0), (3.0, 3.0, -1.0, 0.0)]
    assert {t.state for t in walked(tracker, ways, 2)} == {"tentative"}
    tracker.reset()
    late = walked(tracker, ways)
    assert [(t.track_id, t.state) for t in late] == [(1, "confirmed"), (2, "confirmed")]
    assert late[0].x_m == pytest.approx(1.7, abs=0.1)


def test_person_who_is_not_seen_is_lost_and_gone_later():
    tracker = PeakTracker()
    walked(tracker, [(2.0, 2.0, 0.0, 0.0)])
    (lost,) = tracker.update(observed(8, 0.8))
    assert lost.state == "lost" and tracker.update(observed(50, 5.0)) == ()
