"""Another detector's boxes, from the command line and from Python."""

import json
from pathlib import Path

import numpy as np
import pytest
from toy_recordings import write_frames

import planview
from calib.errors import InputError
from calib.ground_camera import save_ground_camera
from planview.cli import main
from planview.output.folder import read_run_info
from tests.human_model_world import CAMERA

PERSON = CAMERA.project(np.array([(0.0, 6.0, 0.0), (0.0, 6.0, 1.75)]))


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "street.avi"
    write_frames(path, [np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)] * 20)
    save_ground_camera(CAMERA, tmp_path / "camera.toml")
    return path


def status(words: list[str]) -> int:
    with pytest.raises(SystemExit) as end:
        main(words)
    return int(end.value.code or 0)


def box() -> list[float]:
    (u, bottom), (_, top) = PERSON
    height = bottom - top
    return [u - 0.15 * height, top, 0.3 * height, height]


def test_run_tracks_the_boxes_of_a_file_and_is_evaluated_as_any_run(video, tmp_path, capsys):
    rows = "".join(f"{i},-1,{','.join(map(str, box()))},1\n" for i in range(1, 21))
    (tmp_path / "det.txt").write_text(rows)
    truth = "".join(f"{i},0.0,6.0,1.75,7\n" for i in range(20))
    (tmp_path / "truth.csv").write_text("frame,x_m,y_m,height_m,id\n" + truth)
    out = tmp_path / "out"
    words = ["--detections", tmp_path / "det.txt", "--calibration", tmp_path / "camera.toml", "--out", out]
    assert status(["run", str(video), *map(str, words)]) == 0
    info = read_run_info(out / "run.json")
    assert (info.tracker, info.people) == ("detections", 1) and "det.txt" in info.notes[-1]
    capsys.readouterr()
    scored = ["evaluate", str(out / "tracks.csv"), str(tmp_path / "truth.csv")]
    assert status(scored) == 0
    printed = capsys.readouterr().out
    assert "idf1" in printed and status([*scored, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["idf1"] > 0.5
    assert status([*scored, "--boxes"]) == 2
    capsys.readouterr()
    assert status(["replay", str(out), "--frame", "5"]) == 2 and "--detections" in capsys.readouterr().err


def test_python_takes_an_array_per_frame(video, tmp_path):
    boxes = [np.array([box()])] * 20
    tracks = planview.run(video, detections=boxes, camera=tmp_path / "camera.toml")
    last = tracks.frame == 19
    assert tracks.y_m[last] == pytest.approx([6.0], abs=0.3)


def test_boxes_beyond_the_video_are_refused(video):
    with pytest.raises(InputError, match="found frame 21"):
        planview.open_engine(video, detections=[np.array([box()])] * 21)
