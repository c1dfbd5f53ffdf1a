"""Tables of tracks and their formats."""

import json
import sqlite3
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from toy_recordings import table_file
from toy_tracks import positions_table

from calib.errors import InputError
from planview.trajectories.detections import load_detections
from planview.trajectories.file import Region, TrajectoryFile, limit, measure_rate, region_of
from planview.trajectories.formats import (
    FORMATS,
    load_file,
    load_tracks,
    load_truth,
    prepare_export,
    sequence_rate,
    sequence_size,
    write_file,
)
from planview.trajectories.state import TrackState
from planview.trajectories.table import (
    Trajectories,
    TrajectoryCollector,
    doubt,
    frame_period_s,
    read_tracks,
    read_truth,
    table_of,
    write_header,
    write_rows,
    write_table,
)


def test_nothing_collected_is_an_empty_table():
    empty = TrajectoryCollector().trajectories()
    assert len(empty) == 0
    assert (empty.box_px.shape, empty.velocity_mps.shape, empty.x_m.shape) == ((0, 4), (0, 2), (0,))


def test_a_table_iterates_over_its_rows():
    table = positions_table(np.array([3, 4]), np.array([7, 7]), np.array([[1.0, 2.0], [1.5, 2.0]]))
    assert [(row.frame, row.id, row.x_m) for row in table] == [(3, 7, 1.0), (4, 7, 1.5)]
    assert len([*table]) == len(table)


def test_collected_tracks_are_those_of_a_round_trip_through_the_file(tmp_path):
    first = TrackState(9, "lost", 1 / 3, -0.00001, 0.25, 2 / 3, 1.71234, (10.05, -0.5, 20.25, 31.96), -90.0)
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
    assert (read.frame[1], read.track_id[1], read.state[1]) == (3, 9, "lost")
    assert read.facing_deg[1] == -90.0
    assert np.isnan(read.facing_deg[0])
    assert (read.x_m[0], read.y_m[0]) == (1.0001, 2.0)
    assert np.isnan(read.height_m[0])
    assert np.isnan(read.box_px[0]).all()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "frame,id,x_m,y_m,time_ms,note\n0,1,2,3,0,a\n1,1,2,NA,100,b\n"),
        ("a.jsonl", '{"frame":0,"id":1,"x_m":2,"y_m":3,"timestamp_s":0}\n{"frame":1,"id":1,"x_m":2,"timestamp_s":0.1}'),
    ],
    ids=["milliseconds", "a person a line"],
)
def test_tables_that_other_programs_write_are_read(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    table = load_tracks(tmp_path / name)
    assert table.timestamp_s.tolist() == [0.0, 0.1]
    assert table.x_m.tolist() == [2.0, 2.0]
    assert np.isnan(table.y_m[1])


def test_jupedsim_is_given_where_a_person_faces_or_else_walks(tmp_path):
    columns = {"frame": [0, 1], "id": [1, 1], "x_m": [0, 1], "y_m": [0, 0], "vx_mps": [2, 2], "vy_mps": [0, 0]}
    table = table_of(columns | {"facing_deg": [90.0, 90.0], "facing_confidence": [0.9, 0.8]}, "here")
    FORMATS["jupedsim"].write(tmp_path / "tracks.sqlite", TrajectoryFile(table, 10.0, ""))
    with closing(sqlite3.connect(tmp_path / "tracks.sqlite")) as database:
        rows = database.execute("SELECT ori_x, ori_y FROM trajectory_data ORDER BY frame").fetchall()
    np.testing.assert_allclose(rows, [[0, 1], [1, 0]], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frame,id\n", "columns frame, id, x_m, y_m, or .* found frame, id"),
        ("frame,id,x_m,y_m,height_m\n1,1,a,0,0\n", "number in 'x_m', line 2, found 'a'"),
        ("frame,id,x_m,y_m,height_m\n1.5,1,0,0,0\n", "whole number in 'frame'"),
        ("frame,id,x_m,y_m,height_m\n1,1,0,0,0\n1,1,0,0,0\n", "two for frame 1, id 1"),
        ("frame,id,x_m,y_m,height_m\n0,1,2,2,\n\n1,1,3,many,\n", "a number in 'y_m', line 4, found 'many'"),
        ("frame,id,x_m,y_m,height_m\n0,1,2,3,1\n4,5\n", "expected 5 cells in line 3, found fewer"),
    ],
)
def test_bad_truth_is_refused_in_one_sentence(tmp_path, text, message):
    path = tmp_path / "truth.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_truth(path)


