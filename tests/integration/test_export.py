"""``planview export``, of tracks for other programs and of the scene."""

from pathlib import Path

import numpy as np
import pytest
from toy_tracks import positions_table

from planview.api.tracks import export
from planview.output.render import scene_of
from planview.trajectories.formats import load_file
from planview.trajectories.table import write_table

AREA = "POLYGON ((-3 -1, 3 -1, 3 11, -3 11, -3 -1))"
SPEED_MPS, FPS, FRAMES = 1.5, 15, 90


@pytest.fixture
def tracks(tmp_path) -> Path:
    """tracks.csv of four people, 1 m apart in a square, who walk along y at 1.5 m/s."""
    frame = np.repeat(np.arange(FRAMES), 4)
    start = np.tile([(-0.5, 0.0), (0.5, 0.0), (-0.5, 1.0), (0.5, 1.0)], (FRAMES, 1))
    xy = start + np.column_stack([0 * frame, SPEED_MPS * frame / FPS])
    table = positions_table(frame, np.tile([1, 2, 3, 4], FRAMES), xy, timestamp_s=frame / FPS)
    path = tmp_path / "tracks.csv"
    with path.open("w") as file:
        write_table(file, table)
    return path


def test_pedpy_reads_the_positions_of_an_export(succeed, tracks):
    import pedpy

    out = tracks.with_name("tracks.txt")
    succeed("export", tracks, "--to", "pedpy", "--out", out)
    trajectory = pedpy.load_trajectory(trajectory_file=out)
    assert trajectory.frame_rate == FPS
    expected = load_file(tracks).table
    loaded = trajectory.data.sort_values(["frame", "id"])
    assert np.abs(loaded.x - expected.x_m).max() < 1e-3
    assert np.abs(loaded.y - expected.y_m).max() < 1e-3


def test_pedpy_reads_exports_with_their_walkable_area(succeed, tracks):
    import pedpy

    archive, database = tracks.with_name("t.h5"), tracks.with_name("t.sqlite")
    succeed("export", tracks, "--to", "ped-data-archive", "--out", archive, "--area", AREA)
    succeed("export", archive, "--to", "jupedsim", "--out", database)
    areas = [
        pedpy.load_walkable_area_from_ped_data_archive_hdf5(trajectory_file=archive),
        pedpy.load_walkable_area_from_jupedsim_sqlite(trajectory_file=database),
    ]
    assert [area.area for area in areas] == [72.0, 72.0]
    loaded = [
        pedpy.load_trajectory_from_ped_data_archive_hdf5(trajectory_file=archive),
        pedpy.load_trajectory_from_jupedsim_sqlite(trajectory_file=database),
    ]
    assert [(len(t.data), t.frame_rate) for t in loaded] == [(4 * FRAMES, FPS)] * 2


@pytest.mark.parametrize("to", ["pedpy", "ped-data-archive", "jupedsim", "motchallenge", "parquet", "jsonl"])
def test_evaluate_reads_exports(to, succeed, tracks, json_of):
    out = tracks.with_name("export")
    succeed("export", tracks, "--to", to, "--out", out)
    assert json_of("evaluate", tracks, out)["mota"] == 1.0
    assert json_of("evaluate", out, out)["idf1"] == 1.0


def test_json_lines_go_to_standard_output(tracks, shown_by):
    assert len(shown_by("export", tracks, "--to", "jsonl", "--out", "-").splitlines()) == FRAMES


def test_export_does_not_overwrite_its_input(refused, tracks):
    assert "choose another" in refused("export", tracks, "--to", "csv", "--out", tracks, "--overwrite")


def test_export_does_not_overwrite_unless_asked(succeed, refused, tracks):
    succeed("export", tracks, "--to", "csv")
    assert "--overwrite" in refused("export", tracks, "--to", "csv")
    succeed("export", tracks, "--to", "csv", "--overwrite")


