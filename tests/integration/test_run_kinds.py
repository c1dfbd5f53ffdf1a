"""``planview run`` on maps, several sensors, the boxes of a detector, and a pair at two paths."""

import math
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from toy_recordings import video_pair, write_frames
from toy_run import EMPTY, FEW, FRAMES, run_few

import planview
from calib.errors import InputError
from calib.ground_camera import save_ground_camera
from calib.world import load_rigs, save_rigs
from planview.engine.engine import FrameResult
from planview.engine.open import engine_of, open_engine
from planview.maps.recording import MapsRecording
from planview.output.folder import read_run_info
from planview.output.run import run
from planview.output.run_spec import RunSpec
from planview.trajectories.table import read_tracks
from stereo.readers import OpenOptions, open_recording
from tests.human_model_world import CAMERA

PRODUCTS = ("tracks.csv", "decisions.csv")


@pytest.fixture(scope="module")
def live(engine, tmp_path_factory) -> tuple[Path, list[FrameResult]]:
    """The folder of a run that saved its maps, and its results."""
    folder = tmp_path_factory.mktemp("live")
    results = []
    run(engine, RunSpec(folder, maps=True), [results.append])
    return folder, results


@pytest.fixture
def maps(live, tmp_path) -> Path:
    """A copy to be damaged."""
    return Path(shutil.copy(live[0] / "maps.h5", tmp_path / "maps.h5"))


def test_maps_are_tracked_again_bit_for_bit(succeed, live, maps, tmp_path):
    succeed("run", maps, "--out", tmp_path / "again")
    for name in PRODUCTS:
        assert (tmp_path / "again" / name).read_bytes() == (live[0] / name).read_bytes()
    again, before = read_run_info(tmp_path / "again" / "run.json"), read_run_info(live[0] / "run.json")
    assert (again.floor, again.rig, again.config) == (before.floor, before.rig, before.config)
    assert again.frames_read == FRAMES


def test_maps_built_from_the_recording_are_those_of_the_run(live, engine):
    recording = MapsRecording(live[0] / "maps.h5")
    again = list(engine_of(recording))
    assert len(again) == len(live[1]) == FRAMES
    for before, after in zip(live[1], again, strict=True):
        old, new = before.observation.maps, after.observation.maps
        np.testing.assert_array_equal(new.height, old.height, strict=True)
        np.testing.assert_array_equal(new.occupancy, old.occupancy, strict=True)
        for name in ("xyz", "area", "pixels", "colours"):
            np.testing.assert_array_equal(getattr(new.points, name), getattr(old.points, name), strict=True)
        assert after.tracks == before.tracks


def test_another_tracker_follows_the_same_maps(succeed, maps, tmp_path):
    out = tmp_path / "out"
    succeed("run", maps, "--out", out, "--tracker", "template", "--set", "seed=3")
    info = read_run_info(out / "run.json")
    assert (info.tracker, info.config["seed"], info.frames_read) == ("template", 3, FRAMES)


