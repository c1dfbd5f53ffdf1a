"""Pictures of the scene in the report."""

import base64
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.images import write_image
from calib.types import U8
from planview.pipeline.config import Config
from planview.pipeline.info import CameraInfo, FloorInfo
from planview.runs.info import RunInfo, write_run_info
from planview.runs.report.moments import busiest_frame, scene_pictures
from planview.runs.report.scores import errors_of, scores_of
from planview.runs.scene.frames import open_frames
from planview.runs.scene.results import read_results

FRAMES = 30


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run over 30 grey images of one camera, with a truth in which person 1 is lost for 1.5 s."""
    video, out = tmp_path / "street", tmp_path / "out"
    video.mkdir()
    out.mkdir()
    for n in range(FRAMES):
        write_image(video / f"{n:03d}.png", np.full((120, 160), 100 + n, dtype=np.uint8))
    truth = "".join(f"{n},1,0.0,6.0,1.7\n" for n in range(FRAMES))
    (video / "truth.csv").write_text("frame,id,x_m,y_m,height_m\n" + truth)
    tracks = [f"{n},{n / 10:.4f},4,0.0,6.0,1.7,confirmed" for n in range(FRAMES) if not 10 <= n < 25]
    tracks += [f"{n},{n / 10:.4f},5,9.0,9.0,1.7,confirmed" for n in range(3, 6)]
    rows = sorted(tracks, key=lambda row: (int(row.split(",")[0]), int(row.split(",")[2])))
    (out / "tracks.csv").write_text("frame,timestamp_s,id,x_m,y_m,height_m,state\n" + "\n".join(rows) + "\n")
    floor = FloorInfo(height_m=3.0, tilt_deg=60.0, roll_deg=0.0)
    rig = CameraInfo(width=160, height=120, focal_px=120.0, lens="pinhole")
    config = Config().model_dump(mode="json")
    write_run_info(RunInfo(input=str(video), finished=True, config=config, rig=rig, floor=floor), out / "run.json")
    return out


def decoded(uri: str) -> U8:
    data = base64.b64decode(uri.partition(",")[2])
    return np.asarray(cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR), dtype=np.uint8)


def test_busiest_frame_is_the_middle_of_the_longest_stretch_with_the_most_people(folder: Path) -> None:
    assert busiest_frame(read_results(folder)) == 4


def test_scene_is_pictured_from_the_recording_opened_again(folder: Path) -> None:
    results = read_results(folder)
    errors = errors_of(scores_of(results))
    assert [(error.kind, error.frame) for error in errors] == [("lost", 10)]
    pictures = scene_pictures(results, errors)
    assert pictures.why_none == ""
    assert pictures.overview[0].title == "Busiest frame"
    assert decoded(pictures.overview[0].data).shape == (480, 640, 3)
    (strip,) = pictures.errors
    assert strip.is_strip
    assert decoded(strip.data).shape[1] > 4 * decoded(strip.data).shape[0]


def test_frame_is_the_one_asked_for(folder: Path) -> None:
    images = {frame: int(np.median(image)) for frame, image in open_frames(read_results(folder).info).at([3, 7, 20])}
    assert images == {3: 103, 7: 107, 20: 120}


def test_recording_that_is_gone_gives_a_sentence_instead_of_pictures(folder: Path) -> None:
    info = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps({**info, "input": "gone"}))
    pictures = scene_pictures(read_results(folder), [])
    assert pictures.overview == []
    assert "gone: expected the recording of the run, found nothing there" in pictures.why_none