def timed(frame: list[int], times: list[float]) -> Trajectories:
    ids = np.arange(1, len(frame) + 1)
    return positions_table(np.array(frame), ids, np.zeros((len(frame), 2)), timestamp_s=np.array(times))


def test_frame_period_is_the_median_over_gaps_the_mean_of_repeated_times_or_the_fallback():
    frame = [0, 0, 1, 2, 12]
    assert frame_period_s(timed(frame, [n / 25.0 for n in frame]), 1 / 30) == pytest.approx(0.04)
    assert frame_period_s(timed([0, 1], [np.nan, np.nan]), 1 / 30) == 1 / 30
    assert frame_period_s(timed([0, 1], [2.0, 2.0]), 1 / 30) == 1 / 30
    assert frame_period_s(timed([0, 1, 2, 3], [0.0, 0.0, 0.0, 0.3]), 1 / 30) == pytest.approx(0.1)


def test_csv_of_any_style_is_read(tmp_path):
    path = table_file(
        tmp_path, "frame,id,x_m,y_m,height_m\n0,1,1e3,2,\n0,2, 1.5 ,2,\n1,1,0.12345678901234567,2,\n1,2,,2,\n"
    )
    np.testing.assert_array_equal(read_truth(path).x_m, [1000.0, 1.5, 0.12345678901234567, np.nan])
    path = table_file(tmp_path, '\ufeffframe,id,x_m,note,y_m,height_m\r\n0,1,1,"x, y\nz",2,\r\n0,2,"3",,4,\r\n')
    assert (read_truth(path).x_m.tolist(), read_truth(path).y_m.tolist()) == ([1.0, 3.0], [2.0, 4.0])


@pytest.mark.parametrize(
    "content",
    [
        b"", b"1,2,3\n", b"1,2,x,4,5,6\n", b"1,1,nan,2,3,4,1\n", b"1 2 3\n", b"1 2 3 4 5\n6 7\n", b"hello\n",
        b"frame,id\n0,1\n", b"1,1,0,0,2,2\n1,1,3,3,2,2\n", b"1.5,1,0,0,2,2\n", b"\xff\xfe\x00\x01",
    ],
)  # fmt: skip
def test_anything_else_is_refused_with_the_name_of_the_file(tmp_path, content):
    (tmp_path / "odd.txt").write_bytes(content)
    with pytest.raises(InputError, match=r"odd\.txt: expected"):
        load_truth(tmp_path / "odd.txt")


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
def test_every_format_is_recognised_by_its_content(name, tmp_path):
    table, path = two_walkers(100), tmp_path / "anything"
    write_file(path, prepare_export(TrajectoryFile(table), name, area=AREA), name)
    again = load_file(path)
    assert again.table.frame.tolist() == table.frame.tolist()
    assert again.table.track_id.tolist() == table.track_id.tolist()
    np.testing.assert_allclose(again.table.x_m, table.x_m, atol=1e-3)
    np.testing.assert_allclose(again.table.y_m, table.y_m, atol=1e-3)
    binary = name in ("ped-data-archive", "jupedsim", "parquet")
    assert again.fps == (15.0 if binary or name == "pedpy" else None)
    assert again.walkable_wkt == (AREA if binary else None)


