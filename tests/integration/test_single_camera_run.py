"""``planview run`` on videos of one camera: what it says when something is wrong with them."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.ground_camera import GroundCamera, save_ground_camera
from planview.cli import main
from planview.output.folder import read_run_info


@pytest.fixture
def still(tmp_path: Path) -> Path:
    path = tmp_path / "still.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10, (160, 120))
    for _ in range(20):
        writer.write(np.full((120, 160, 3), 90, np.uint8))
    writer.release()
    return path


def camera(folder: Path, width: int = 160) -> str:
    path = folder / "camera.toml"
    save_ground_camera(GroundCamera(width, 120, 130.0, 4.0, math.radians(60)), path)
    return str(path)


def tell(words: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    status = 0
    try:
        main(words)
    except SystemExit as end:
        status = int(end.code or 0)
    return status, capsys.readouterr().err


@pytest.mark.parametrize("tracker", ["human-model", "ellipse-particle"])
def test_video_without_motion_gives_no_people_and_says_why(
    tracker: str, still: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    given = ["--camera", camera(tmp_path)] if tracker == "human-model" else []
    status, told = tell(["run", str(still), "--tracker", tracker, "--out", str(out), *given], capsys)
    assert status == 0
    assert "nothing of a person's size moved in 20 frames" in told
    assert read_run_info(out / "run.json").remark.startswith("nothing")
    assert len((out / "tracks.csv").read_text().splitlines()) == 1


def test_camera_for_another_image_size_is_refused(
    still: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["run", str(still), "--tracker", "human-model", "--out", str(tmp_path / "out")]
    status, told = tell([*words, "--camera", camera(tmp_path, width=320)], capsys)
    assert status == 2
    assert "expected a camera for images of 160x120 px, found one for 320x120 px" in " ".join(told.split())


def test_truncated_video_is_refused(still: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(still.read_bytes()[:400])
    status, told = tell(["run", str(cut), "--tracker", "ellipse-particle", "--out", str(tmp_path / "out")], capsys)
    assert status == 2
    assert "cut.mp4: expected a video" in " ".join(told.split())
