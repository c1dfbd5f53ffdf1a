"""Recordings of one camera and of two, as the calibration page opens them."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.errors import InputError
from planview.calibration.page.session import open_session
from planview.synthetic.assets import DEMO


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames of the demo with both views side by side, and its calibration beside them."""
    folder = tmp_path_factory.mktemp("pair")
    sides = [cv2.VideoCapture(str(DEMO / f"{side}.mp4")) for side in ("left", "right")]
    frames = [np.hstack([side.read()[1] for side in sides]) for _ in range(6)]
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(folder / "both.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 15.0, (width, height))
    for frame in frames:
        writer.write(frame)
    writer.release()
    shutil.copy(DEMO / "rig.toml", folder)
    return folder / "both.mp4"


def test_page_opens_a_side_by_side_video_as_a_stereo_recording(video: Path) -> None:
    for path in (video, video.parent):
        session = open_session(path)
        assert session.view is not None and session.size[0] == session.view.image.shape[1]


def test_page_takes_the_calibration_of_a_side_by_side_video_from_elsewhere(video: Path, tmp_path: Path) -> None:
    shutil.copy(video, tmp_path)
    with pytest.raises(InputError, match="expected a stereo calibration"):
        open_session(tmp_path / video.name)
    assert open_session(tmp_path / video.name, video.parent / "rig.toml").view is not None


def test_page_refuses_a_stereo_calibration_for_one_camera(tmp_path: Path) -> None:
    shutil.copy(DEMO / "left.mp4", tmp_path / "one.mp4")
    assert open_session(tmp_path / "one.mp4").view is None
    with pytest.raises(InputError, match="needs both cameras"):
        open_session(tmp_path / "one.mp4", DEMO / "rig.toml")


def test_every_frame_of_a_video_can_be_shown_one_by_one(video: Path, tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "one.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    for level in range(100):
        writer.write(np.full((48, 64, 3), 2 * level, np.uint8))
    writer.release()
    session = open_session(tmp_path / "one.avi")
    assert len(session.frames) == 100 and list(session.indices) == list(range(100))
    for _ in range(57):
        session.show(session.shown + 1)
    assert float(session.frames[session.shown].mean()) == pytest.approx(114, abs=2)
    session.show(99)
    assert float(session.frames[session.shown].mean()) == pytest.approx(198, abs=2)


def test_more_people_are_asked_for_only_where_something_moved(tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "one.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (320, 240))
    for i in range(40):
        picture = np.full((240, 320, 3), 90, np.uint8)
        picture[100:160, 4 * i : 4 * i + 20] = 220  # somebody walks through the left half
        writer.write(picture)
    writer.release()
    walked = open_session(tmp_path / "one.avi").walked
    assert walked is not None and walked[130, 60] and not walked[130, 260] and not walked[30, 60]