def test_the_command_saves_maps_without_any_image(succeed, copy, tmp_path):
    run_few(succeed, copy, tmp_path / "out", "--maps", "--frames", "12")
    with h5py.File(tmp_path / "out" / "maps.h5") as file:
        assert set(file["points"]) == {"pixel", "disparity", "appearance"}
        assert len(file["frames/index"]) == 12


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--set", "foreground.learning_rate=0.1"], "expected foreground as recorded"),
        (["--set", "maps.height_max_m=3"], "expected maps.height_max_m as recorded"),
        (["--tracker", "human-model"], "human-model"),
        (["--calibration", "rig.toml"], "rig.toml"),
        (["--maps"], "--maps"),
    ],
)
def test_words_that_do_not_go_with_maps_are_refused(refused, maps, tmp_path, words, named):
    assert named in refused("run", maps, "--out", tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()


def test_maps_are_not_replaced_by_their_own_tracking(refused, maps):
    assert "another folder" in refused("run", maps, "--out", maps.parent, "--overwrite")
    assert maps.exists()


def test_a_person_seen_by_two_sensors_is_one_person(succeed, sensors, engine, tmp_path):
    run_few(succeed, sensors, tmp_path / "out", "--rrd")
    tracks = read_tracks(tmp_path / "out" / "tracks.csv")
    assert set(tracks.track_id[tracks.state == "confirmed"]) == {1}
    info = read_run_info(tmp_path / "out" / "run.json")
    assert [camera.name for camera in info.rig.sensors] == ["left_one", "right_one"]
    assert (tmp_path / "out" / "run.rrd").stat().st_size > 0
    assert "right_one" in (tmp_path / "out" / "report.html").read_text()
    # Two sensors weigh against what was predicted as two looks do, so that places differ by some centimetres.
    alone = {(r.frame, t.track_id): t for r in engine for t in r.tracks}
    sure = tracks.where(tracks.state == "confirmed")
    known = [alone[key] for key in zip(sure.frame, sure.track_id, strict=True)]
    apart = np.hypot(sure.x_m - [track.x_m for track in known], sure.y_m - [track.y_m for track in known])
    assert np.median(apart) < 0.03
    assert apart.max() < 0.06


def test_a_rig_without_a_frame_is_left_out_of_that_moment(sensors, engine):
    together = open_engine(sensors, config=engine.config)
    frames = [frame for frame, _ in zip(together.recording, range(EMPTY + 6), strict=False)]
    for frame in frames[:-2]:
        both = together.step(frame)
    assert both.tracks
    assert all(view.depth for view in both.views)
    left = together.step(replace(frames[-2], shots=(frames[-2].shots[0], None)))
    assert left.views[1].depth is None
    assert left.depth is not None
    assert not left.views[1].shows
    right = together.step(replace(frames[-1], shots=(None, frames[-1].shots[1])))
    assert right.depth is None
    assert not right.views[0].shows
    assert right.views[1].shows
    assert [t.track_id for t in right.tracks] == [t.track_id for t in both.tracks]
    assert not math.isnan(right.tracks[0].box_px[0])


def test_check_compares_every_sensor(sensors):
    found = planview.check(sensors, frames=8, config={"analysis.setup_frames": 4})
    checks = {check.name: check for check in found.value}
    assert {"left_one: floor share", "right_one: floor share"} <= checks.keys()
    assert checks["left_one and right_one: people apart"].value < 0.05


def test_check_lists_what_every_sensor_holds(sensors):
    contents = planview.check(sensors, quick=True).to_json()
    assert [Path(sensor["path"]).name for sensor in contents["sensors"]] == ["left_one", "right_one"]


def test_check_refuses_one_calibration_for_several_sensors(refused, sensors):
    assert "whose sensors have their own" in refused("check", sensors, "--calibration", sensors)


def test_run_says_that_a_clock_of_one_sensor_is_wrong(succeed, sensors, tmp_path):
    entries = load_rigs(sensors / "rigs.toml")
    save_rigs([entries[0], replace(entries[1], start_s=0.7)], sensors / "late.toml")
    late = shutil.copytree(sensors, tmp_path / "late")
    (late / "late.toml").rename(late / "rigs.toml")
    printed = run_few(succeed, late, tmp_path / "out")
    assert "a clock or a pose in rigs.toml is wrong" in " ".join(printed.split())


def test_maps_of_several_sensors_are_not_saved(refused, sensors, tmp_path):
    assert "several sensors" in run_few(refused, sensors, tmp_path / "out", "--maps")


def test_calibration_asks_for_one_of_several_sensors(refused, sensors):
    assert "left_one" in refused("calibrate", "floor", sensors)


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("left_one", "left_one"), "every sensor once"),
        (("left_one", "right_one", "--clock", "-1"), "--clock"),
        (("left_one", "right_one", "--out", "left_one/rigs.toml"), "above all sensors"),
    ],
)
def test_sensors_that_cannot_be_aligned_are_refused_at_once(refused, sensors, words, found):
    assert found in refused("calibrate", "align", *(sensors / w if w[0] in "lr" else w for w in words))


PERSON = CAMERA.project(np.array([(0.0, 6.0, 0.0), (0.0, 6.0, 1.75)]))


@pytest.fixture
def video(tmp_path) -> Path:
    path = tmp_path / "street.avi"
    write_frames(path, [np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)] * 20)
    save_ground_camera(CAMERA, tmp_path / "camera.toml")
    return path


def box() -> list[float]:
    (u, bottom), (_, top) = PERSON
    height = bottom - top
    return [u - 0.15 * height, top, 0.3 * height, height]


