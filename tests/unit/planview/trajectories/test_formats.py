"""Trajectories in the formats of other programs: written, told by their content, read again."""

import json
import sqlite3
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from calib.errors import InputError
from planview.trajectories.file import TrajectoryFile
from planview.trajectories.formats import FORMATS, load_file, load_tracks, measured_rate, prepared
from planview.trajectories.table import Trajectories, positions_table
from planview.trajectories.text_formats import read_petrack, write_petrack

AREA = "POLYGON ((-5 0, 5 0, 5 9, -5 9, -5 0))"


def two_walkers(frames: int = 4, fps: float = 15.0) -> Trajectories:
    """Persons 1 and 2 side by side, walking along y at 1.2 m/s; times rounded to 0.1 ms as in tracks.csv."""
    frame = np.repeat(np.arange(frames), 2)
    y = 1.0 + 1.2 * frame / fps
    return positions_table(
        frame,
        np.tile([1, 2], frames),
        np.column_stack([np.tile([-0.5, 0.5], frames), y]).round(4),
        height_m=np.tile([1.75, 1.62], frames),
        timestamp_s=(frame / fps).round(4),
        box_px=np.column_stack([100.0 + frame, 50.0 + frame, 40.0 + 0 * frame, 120.0 + 0 * frame]),
    )


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_is_told_by_its_content_and_gives_positions_within_a_millimetre(name, tmp_path):
    table, path = two_walkers(), tmp_path / "anything"
    FORMATS[name].write(path, prepared(TrajectoryFile(table), name, area=AREA))
    again = load_tracks(path)
    assert again.frame.tolist() == table.frame.tolist()
    assert again.track_id.tolist() == table.track_id.tolist()
    np.testing.assert_allclose(again.x_m, table.x_m, atol=1e-3)
    np.testing.assert_allclose(again.y_m, table.y_m, atol=1e-3)


@pytest.mark.parametrize("name", ["pedpy", "ped-data-archive", "jupedsim", "parquet"])
def test_frame_rate_survives_an_export(name, tmp_path):
    FORMATS[name].write(tmp_path / "x", prepared(TrajectoryFile(two_walkers(100, 15.0)), name))
    assert load_file(tmp_path / "x").fps == 15.0


@pytest.mark.parametrize("name", ["ped-data-archive", "jupedsim", "parquet"])
def test_walkable_area_survives_an_export(name, tmp_path):
    FORMATS[name].write(tmp_path / "x", prepared(TrajectoryFile(two_walkers()), name, area=AREA))
    assert load_file(tmp_path / "x").walkable_wkt == AREA


@pytest.mark.parametrize("name", ["parquet", "csv", "jsonl"])
def test_formats_with_states_keep_every_column(name, tmp_path):
    table = two_walkers()
    table.state[3] = "lost"
    table.height_m[3] = np.nan
    FORMATS[name].write(tmp_path / "x", prepared(TrajectoryFile(table), name))
    again = load_tracks(tmp_path / "x")
    for column in Trajectories.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(again, column), getattr(table, column))


def test_formats_without_states_hold_confirmed_rows_and_on_request_predicted_ones():
    table = two_walkers()
    table.state[:3] = ["tentative", "lost", "lost"]
    assert len(prepared(TrajectoryFile(table), "pedpy").table) == 5
    assert len(prepared(TrajectoryFile(table), "pedpy", lost=True).table) == 7


def test_rate_is_that_of_the_median_frame_where_the_clock_jumps():
    table = two_walkers(10, 20.0)
    table.timestamp_s[8:] += 3600.0
    assert measured_rate(table) == 20.0


def test_petrack_text_in_centimetres_is_read_in_metres(tmp_path):
    path = tmp_path / "cm.txt"
    path.write_text("# framerate: 50 fps\n# id frame x/cm y/cm z/cm markerID\n7 3 -130.147 20 180 999\n")
    file = read_petrack(path)
    assert file.fps == 50.0
    assert (file.table.track_id[0], file.table.frame[0]) == (7, 3)
    assert (file.table.x_m[0], file.table.y_m[0], file.table.height_m[0]) == pytest.approx((-1.30147, 0.2, 1.8))


