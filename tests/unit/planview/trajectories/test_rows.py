"""Rows of text whose columns a line names, or none."""

import numpy as np
import pytest
from toy_recordings import table_file

from calib.errors import InputError
from planview.trajectories.formats import (
    load_file,
    load_tracks,
    load_truth,
)


def test_laboratory_rows_become_si_units(tmp_path):
    tracks = load_tracks(table_file(tmp_path, "3 32 100 -50 175\n"))
    assert (tracks.track_id[0], tracks.frame[0], tracks.timestamp_s[0]) == (3, 32, 2.0)
    assert (tracks.x_m[0], tracks.y_m[0], tracks.height_m[0]) == (1.0, -0.5, 1.75)


def test_our_own_truth_is_recognised_by_its_header(tmp_path):
    assert load_truth(table_file(tmp_path, "frame,id,x_m,y_m,height_m\n0,1,2,3,1.8\n")).height_m[0] == 1.8


def test_petrack_text_in_centimetres_is_read_in_metres(tmp_path):
    path = tmp_path / "cm.txt"
    path.write_text("# framerate: 50 fps\n# id frame x/cm y/cm z/cm markerID\n7 3 -130.147 20 180 999\n")
    file = load_file(path)
    assert file.fps == 50.0
    assert (file.table.track_id[0], file.table.frame[0]) == (7, 3)
    assert (file.table.x_m[0], file.table.y_m[0], file.table.height_m[0]) == pytest.approx((-1.30147, 0.2, 1.8))


@pytest.mark.parametrize(
    "text",
    [
        "# framerate: 15\n# frame id x/m y/m z/m\n30 7 1.5 2.5 1.75\n",
        "# fps: 15\n# id frame y/m x/m z/m\n7 30 2.5 1.5 1.75\n",
        "# framerate: 15\n\n# PersID\tFrame\tX/cm\tY/cm\tZ/cm\n7\t30\t150\t250\t175\n",
        "# framerate: 15\n# positions in cm\n# FrameID PedestrianID X Y Z\n30 7 150 250 175\n",
        "# framerate: 15\nframe_number,Y_world (mm),X_world [mm],height [cm],ped_id\n30,2500,1500,175,7\n",
        "frame;time [ms];agent_id;x;y;x_world_m;y_world_m;z_m\n30;2000;7;640;480;1.5;2.5;1.75\n",
    ],
)
def test_columns_are_those_that_a_line_names(tmp_path, text):
    table = load_tracks(table_file(tmp_path, text))
    assert (table.frame[0], table.track_id[0], table.timestamp_s[0]) == (30, 7, 2.0)
    assert (table.x_m[0], table.y_m[0], table.height_m[0]) == pytest.approx((1.5, 2.5, 1.75))


def test_height_without_a_unit_has_that_of_x(tmp_path):
    table = load_tracks(table_file(tmp_path, "# id frame x/cm y/cm z\n7 30 150 250 175\n"))
    assert (table.x_m[0], table.height_m[0]) == (1.5, 1.75)


@pytest.mark.parametrize("text", ["# id frame x y\n7 30 1.5 2.5\n", "frame,id,x,y\n30,7,1.5,2.5\n"])
def test_positions_without_a_unit_are_refused(tmp_path, text):
    with pytest.raises(InputError, match="x/cm"):
        load_tracks(table_file(tmp_path, text))


@pytest.mark.parametrize(
    ("unit", "exchanged", "taken"),
    [
        (0.01, False, "taken as id frame x y, centimetres, 16 frames per second"),
        (0.01, True, "taken as frame id x y, centimetres, 16 frames per second"),
        (1.0, True, "taken as frame id x y, metres"),
    ],
)
def test_rows_without_names_are_taken_as_paths_that_are_smooth(tmp_path, unit, exchanged, taken):
    rows = [(person, frame, 3.0 * person + 0.1 * frame, 2.0) for person in (1, 2) for frame in range(8)]
    lines = [f"{a} {b} {x / unit:.1f} {y / unit:.1f}\n" for a, b, x, y in rows]
    lines = [" ".join([b, a, *more]) + "\n" for a, b, *more in map(str.split, lines)] if exchanged else lines
    with pytest.warns(UserWarning, match=taken):
        table = load_tracks(table_file(tmp_path, "".join(lines)))
    assert np.unique(table.track_id).tolist() == [1, 2]
    assert table.x_m[0] == pytest.approx(3.0)


VADERE = "#IDXCOL=2,DATACOL=2\npedestrianId simTime endTime-PID1 startX-PID1 startY-PID1\n"