@pytest.mark.parametrize("name", ["parquet", "csv", "jsonl"])
def test_formats_with_states_keep_every_column(name, tmp_path):
    table = two_walkers()
    table.state[3] = "lost"
    table.height_m[3], table.facing_deg[3], table.facing_confidence[3] = np.nan, 135.5, 0.75
    table.confidence[2], table.std_m[2] = 0.9375, 0.0625
    FORMATS[name].write(tmp_path / "x", prepare_export(TrajectoryFile(table), name))
    again = load_tracks(tmp_path / "x")
    for column in Trajectories.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(again, column), getattr(table, column))


def test_formats_without_states_hold_predicted_rows_on_request():
    table = two_walkers()
    table.state[:3] = ["tentative", "lost", "lost"]
    assert len(prepare_export(TrajectoryFile(table), "pedpy").table) == 5
    assert len(prepare_export(TrajectoryFile(table), "pedpy", lost=True).table) == 7


def test_rate_is_that_of_the_median_frame_where_the_clock_jumps():
    table = two_walkers(10, 20.0)
    table.timestamp_s[8:] += 3600.0
    assert measure_rate(table) == 20.0


def timed_tracks(times_s: Sequence[float]) -> Trajectories:
    """One person who stands, seen in every frame."""
    frames = np.arange(len(times_s))
    return positions_table(frames, np.ones(len(frames)), np.zeros((len(frames), 2)), timestamp_s=np.array(times_s))


def test_times_of_a_table_that_begin_again_run_on(tmp_path):
    with (tmp_path / "tracks.csv").open("w") as file:
        write_table(file, timed_tracks([0.0, 0.1, 0.2, 0.0, 0.1]))
    with pytest.warns(UserWarning, match="frame 3"):
        found = load_tracks(tmp_path / "tracks.csv")
    assert found.timestamp_s == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])


def test_format_without_times_says_how_far_off_they_are():
    uneven = TrajectoryFile(timed_tracks([0.0, 0.1, 0.2, 0.3, 1.0, 1.1]))
    with pytest.warns(UserWarning, match=r"0\.6 s"):
        prepare_export(uneven, "jupedsim")


def test_json_lines_that_are_cut_short_are_read_up_to_the_last_whole_frame(tmp_path):
    FORMATS["jsonl"].write(tmp_path / "x", TrajectoryFile(two_walkers(3)))
    text = (tmp_path / "x").read_text()
    (tmp_path / "x").write_text(text[: text.rindex("people")])
    assert load_tracks(tmp_path / "x").frame.tolist() == [0, 0, 1, 1]


def test_dates_in_json_lines_are_times(tmp_path):
    people = '"people": [{"id": 1, "x_m": 0.0, "y_m": 0.0}]'
    times = ("2024-05-01T12:00:00.5Z", "2024-05-01T14:00:00.75+02:00")
    lines = [f'{{"frame": {n}, "timestamp_s": "{time}", {people}}}' for n, time in enumerate(times)]
    (tmp_path / "x").write_text("\n".join(lines))
    assert np.diff(load_tracks(tmp_path / "x").timestamp_s) == pytest.approx(0.25)


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
    "foreign values in a database": lambda p: _sqlite(
        p, "CREATE TABLE trajectory_data (frame BLOB, id TEXT)", "INSERT INTO trajectory_data VALUES (x'ff', 'a')"
    ),
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
    assert str(refused.value).startswith(str(path))
    assert "\n" not in str(refused.value)


def test_a_polygon_too_long_for_a_file_name_is_a_region():
    corners = [f"{k / 10:.3f} {y:.3f}" for y, ks in ((0, range(20)), (1, range(20, 0, -1))) for k in ks]
    assert region_of(f"POLYGON (({', '.join(corners)}))", "region=").wkt.startswith("POLYGON ((0.000 0.000")


def test_seqinfo_describes_its_sequence(tmp_path):
    (tmp_path / "gt").mkdir()
    (tmp_path / "seqinfo.ini").write_text("[Sequence]\nframeRate=10\nimWidth=640\nimHeight=480\n")
    truth = tmp_path / "gt/gt.txt"
    assert (sequence_rate(truth), sequence_size(truth)) == (10.0, (640, 480))


