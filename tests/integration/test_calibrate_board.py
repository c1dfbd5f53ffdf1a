"""``planview calibrate board`` on OpenCV's public pairs, whole and damaged."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from cli import JsonOf, Refused
from toy_recordings import write_frames

from calib.formats import load_rig


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


def test_opencv_pairs_reach_the_accuracy_asked(pairs: Path, tmp_path: Path, json_of: JsonOf) -> None:
    out = tmp_path / "rig.toml"
    result = json_of("calibrate", "board", pairs, "--square", "25mm", "--out", out)
    assert result["stereo_rms_px"] <= 0.25 and result["views_used"] == 13 and result["views_rejected"] == []
    assert result["baseline_m"] / 0.025 == pytest.approx(3.34, rel=0.01)
    assert load_rig(out, (640, 480)).baseline_m == pytest.approx(result["baseline_m"])
    assert load_rig(tmp_path / "rig.yml", (640, 480)).baseline_m == pytest.approx(result["baseline_m"])
    page = (tmp_path / "rig.html").read_text()
    assert page.count("data:image/") == 2 and "://" not in page


@pytest.mark.parametrize("kind", ["RGBA", "12 bits in 16"])
def test_small_images_of_a_named_board_give_the_rig(kind: str, pairs: Path, tmp_path: Path, json_of: JsonOf) -> None:
    for number in (*SIX, "02", "04"):
        for side in ("left", "right"):
            grey = cv2.imread(str(pairs / f"{side}{number}.jpg"), cv2.IMREAD_GRAYSCALE)
            small = cv2.resize(grey, (320, 240), interpolation=cv2.INTER_AREA)
            stored = cv2.cvtColor(small, cv2.COLOR_GRAY2BGRA) if kind == "RGBA" else small.astype(np.uint16) * 16
            cv2.imwrite(str(tmp_path / f"{side}_{number}.png"), stored)
    out = ("--board", "9x6", "--square", "25mm", "--model", "brown", "--out", tmp_path / "rig.toml")
    result = json_of("calibrate", "board", tmp_path, *out)
    assert result["views_used"] == 8 and result["stereo_rms_px"] < 0.15
    assert result["baseline_squares"] == pytest.approx(3.34, rel=0.01)


def test_wrong_counts_are_refused(pairs: Path, tmp_path: Path, refused: Refused) -> None:
    folder = copy(pairs, tmp_path / "p", SIX)
    expected = refused("calibrate", "board", folder, "--square", "25mm", "--board", "8x6", "--out", tmp_path / "r.toml")
    assert "expected a board of 8x6 inner corners, found one of 9x6" in expected


def test_swapped_images_are_refused(pairs: Path, tmp_path: Path, refused: Refused) -> None:
    for number in SIX:
        for side, other in (("left", "right"), ("right", "left")):
            shutil.copy(pairs / f"{side}{number}.jpg", tmp_path / f"{other}{number}.jpg")
    words = ("--square", "25mm", "--model", "brown", "--out", tmp_path / "o" / "r.toml")
    expected = refused("calibrate", "board", tmp_path, *words)
    assert "left and right are swapped" in expected and not (tmp_path / "o" / "r.toml").exists()


def test_too_few_blank_mixed_and_unreadable_images_are_refused(pairs: Path, tmp_path: Path, refused: Refused) -> None:
    out = ("--square", "25mm", "--board", "9x6", "--out", tmp_path / "r.toml")
    few = copy(pairs, tmp_path / "few", SIX[:2])
    assert "found 2 of 2" in refused("calibrate", "board", few, *out)
    mixed = copy(pairs, tmp_path / "mixed", SIX[:3])
    cv2.imwrite(str(mixed / "right03.jpg"), np.zeros((240, 320), np.uint8))
    sizes = "expected images of one size, 640x480, found 320x240 in left03.jpg right03.jpg"
    assert sizes in refused("calibrate", "board", mixed, *out)
    blank = tmp_path / "blank"
    blank.mkdir()
    for name in ("left1.png", "right1.png"):
        cv2.imwrite(str(blank / name), np.full((120, 160), 128, np.uint8))
    assert "blank" in refused("calibrate", "board", blank, *out)
    (blank / "left1.png").write_bytes(b"no image")
    assert "left1.png cannot be decoded" in refused("calibrate", "board", blank, *out)


def test_pairs_side_by_side_in_a_video_give_the_same_rig(pairs: Path, tmp_path: Path, json_of: JsonOf) -> None:
    frames = [
        np.hstack([cv2.imread(str(pairs / f"{side}{n}.jpg")) for side in ("left", "right")])
        for n in (*SIX, "02", "04", "06", "11", "12")
    ]
    write_frames(tmp_path / "v.avi", frames)
    out = str(tmp_path / "rig.toml")
    result = json_of("calibrate", "board", tmp_path / "v.avi", "--square", "25mm", "--model", "brown", "--out", out)
    assert result["baseline_m"] / 0.025 == pytest.approx(3.34, rel=0.01) and result["views_used"] >= 10
