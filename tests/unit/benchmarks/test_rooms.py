"""Occupancy of drawn conference rooms."""

import pytest

from benchmarks.__main__ import main_benchmarks as main
from benchmarks.counting import CountingTable, OccupancyRow
from benchmarks.rooms import all_rooms
from planview.counting.scoring import OccupancyGroup


def _table(name: str, frames: int, right: float) -> CountingTable:
    return CountingTable((), (OccupancyRow(name, "room", OccupancyGroup("3-5", frames, right, 0.1, 0.1), 97.0),))


def test_ranges_of_all_rooms_weigh_frames_alike() -> None:
    *rooms, together = all_rooms([_table("a", 100, 100.0), _table("b", 300, 96.0)]).occupancy
    assert [row.recording for row in rooms] == ["a", "b"]
    assert (together.group.frames, together.group.right_percent) == (400, pytest.approx(97.0))
    assert together.ok


def test_one_room_has_no_row_for_all_rooms() -> None:
    assert len(all_rooms([_table("a", 100, 100.0)]).occupancy) == 1


def test_negative_seeds_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["counting", "--rooms", "-1"])
    assert "--rooms: expected numbers from 0" in capsys.readouterr().err