def walking(unit: float = 1.0, people: int = 2, frames: int = 40, heights: float = 1.7) -> Trajectories:
    """People who walk at 1.5 m/s side by side, at 15 frames per second, in another unit."""
    frame, person = np.repeat(np.arange(frames), people), np.tile(np.arange(people), frames)
    xy = np.column_stack([0.1 * frame, 2.0 * person])
    return positions_table(frame, person, xy * unit, np.full(len(xy), heights * unit), frame / 15)


@pytest.mark.parametrize(
    ("table", "odd"),
    [
        (walking(), ""),
        (walking(100.0), "2 of 2 people would be 170 m tall, 2 of 2 people would be 150 m/s fast: another unit"),
        (walking(0.01), "2 of 2 people would be 0.017 m tall, all 2 people would be within 0.039 m"),
        (walking(people=50, frames=3), "50 people would pass in 3 frames"),
        (walking(heights=np.nan), ""),
        (two_walkers(0), ""),
    ],
)
def test_people_of_impossible_size_speed_or_number_are_doubted(table, odd):
    assert doubt(table).startswith(odd)
    assert bool(doubt(table)) == bool(odd)


def test_doubts_are_said_when_a_table_is_read(tmp_path):
    write_file(tmp_path / "x.txt", TrajectoryFile(walking(100.0), 15.0), "pedpy")
    with pytest.warns(UserWarning, match="170 m tall"):
        load_tracks(tmp_path / "x.txt")


def test_positions_that_flicker_or_jump_are_no_doubt():
    table = walking()
    table.x_m[::3] += 0.3  # 9 m/s from frame to frame
    table.x_m[table.frame > 30] += 20.0
    assert doubt(table) == ""


FRACTIONS = "1,7,0.3,0.4,0.1,0.2,1\n"
CORNERS = "".join(f"{k},7,{50 * k},20,{50 * k + 30 + k % 3},90,1\n" for k in range(1, 12))


@pytest.mark.parametrize(
    ("read", "name", "text", "message"),
    [
        (load_tracks, "a.txt", FRACTIONS, "fractions of the image"),
        (load_detections, "a.txt", FRACTIONS, "fractions of the image"),
        (load_tracks, "a.txt", CORNERS, "found left, top, right, bottom"),
        (load_detections, "a.txt", CORNERS, "found left, top, right, bottom"),
        (load_tracks, "a.txt", "1,7,10,20,30,60\n1,7,10,20,wide,60\n", "found in line 2 '1,7,10,20,wide,60'"),
        (load_detections, "a.json", '[{"image_id": 1, "category_id": 1, "bbox": [1, 2, 0, 60]}]', "frame 1 1,2,0,60"),
        (load_detections, "a.json", '[{"image_id": 1, "category_id": 3, "bbox": [1, 2, 3, 6]}]', "found category 3"),
        (load_tracks, "a.csv", "pedID,time,posX,posY\n1,0.0,far,2.0\n", "rows of id time x y, found .*'far'"),
        (
            load_truth,
            "a.csv",
            "frame,id,x_m,y_m,height_m,visible\n1,2,3,4,1.7,99\n",
            "of 0 to 1 .*, found 99",
        ),
        (load_tracks, "a.jsonl", '{"frame": 1, "id": 1, "x": 2}', "a place .* or a box, found neither"),
        (load_tracks, "a.json", '[{"frame": 1}]', "found a JSON list: write an object for each frame"),
        (load_tracks, "a.trc", "version 4\n2\n", r"found pixels of PeTrack: export its \.txt"),
        *(
            (load_truth, "a.txt", f"1,7,10,20,30,60,{end}\n", "truth rows that count")
            for end in ("1,2,1.0", "1,15,1.0", "1,0,1.0", "0,1,1.0", "0,-1,-1,-1")
        ),
    ],
)
def test_file_is_refused_for_what_is_wrong_in_it(tmp_path, read, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message):
        read(tmp_path / name)