def test_run_tracks_the_boxes_of_a_file(video, tmp_path, succeed, json_of, refused):
    rows = "".join(f"{i},-1,{','.join(map(str, box()))},1\n" for i in range(1, 21))
    (tmp_path / "det.txt").write_text(rows)
    truth = "".join(f"{i},0.0,6.0,1.75,7\n" for i in range(20))
    (tmp_path / "truth.csv").write_text("frame,x_m,y_m,height_m,id\n" + truth)
    out = tmp_path / "out"
    words = ["--detections", tmp_path / "det.txt", "--calibration", tmp_path / "camera.toml", "--out", out]
    succeed("run", video, *words)
    info = read_run_info(out / "run.json")
    assert (info.tracker, info.people) == ("detections", 1)
    assert "det.txt" in info.notes[-1]
    scored = ["evaluate", out / "tracks.csv", tmp_path / "truth.csv"]
    assert json_of(*scored)["idf1"] > 0.5
    refused(*scored, "--boxes")
    assert "your own detections" in refused("replay", out, "--frame", "5")


def test_python_takes_an_array_per_frame(video, tmp_path):
    boxes = [np.array([box()])] * 20
    tracks = planview.run(video, detections=boxes, calibration=tmp_path / "camera.toml")
    last = tracks.frame == 19
    assert tracks.y_m[last] == pytest.approx([6.0], abs=0.3)


def test_boxes_beyond_the_video_are_refused(video):
    with pytest.raises(InputError, match="found frame 21"):
        planview.open_engine(video, detections=[np.array([box()])] * 21)


@pytest.fixture(scope="module")
def two(recording, tmp_path_factory) -> tuple[Path, Path, Path]:
    """Folders of the left and the right camera in different places, and the calibration in a third one."""
    place = tmp_path_factory.mktemp("two")
    left, right, rig = place / "north" / "images", place / "south" / "pictures", place / "rigs" / "toy.toml"
    for target, source in ((left, recording / "left"), (right, recording / "right")):
        shutil.copytree(source, target)
    rig.parent.mkdir()
    shutil.copy(recording / "rig.toml", rig)
    return left, right, rig


@pytest.fixture(scope="module")
def out(two, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("out") / "run"
    left, right, rig = map(str, two)
    planview.run(left, right, calibration=rig, fps=15.0, out=str(folder), config={"analysis.setup_frames": 4})
    return folder


def test_run_of_two_folders_tracks_what_their_common_folder_gives(two, out, recording, succeed, tmp_path):
    left, right, rig = two
    succeed("run", left, right, "--calibration", rig, "--fps", 30, "--out", tmp_path / "two", "--set", FEW)
    run_few(succeed, recording, tmp_path / "one", "--fps", 30)
    tracks = [(folder / "tracks.csv").read_bytes() for folder in (tmp_path / "two", tmp_path / "one")]
    assert tracks[0] == tracks[1]
    assert tracks[0].count(b"\n") > 10


@pytest.mark.parametrize(("command", "printed"), [("render", "a.png"), ("replay", "tracked from")])
def test_both_paths_are_read_again(out, cli, tmp_path, command, printed):
    status, output = cli(command, out, "--frame", 20, "--out", tmp_path / "a.png")
    assert status == 0
    assert printed in output
    assert "only the floor" not in output
    assert (tmp_path / "a.png").is_file()


def test_check_takes_two_paths(two, json_of):
    left, right, rig = two
    found = json_of("check", left, right, "--quick", "--calibration", rig, "--fps", 15)
    assert found["kind"] == "stereo"
    assert found["frames"] == 36
    assert found["missing"] == []


def test_two_videos_are_the_pair_of_their_folder(tmp_path):
    (tmp_path / "pair").mkdir()
    folder = video_pair(tmp_path / "pair", (6, 6))
    frames = [frame.image for frame in open_recording(folder)]
    found = [frame.image for frame in open_recording(folder / "left.avi", OpenOptions(right=folder / "right.avi"))]
    assert len(found) == len(frames)
    assert all((a == b).all() for a, b in zip(found, frames, strict=True))


def test_a_second_path_with_nothing_there_is_named(two, refused):
    assert "gone: no such file or folder" in refused("run", two[0], "gone", "--out", "out")
