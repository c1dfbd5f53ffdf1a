"""``planview calibrate board`` on OpenCV's public pairs, whole and damaged."""

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calib.formats import load_rig
from planview.cli import main


@pytest.fixture(scope="module")
def pairs(shared_data: Path) -> Path:
    return shared_data / "opencv-stereo-chessboard"


def copy(pairs: Path, folder: Path, numbers: tuple[str, ...]) -> Path:
    folder.mkdir(exist_ok=True)
    for number in numbers:
        for side in ("left", "right"):
            shutil.copy(pairs / f"{side}{number}.jpg", folder / f"{side}{number}.jpg")
            (folder / f"{side}{number}.jpg").chmod(0o644)
    return folder


SIX = ("01", "03", "05", "07", "09", "13")


def calibrated(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    with pytest.raises(SystemExit) as stop:
        main(["calibrate", "board", *arguments, "--json"])
    assert stop.value.code == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as stop:
        main(["calibrate", "board", *arguments])
    assert stop.value.code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert lines[-1].startswith("planview: ")
    return lines[-1]


def test_opencv_pairs_reach_the_accuracy_asked(pairs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "rig.toml"
    result = calibrated(capsys, str(pairs), "--square", "25mm", "--out", str(out))
    assert result["stereo_rms_px"] <= 0.25
    assert result["views_used"] == 13
    assert result["views_rejected"] == []
    assert result["baseline_m"] / 0.025 == pytest.approx(3.34, rel=0.01)
    assert load_rig(out, (640, 480)).baseline_m == pytest.approx(result["baseline_m"])
    assert load_rig(tmp_path / "rig.yml", (640, 480)).baseline_m == pytest.approx(result["baseline_m"])
    page = (tmp_path / "rig.html").read_text()
    assert page.count("data:image/") == 3
    assert "://" not in page


@pytest.mark.parametrize("kind", ["RGBA", "12 bits in 16"])
def test_small_images_of_a_named_board_give_the_rig(
    kind: str, pairs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in (*SIX, "02", "04"):
        for side in ("left", "right"):
            grey = cv2.imread(str(pairs / f"{side}{number}.jpg"), cv2.IMREAD_GRAYSCALE)
            assert grey is not None
            small = cv2.resize(grey, (320, 240), interpolation=cv2.INTER_AREA)
            stored = cv2.cvtColor(small, cv2.COLOR_GRAY2BGRA) if kind == "RGBA" else small.astype(np.uint16) * 16
            cv2.imwrite(str(tmp_path / f"{side}_{number}.png"), stored)
    out = ("--board", "9x6", "--square", "25mm", "--model", "brown", "--out", str(tmp_path / "rig.toml"))
    result = calibrated(capsys, str(tmp_path), *out)
    assert result["views_used"] == 8
    assert result["stereo_rms_px"] < 0.15
    assert result["baseline_squares"] == pytest.approx(3.34, rel=0.01)


def test_wrong_counts_are_refused(pairs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = copy(pairs, tmp_path / "p", SIX)
    said = refused(capsys, str(folder), "--square", "25mm", "--board", "8x6", "--out", str(tmp_path / "r.toml"))
    assert "expected a board of 8x6 inner corners (--board), found one of 9x6" in said


def test_swapped_images_are_refused(pairs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number in SIX:
        for side, other in (("left", "right"), ("right", "left")):
            shutil.copy(pairs / f"{side}{number}.jpg", tmp_path / f"{other}{number}.jpg")
    said = refused(
        capsys, str(tmp_path), "--square", "25mm", "--model", "brown", "--out", str(tmp_path / "o" / "r.toml")
    )
    assert "left and right are swapped" in said
    assert not (tmp_path / "o" / "r.toml").exists()


def test_too_few_blank_mixed_and_unreadable_images_are_refused(
    pairs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ("--square", "25mm", "--board", "9x6", "--out", str(tmp_path / "r.toml"))
    few = copy(pairs, tmp_path / "few", SIX[:2])
    assert "found 2 of 2" in refused(capsys, str(few), *out)
    mixed = copy(pairs, tmp_path / "mixed", SIX[:3])
    cv2.imwrite(str(mixed / "right03.jpg"), np.zeros((240, 320), np.uint8))
    assert "expected images of one size, 640x480, found 320x240 in left03.jpg right03.jpg" in refused(
        capsys, str(mixed), *out
    )
    blank = tmp_path / "blank"
    blank.mkdir()
    for name in ("left1.png", "right1.png"):
        cv2.imwrite(str(blank / name), np.full((120, 160), 128, np.uint8))
    assert "blank" in refused(capsys, str(blank), *out)
    (blank / "left1.png").write_bytes(b"no image")
    assert "left1.png cannot be decoded" in refused(capsys, str(blank), *out)


def test_square_without_unit_is_refused(pairs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "found '25' without one: type --square 25mm" in refused(capsys, str(pairs), "--square", "25")


def test_pairs_side_by_side_in_a_video_give_the_same_rig(
    pairs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = [
        np.hstack([cv2.imread(str(pairs / f"{side}{n}.jpg")) for side in ("left", "right")])
        for n in (*SIX, "02", "04", "06", "11", "12")
    ]
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (1280, 480))
    for frame in frames:
        writer.write(frame)
    writer.release()
    out = str(tmp_path / "rig.toml")
    result = calibrated(capsys, str(tmp_path / "v.avi"), "--square", "25mm", "--model", "brown", "--out", out)
    assert result["baseline_m"] / 0.025 == pytest.approx(3.34, rel=0.01)
    assert result["views_used"] >= 10