def test_text_is_written_as_its_format_asks(tmp_path):
    write_file(tmp_path / "x.txt", TrajectoryFile(two_walkers(1), 15.0), "pedpy", "cm")
    rows = "1 0 -50.00 100.00 175.00\n2 0 50.00 100.00 162.00\n"
    assert (tmp_path / "x.txt").read_text() == "# framerate: 15 fps\n# id frame x/cm y/cm z/cm\n" + rows
    FORMATS["motchallenge"].write(tmp_path / "x.txt", TrajectoryFile(two_walkers(1)))
    assert (tmp_path / "x.txt").read_text().startswith("1,1,100.0,50.0,40.0,120.0,1,-0.5000,1.0000,0.0000\n")


def test_motchallenge_has_a_confidence_of_1_where_it_is_unknown(tmp_path):
    table = two_walkers()
    table.confidence[0] = 0.75
    FORMATS["motchallenge"].write(tmp_path / "x.txt", TrajectoryFile(table))
    assert [line.split(",")[6] for line in (tmp_path / "x.txt").read_text().splitlines()[:2]] == ["0.75", "1"]


def test_dates_of_a_table_become_seconds(tmp_path):
    rows = "0,2023-10-29 02:59:59.9,1,0,0,1.7\n1,2023-10-29 03:00:00,1,0,0,1.7\n"
    (tmp_path / "t.csv").write_text(f"frame,timestamp_s,id,x_m,y_m,height_m\n{rows}")
    assert np.diff(load_tracks(tmp_path / "t.csv").timestamp_s) == pytest.approx(0.1, abs=1e-6)


def test_dates_of_a_dataframe_become_seconds():
    times = pd.to_datetime(["2023-10-29T02:59:59.9+02:00", "2023-10-29T03:00:00.4+02:00"])
    rows = pd.DataFrame({"frame": [0, 1], "timestamp_s": times, "id": 1, "x_m": 0.0, "y_m": 0.0})
    assert np.diff(Trajectories.from_dataframe(rows).timestamp_s) == pytest.approx(0.5, abs=1e-6)


def walkers_at(*places: tuple[float, float]) -> Trajectories:
    """A person at each of some places, one a second."""
    columns = zip(*((n, n, float(n), x, y) for n, (x, y) in enumerate(places)), strict=True)
    return table_of(dict(zip(("frame", "id", "timestamp_s", "x_m", "y_m"), columns, strict=True)), "walkers")


@pytest.mark.parametrize(
    ("wkt", "words"),
    [
        ("POLYGON ((50 50, 60 50, 60 60, 50 60, 50 50))", "nobody is inside"),
        ("POLYGON ((-5000 -5000, 5000 -5000, 5000 5000, -5000 5000, -5000 -5000))", "another unit"),
        ("POLYGON ((0 0, 4 0, 4 3, 0 3, 0 0))", ""),
        ("POLYGON ((0 0, 90 0, 90 90, 0 90, 0 0))", ""),
    ],
)
def test_a_region_doubts_tracks_that_do_not_fit_it(wkt, words):
    doubt = Region(wkt, "region=").doubt(walkers_at((1.0, 1.0), (2.0, 2.0)))
    assert words in doubt
    assert bool(words) == bool(doubt)


def test_a_region_whose_border_crosses_itself_is_refused():
    with pytest.raises(InputError, match="cross itself"):
        Region("POLYGON ((-5 0, 5 12, 5 0, -5 12, -5 0))", "region=")


def test_rows_of_a_region_with_nobody_inside_keep_the_rate_of_all():
    file = TrajectoryFile(walkers_at((1.0, 1.0), (2.0, 2.0)))
    with pytest.warns(UserWarning, match="nobody is inside"):
        empty = limit(file, "POLYGON ((50 50, 60 50, 60 60, 50 60, 50 50))", None)
    assert (len(empty.table), empty.fps) == (0, 1.0)
