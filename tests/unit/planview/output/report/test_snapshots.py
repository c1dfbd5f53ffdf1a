"""Pictures of the scene in the report."""

import base64
import json
from pathlib import Path

import cv2
import numpy as np

from calib.types import U8
from planview.output.report.page import errors_of, scores_of
from planview.output.report.snapshots import busiest_frame, scene_pictures
from planview.output.results import read_results
from planview.output.scene import open_frames


def decoded(uri: str) -> U8:
    data = base64.b64decode(uri.partition(",")[2])
    return np.asarray(cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR), dtype=np.uint8)


def test_busiest_frame_is_the_middle_of_the_longest_stretch_with_the_most_people(street: Path) -> None:
    assert busiest_frame(read_results(street)) == 4


def test_scene_is_pictured_from_the_recording_opened_again(street: Path) -> None:
    results = read_results(street)
    errors = errors_of(scores_of(results))
    assert [(error.kind, error.frame) for error in errors] == [("lost", 10)]
    pictures = scene_pictures(results, errors)
    assert pictures.why_none == ""
    assert pictures.overview[0].title == "Busiest frame"
    assert decoded(pictures.overview[0].data).shape == (480, 640, 3)
    (strip,) = pictures.errors
    assert strip.is_strip
    assert decoded(strip.data).shape[1] > 4 * decoded(strip.data).shape[0]


def test_frame_is_the_one_asked_for(street: Path) -> None:
    images = {frame: int(np.median(image)) for frame, image in open_frames(read_results(street).info).at([3, 7, 20])}
    assert images == {3: 103, 7: 107, 20: 120}


def test_recording_that_is_gone_gives_a_sentence_instead_of_pictures(street: Path) -> None:
    info = json.loads((street / "run.json").read_text())
    (street / "run.json").write_text(json.dumps({**info, "input": "gone"}))
    pictures = scene_pictures(read_results(street), [])
    assert pictures.overview == []
    assert "gone: expected the recording of the run, found nothing there" in pictures.why_none
