"""The tables of ``planview bench counting``."""

import io

import numpy as np
import pytest
from rich.console import Console

from calib.errors import InputError
from planview.analytics.scoring import CountScores, OccupancyGroup, crossing_scores
from planview.bench.commands.bench_counting import print_counting
from planview.bench.counting import passages, pavement_truth, scene_names, table_of
from planview.cli import main
from planview.trajectories.table import positions_table


def test_every_scene_with_rules_is_scored_unless_named() -> None:
    assert {"door_oblique", "conference"} <= set(scene_names())
    assert scene_names(["corridor"]) == ["corridor"]
    with pytest.raises(InputError, match="found 'attic'"):
        scene_names(["attic"])


def test_tables_show_accuracy_and_occupancy_with_verdicts() -> None:
    truth = pavement_truth()
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


def test_bad_number_of_frames_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["bench", "counting", "--frames", "0"])
    assert "--frames: expected at least 1" in capsys.readouterr().err
