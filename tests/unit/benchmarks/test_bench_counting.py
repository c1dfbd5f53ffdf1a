"""The tables of ``python -m benchmarks counting``."""

import io

import numpy as np
import pytest
from rich.console import Console

from benchmarks.__main__ import main_benchmarks as main
from benchmarks.beside_mog2 import PaintedVideo
from benchmarks.commands.bench_counting import print_counting
from benchmarks.counting import passages, scene_names, table_of
from benchmarks.pavement import LAST, AlteredVideo, pavement_truth
from calib.errors import InputError
from planview.counting.scoring import CountScores, OccupancyGroup, crossing_scores
from planview.trajectories.table import positions_table


def test_every_scene_with_rules_is_scored_unless_named() -> None:
    assert {"door_oblique", "conference"} <= set(scene_names())
    assert scene_names(["corridor"]) == ["corridor"]
    with pytest.raises(InputError, match="found 'attic'"):
        scene_names(["attic"])


def test_tables_show_accuracy_and_occupancy_with_verdicts() -> None:
    truth = pavement_truth("as recorded")
    scores = CountScores(
        {"y = 200": crossing_scores(truth, truth[:-1], 1.0)},
        {"room": [OccupancyGroup("0", 10, 90.0, 0.1, 0.1), OccupancyGroup("10+", 0, None, None, None)]},
    )
    table = table_of("pavement", scores)
    assert [row.ok for row in table.crossings] == [False]
    assert len(table.occupancy) == 1
    output = io.StringIO()
    print_counting(table, Console(file=output, width=100, markup=False))
    assert "1+8" in output.getvalue()
    assert "88.9" in output.getvalue()
    assert "short" in output.getvalue()
    assert table.to_json()["occupancy"][0]["right_percent"] == 90.0


def test_pavement_truth_is_eight_up_and_one_down() -> None:
    ways = [event.direction for event in pavement_truth("as recorded")]
    assert (ways.count("right_to_left"), ways.count("left_to_right")) == (8, 1)


def test_pavement_played_backwards_is_crossed_the_other_way_in_the_other_order() -> None:
    there, back = pavement_truth("as recorded"), pavement_truth("backwards")
    assert [event.frame for event in back] == [LAST - event.frame for event in there]
    assert all(one.direction != other.direction for one, other in zip(there, back, strict=True))


def test_altered_video_is_darker_or_turned_round() -> None:
    images = [np.full((8, 8, 3), level, np.uint8) for level in (40, 80, 120)]
    video = PaintedVideo(lambda n: iter(images[:n]), 3, (8, 8), 10.0)
    assert [int(frame.image[0, 0, 0]) for frame in AlteredVideo(video, "half the light")] == [20, 40, 60]
    backwards = list(AlteredVideo(video, "backwards"))
    assert [int(frame.image[0, 0, 0]) for frame in backwards] == [120, 80, 40]
    assert [frame.timestamp_s for frame in backwards] == [frame.timestamp_s for frame in video]


def test_passages_are_found_where_the_line_is_last_passed() -> None:
    y = np.array([2.0, 1.0, -0.1, 0.1, -1.0])
    frame = np.arange(5)
    there = positions_table(frame, np.ones(5, dtype=np.int64), np.column_stack([y, y]), timestamp_s=frame / 10)
    (event,) = passages(there)
    assert (event.frame, event.direction) == (4, "left_to_right")
    back = positions_table(frame, np.ones(5, dtype=np.int64), np.column_stack([y, np.abs(y)]), timestamp_s=frame / 10)
    assert passages(back) == []


def test_bad_number_of_frames_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["counting", "--frames", "0"])
    assert "--frames: expected at least 1" in capsys.readouterr().err