@pytest.mark.parametrize(
    "text",
    [
        VADERE + "1 0.0 0.4 1.0 2.0\n1 0.4 0.8 1.5 2.0\n2 0.4 0.8 7.0 2.0\n",
        "id,name,t,x,y\n,,s,m,m\n1,a,0.0,1.0,2.0\n1,a,0.4,1.5,2.0\n2,b,0.4,7.0,2.0\n",
        "pedID,time,posX,posY\n1,0.0,1.0,2.0\n1,0.4,1.5,2.0\n2,0.4,7.0,2.0\n",
        "$VISION\n* comment\n$PEDESTRIAN:NO;SIMSEC;COORDCENTX;COORDCENTY\n1;0.0;1.0;2.0\n1;0.4;1.5;2.0\n2;0.4;7;2\n",
    ],
    ids=["vadere", "pathfinder", "crowdit", "viswalk"],
)
def test_tables_of_simulations_are_read(tmp_path, text):
    file = load_file(table_file(tmp_path, text))
    assert file.fps == pytest.approx(2.5)
    assert file.table.frame.tolist() == [0, 1, 1]
    assert (file.table.track_id.tolist(), file.table.x_m.tolist()) == ([1, 1, 2], [1.0, 1.5, 7.0])


@pytest.mark.parametrize("between", ["\t", ";"])
@pytest.mark.parametrize("names", ["frame id x_m y_m height_m visible", "Frame Ped_ID X[m] Y[m] Height[m] Visibility"])
def test_tables_of_spreadsheets_are_read_with_all_they_hold(tmp_path, between, names):
    text = f"{names}\n3 7 1,5 2,5 1,75 0,5\n".replace(" ", between)
    table = load_file(table_file(tmp_path, text), truth=True).table
    row = table.frame, table.track_id, table.x_m, table.y_m, table.height_m, table.visible
    assert [column.tolist() for column in row] == [[3], [7], [1.5], [2.5], [1.75], [0.5]]


def test_columns_of_a_table_with_times_for_frames_are_kept(tmp_path):
    table = load_file(table_file(tmp_path, "id,t_s,x,y,z,visible\n1,0,0,0,1.7,1\n1,.1,1,0,1.7,0.5\n")).table
    assert (table.height_m.tolist(), table.visible.tolist()) == ([1.7, 1.7], [1.0, 0.5])


def test_times_of_a_clock_begin_at_the_first(tmp_path):
    file = load_file(table_file(tmp_path, "id,time,x,y\n1,1700000000.0,0,0\n1,1700000000.1,1,0\n"))
    assert file.table.frame.tolist() == [0, 1]
    assert file.note == "times begin at 1700000000 s: frame 0 is then"


def test_footsteps_of_vadere_are_interpolated_to_even_times(tmp_path):
    file = load_file(table_file(tmp_path, VADERE + "1 0.0 0.6 0 0\n1 0.63 1 0.63 0\n1 1.0 1.5 1.0 0\n"))
    assert file.fps == 10.0
    assert "interpolated to 10 frames per second" in file.note
    np.testing.assert_allclose(file.table.x_m, np.arange(11) / 10)


@pytest.mark.parametrize(
    "text",
    [
        "id,time,x,y\n1,2023-10-29T02:59:59.9+02:00,0,0\n1,2023-10-29T02:00:00.0+01:00,1,0\n",
        "id,time,x,y\n1,30.11.2026 10:11:00.0,0,0\n1,30.11.2026 10:11:00.1,1,0\n",
        "id,time,x,y\n1,20261130T101100.0,0,0\n1,20261130T101100.1,1,0\n",
        "id,timestamp_ns,x,y\n1,0,0,0\n1,100000000,1,0\n",
        "id,time [us],x,y\n1,0,0,0\n1,100000,1,0\n",
    ],
)
def test_rows_by_time_have_their_rate_in_whatever_way_times_are_written(tmp_path, text):
    assert load_file(table_file(tmp_path, text)).fps == pytest.approx(10.0, rel=1e-4)


@pytest.mark.parametrize("second", [100, 1e-6])
def test_times_of_another_unit_than_seconds_are_refused(tmp_path, second):
    with pytest.raises(InputError, match="time_ms"):
        load_tracks(table_file(tmp_path, f"time id x_m y_m\n0 1 0 4\n{second} 1 0.1 4\n"))


def test_times_rounded_to_milliseconds_keep_their_rate(tmp_path):
    rows = "".join(f"{n / 15:.3f} 1 {n / 15:.3f} 4\n" for n in range(600))
    assert load_file(table_file(tmp_path, "time id x_m y_m\n" + rows)).fps == pytest.approx(15.0, rel=1e-4)


TWO_SECONDS = "# framerate: 15\n# id frame x/m y/m\n" + "".join(f"1 {n} 0 4\n" for n in range(31))


@pytest.mark.parametrize(("rate", "step"), [(1, 15), (10, 1), (25, 1), (50, 1)])
def test_truth_without_frames_has_those_of_the_tracks_near_its_rows(tmp_path, rate, step):
    tracks = load_tracks(table_file(tmp_path, TWO_SECONDS))
    rows = "".join(f"{n / rate} 7 {n / rate} 4\n" for n in range(2 * rate + 1))
    truth = load_truth(table_file(tmp_path, "time id x_m y_m\n" + rows), tracks)
    np.testing.assert_allclose(15 * truth.x_m, np.arange(0, 31, step))
    np.testing.assert_array_equal(truth.frame, np.arange(0, 31, step))
