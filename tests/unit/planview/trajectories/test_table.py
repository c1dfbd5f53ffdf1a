"""The time from frame to frame."""

import io
from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError
from planview.trajectories.state import TrackState
from planview.trajectories.table import (
    Trajectories,
    TrajectoryCollector,
    csv_blocks,
    frame_period_s,
    positions_table,
    read_tracks,
    read_truth,
    write_header,
    write_rows,
)


def test_tracks_survive_a_round_trip_with_unknown_values_empty(tmp_path: Path) -> None:
    file = io.StringIO()
    write_header(file)
    write_rows(file, 3, 0.2, [TrackState(7, "confirmed", 1.0, 2.0, height_m=1.75)])
    path = tmp_path / "tracks.csv"
    path.write_text(file.getvalue())
    tracks = read_tracks(path)
    assert (tracks.frame[0], tracks.track_id[0], tracks.state[0]) == (3, 7, "confirmed")
    assert (tracks.x_m[0], tracks.y_m[0], tracks.height_m[0]) == (1.0, 2.0, 1.75)
    assert np.isnan(tracks.box_px).all()


def test_collected_tracks_are_those_of_a_round_trip_through_the_file(tmp_path: Path) -> None:
    first = TrackState(9, "lost", 1 / 3, -0.00001, 0.25, 2 / 3, 1.71234, (10.05, -0.5, 20.25, 31.96))
    second = TrackState(7, "tentative", 1.00005, 2.0)
    path, collector = tmp_path / "tracks.csv", TrajectoryCollector()
    with path.open("w") as file:
        write_header(file)
        for frame, tracks in ((3, [first, second]), (4, [second]), (5, [])):
            write_rows(file, frame, frame / 7, tracks)
            collector.add(frame, frame / 7, tracks)
    read, collected = read_tracks(path), collector.trajectories()
    for name in Trajectories.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(collected, name), getattr(read, name), strict=name != "state")


def test_nothing_collected_is_an_empty_table() -> None:
    empty = TrajectoryCollector().trajectories()
    assert len(empty) == 0
    assert (empty.box_px.shape, empty.velocity_mps.shape, empty.x_m.shape) == ((0, 4), (0, 2), (0,))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frame,id\n", "column 'x_m'"),
        ("frame,id,x_m,y_m,height_m\n1,1,a,0,0\n", "number in 'x_m', line 2, found 'a'"),
        ("frame,id,x_m,y_m,height_m\n1.5,1,0,0,0\n", "whole number in 'frame'"),
        ("frame,id,x_m,y_m,height_m\n1,1,0,0,0\n1,1,0,0,0\n", "two for frame 1, id 1"),
        ("frame,id,x_m,y_m,height_m\n1,1\n", "found fewer"),
    ],
)
def test_bad_truth_is_refused_in_one_sentence(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "truth.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_truth(path)


def timed(frame: list[int], times: list[float]) -> Trajectories:
    ids = np.arange(1, len(frame) + 1)
    return positions_table(np.array(frame), ids, np.zeros((len(frame), 2)), timestamp_s=np.array(times))


def test_frame_period_is_the_median_over_gaps() -> None:
    frame = [0, 0, 1, 2, 12]
    assert frame_period_s(timed(frame, [n / 25.0 for n in frame]), 1 / 30) == pytest.approx(0.04)


def test_frame_period_without_timestamps_is_the_fallback() -> None:
    assert frame_period_s(timed([0, 1], [np.nan, np.nan]), 1 / 30) == 1 / 30
    assert frame_period_s(timed([0, 1], [2.0, 2.0]), 1 / 30) == 1 / 30


def test_frame_period_of_mostly_repeated_timestamps_is_the_mean() -> None:
    assert frame_period_s(timed([0, 1, 2, 3], [0.0, 0.0, 0.0, 0.3]), 1 / 30) == pytest.approx(0.1)


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "table.csv"
    path.write_bytes(text.encode())
    return path


def column(path: Path, name: str) -> list[float]:
    return [value for block in csv_blocks(path, (), "test") for value in block.numbers(name, np.nan).tolist()]


def test_numbers_with_exponents_blanks_and_many_digits_are_read(tmp_path: Path) -> None:
    path = written(tmp_path, "a,b\n1e3,2\n 1.5 ,2\n0.12345678901234567,2\n,2\n")
    np.testing.assert_array_equal(column(path, "a"), [1000.0, 1.5, 0.12345678901234567, np.nan])


def test_quoted_cells_carriage_returns_and_a_byte_order_mark_are_read(tmp_path: Path) -> None:
    path = written(tmp_path, '\ufeffa,note,b\r\n1,"x, y\nz",2\r\n"3",,4\r\n')
    assert column(path, "a") == [1.0, 3.0]
    assert column(path, "b") == [2.0, 4.0]


def test_blocks_continue_each_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planview.trajectories.table.BLOCK_ROWS", 7)
    path = written(tmp_path, "a,b\n" + "".join(f"{i},{i / 8}\n" for i in range(50)))
    assert column(path, "b") == [i / 8 for i in range(50)]


def test_a_bad_number_is_named_with_its_line(tmp_path: Path) -> None:
    path = written(tmp_path, "a,b\n1,2\n\n3,many\n")
    with pytest.raises(InputError, match="a number in 'b', line 4, found 'many'"):
        column(path, "b")


def test_a_short_row_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected 3 cells in line 3, found fewer"):
        column(written(tmp_path, "a,b,c\n1,2,3\n4,5\n"), "c")