def test_petrack_text_is_written_in_centimetres_on_request(tmp_path):
    write_petrack(tmp_path / "x.txt", TrajectoryFile(two_walkers(1), 15.0), unit="cm")
    lines = (tmp_path / "x.txt").read_text().splitlines()
    assert lines == [
        "# framerate: 15 fps",
        "# id frame x/cm y/cm z/cm",
        "1 0 -50.00 100.00 175.00",
        "2 0 50.00 100.00 162.00",
    ]


def test_motchallenge_rows_count_frames_from_one_and_have_world_columns(tmp_path):
    FORMATS["motchallenge"].write(tmp_path / "x.txt", TrajectoryFile(two_walkers(1)))
    assert (tmp_path / "x.txt").read_text().splitlines()[0] == ("1,1,100.0,50.0,40.0,120.0,1,-0.5000,1.0000,0.0000")


def test_json_lines_that_are_cut_short_are_read_up_to_the_last_whole_frame(tmp_path):
    FORMATS["jsonl"].write(tmp_path / "x", TrajectoryFile(two_walkers(3)))
    text = (tmp_path / "x").read_text()
    (tmp_path / "x").write_text(text[: text.rindex("people")])
    assert load_tracks(tmp_path / "x").frame.tolist() == [0, 0, 1, 1]


def _sqlite(path: Path, *statements: str) -> None:
    with sqlite3.connect(path) as database:
        for statement in statements:
            database.execute(statement)


def _endless_view(path: Path) -> None:
    _sqlite(
        path,
        "CREATE TABLE metadata (key TEXT, value TEXT)",
        "CREATE VIEW trajectory_data AS WITH RECURSIVE r(frame) AS (SELECT 1 UNION ALL SELECT frame + 1 FROM r) "
        "SELECT frame, 1 AS id, 0.0 AS pos_x, 0.0 AS pos_y FROM r",
    )


def _claimed_rows(path: Path) -> None:
    row = np.dtype([("id", "<i8"), ("frame", "<i8"), ("x", "<f8"), ("y", "<f8")])
    with h5py.File(path, "w") as file:
        file.create_dataset("trajectory", (2_000_000_000,), row, chunks=(1024,)).attrs["fps"] = 25.0


BAD: dict[str, Callable[[Path], object]] = {
    "no unit": lambda p: p.write_text("# framerate: 25 fps\n1 0 0.5 0.5 1.7\n"),
    "rate of zero": lambda p: p.write_text("# framerate: 0 fps\n# id frame x/m y/m z/m\n1 0 0.5 0.5 1.7\n"),
    "frame number of 30 digits": lambda p: p.write_text("# x/m\n1 " + "9" * 30 + " 0.5 0.5 1.7\n"),
    "two rows of one frame and id": lambda p: p.write_text("# x/m\n1 0 0.5 0.5 1.7\n1 0 0.6 0.5 1.7\n"),
    "another database": lambda p: _sqlite(p, "CREATE TABLE t (a)"),
    "a view without end": _endless_view,
    "rows claimed by a header": _claimed_rows,
    "a cut HDF5 file": lambda p: p.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(20)),
    "a cut Parquet file": lambda p: p.write_bytes(b"PAR1" + bytes(20)),
    "no people in JSON": lambda p: p.write_text('{"frame": 1}\n'),
    "infinity in JSON": lambda p: p.write_text('{"frame": Infinity, "people": []}\n'),
    "deep JSON": lambda p: p.write_text('{"a":' * 100_000),
    "an unknown state": lambda p: p.write_text(json.dumps({"frame": 1, "people": [{"id": 1, "state": "<b>"}]}) + "\n"),
}


@pytest.mark.parametrize("make", BAD.values(), ids=BAD.keys())
def test_damaged_trajectories_are_refused_in_one_sentence(make, tmp_path):
    path = tmp_path / "bad"
    make(path)
    with pytest.raises(InputError) as refused:
        load_tracks(path)
    assert str(refused.value).startswith(str(path)) and "\n" not in str(refused.value)
