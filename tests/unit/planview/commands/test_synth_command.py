"""``planview synth`` and ``python -m benchmarks accuracy``: what they write and refuse."""

import csv

import cv2
import pytest

from benchmarks.__main__ import main_benchmarks
from benchmarks.options import Rendering, rendered, scene_files
from calib.formats import load_rig
from calib.ground_camera import load_ground_camera
from calib.world import load_world
from planview.synthetic.scene import load_scene
from planview.trajectories.table import read_truth
from stereo.readers import open_recording, open_video

SCENE = """
fps = 10
duration_s = 0.4
[rig]
width = 96
height = 72
focal_px = 70
at_m = [3, 0.3, 2.4]
[[people]]
start_m = [3, 3]
"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


def test_synth_writes_a_recording_that_our_reader_takes(scene, tmp_path, json_of):
    out = tmp_path / "out"
    told = json_of("synth", scene, out, "--frames", 3, "--world", "--opencv")
    assert told == {"frames": 3, "truth_rows": 3, "folder": str(out)}
    recording = open_recording(out)
    assert [f.left.shape for f in recording] == [(72, 96, 3)] * 3
    assert [f.timestamp_s for f in recording] == pytest.approx([0, 0.1, 0.2])
    assert load_world(out / "world.toml").height_m == pytest.approx(2.4)
    assert read_truth(out / "truth.csv").frame.tolist() == [0, 1, 2]


def test_synth_writes_the_same_calibration_for_opencv(scene, tmp_path, say):
    out = tmp_path / "out"
    say("synth", scene, out, "--frames", 1, "--opencv")
    rig = load_rig(out / "rig.toml")
    inner = cv2.FileStorage(str(out / "intrinsics.yml"), cv2.FILE_STORAGE_READ)
    outer = cv2.FileStorage(str(out / "extrinsics.yml"), cv2.FILE_STORAGE_READ)
    assert inner.getNode("M1").mat() == pytest.approx(rig.left.matrix)
    assert outer.getNode("T").mat().ravel() == pytest.approx(rig.right_SE3_left.translation)


def test_synth_of_one_camera_writes_images_camera_and_boxes(scene, tmp_path, say):
    scene.write_text(SCENE.replace("[rig]", "[camera]"))
    out = tmp_path / "out"
    assert say("synth", scene, out)[0] == 0
    assert load_ground_camera(out / "camera.toml").size == (96, 72)
    assert len(list(open_video(out))) == 4
    with (out / "truth.csv").open() as file:
        row = next(csv.DictReader(file))
    assert float(row["height_px"]) == float(row["full_height_px"]) > 20


def test_synth_writes_videos_on_request(scene, tmp_path, say):
    out = tmp_path / "out"
    assert say("synth", scene, out, "--video")[0] == 0
    assert len(list(open_recording(out))) == 4


@pytest.mark.parametrize("arguments", [("--frames", "0"), ("--scale", "99"), ("--video", "--jpeg")])
def test_synth_refuses_wrong_usage(scene, tmp_path, arguments, refused):
    assert "expected" in refused("synth", scene, tmp_path / "out", *arguments)


def test_synth_never_writes_into_a_folder_in_use(scene, tmp_path, refused):
    assert "in use" in refused("synth", scene, tmp_path)


def test_rendered_recording_is_kept_and_found_again(scene, tmp_path):
    told = []
    options = Rendering(tmp_path / "cache", 1.0, 1)
    first = rendered(load_scene(scene), "s", options, told.append)
    assert rendered(load_scene(scene), "s", options, told.append) == first
    assert told == ["rendering s"]
    scene.write_text(SCENE.replace("2.4", "2.5"))
    assert rendered(load_scene(scene), "s", options, told.append) != first


def test_accuracy_knows_its_scenes(capsys):
    assert {"crossing", "group", "office", "shadows", "eight", "furniture"} <= {p.stem for p in scene_files()}
    with pytest.raises(SystemExit, match="2"):
        main_benchmarks(["accuracy", "--scene", "nothing"])
    assert "crossing" in capsys.readouterr().err