def test_samples_of_other_programs_are_read_whole(shared_data):
    files = {
        "pedpy/ped_data_archive_text.txt": (63110, 25.0),
        "pedpy/ped_data_archive_hdf5.h5": (30701, 25.0),
        "pedpy/jupedsim_v2.sqlite": (65482, 25.0),
        "petrack/correct_perspective_truth.txt": (1420, 25.0),
        "petrack/multiColorMarkerWithAruco_truth.txt": (98, 50.0),
        "petrack/codeMarker_truth.txt": (0, 25.0),
        "motchallenge/gt/TUD-Stadtmitte/gt/gt.txt": (1156, None),
    }
    loaded = {name: load_file(shared_data / "recordings" / name) for name in files}
    assert {name: (len(file.table), file.fps) for name, file in loaded.items()} == files


def test_most_points_of_an_empty_room_lie_on_its_floor(recording):
    pytest.importorskip("open3d")
    cloud = scene_of(recording)
    points = np.asarray(cloud.points)
    assert points.shape == np.asarray(cloud.colors).shape
    assert np.median(np.abs(points[:, 2])) < 0.03


def test_cloud_of_a_recording_is_a_ply_file(succeed, recording, tmp_path):
    pytest.importorskip("open3d")
    succeed("export", recording, "--cloud", tmp_path / "new" / "scene.ply")
    assert (tmp_path / "new" / "scene.ply").read_bytes()[:3] == b"ply"


@pytest.mark.parametrize("words", [["--cloud", "scene.txt"], [], ["--cloud", "a.ply", "--to", "csv"]])
def test_export_without_a_known_format_is_refused(refused, recording, words):
    assert "--to" in refused("export", recording, *words) or words[-1] == "scene.txt"


@pytest.mark.parametrize(("to", "ids"), [("pedpy", [1, 2]), ("motchallenge", [1]), ("csv", [1])])
def test_a_walk_after_the_end_of_a_track_has_an_id_of_its_own_where_ids_are_walks(to, ids, tmp_path):
    frame = np.concatenate([np.arange(20), np.arange(100, 120)])
    boxes = np.tile([10.0, 10.0, 40.0, 170.0], (40, 1))
    table = positions_table(frame, np.ones(40, int), np.zeros((40, 2)), timestamp_s=frame / FPS, box_px=boxes)
    written = export(table, to, out=tmp_path / "export")
    assert np.unique(load_file(written.value).table.track_id).tolist() == ids
    assert written.values["people"] == 1


FORMATS = "csv", "jsonl", "pedpy", "ped-data-archive", "jupedsim", "motchallenge", "parquet"


@pytest.mark.parametrize("to", FORMATS)
def test_a_table_without_a_row_is_nobody_in_every_format(to, succeed, tmp_path):
    empty = positions_table(np.empty(0, int), np.empty(0, int), np.empty((0, 2)))
    with (tmp_path / "tracks.csv").open("w") as file:
        write_table(file, empty)
    succeed("export", tmp_path / "tracks.csv", "--to", to, "--out", tmp_path / "export")
    assert len(load_file(tmp_path / "export").table) == 0


@pytest.mark.parametrize("command", ["count", "plot", "density", "evaluate"])
def test_every_command_takes_tracks_of_nobody(command, succeed, tmp_path):
    nobody = tmp_path / "tracks.csv"
    nobody.write_text("frame,id,x_m,y_m,height_m\n")
    rules = tmp_path / "rules.toml"
    rules.write_text('[[tripwire]]\nname = "door"\nfrom_m = [0, 0]\nto_m = [1, 0]\n')
    words = {
        "count": ("count", nobody, "--rules", rules),
        "plot": ("plot", nobody),
        "density": ("plot", nobody, "--what", "density"),
        "evaluate": ("evaluate", nobody, nobody),
    }
    written = {"count": "counts.json", "plot": "plot.png", "density": "plot.png"}
    succeed(*words[command])
    assert (tmp_path / written.get(command, "tracks.csv")).stat().st_size > 0


def test_nobody_in_a_region_is_exported_at_the_rate_of_the_tracks(tracks):
    away = "POLYGON ((50 50, 51 50, 51 51, 50 50))"
    written = export(tracks, "pedpy", region=away, out=tracks.with_name("t.txt"))
    assert [written.values[name] for name in ("rows", "people", "fps")] == [0, 0, FPS]
