"""``planview calibrate board`` and ``floor``."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_recordings import write_frames
from toy_run import FEW
from toy_stereo import toy_rig, write_toy_recording

from calib.formats import load_rig
from calib.world import load_world
from planview.checks.examine import examine
from planview.engine.config import load_config
from planview.engine.setup import floor_search, set_up
from stereo.readers.open import open_recording


@pytest.fixture(scope="module")
def photos(shared_data) -> Path:
    return shared_data / "opencv-stereo-chessboard"


def copy(photos: Path, folder: Path, numbers: tuple[str, ...]) -> Path:
    folder.mkdir(exist_ok=True)
    for number in numbers:
        for side in ("left", "right"):
            shutil.copy(photos / f"{side}{number}.jpg", folder / f"{side}{number}.jpg")
            (folder / f"{side}{number}.jpg").chmod(0o644)
    return folder


SIX = ("01", "03", "05", "07", "09", "13")


def test_opencv_pairs_reach_the_accuracy_asked(photos, tmp_path, json_of):
    out = tmp_path / "rig.toml"
    result = json_of("calibrate", "board", photos, "--square", "25mm", "--out", out)
    assert result["stereo_rms_px"] <= 0.25
    assert result["views_used"] == 13
    assert result["views_rejected"] == []
    assert result["baseline_m"] / 0.025 == pytest.approx(3.34, rel=0.01)
    assert load_rig(out, (640, 480)).baseline_m == pytest.approx(result["baseline_m"])
    assert load_rig(tmp_path / "rig.yml", (640, 480)).baseline_m == pytest.approx(result["baseline_m"])
    page = (tmp_path / "rig.html").read_text()
    assert page.count("data:image/") == 2
    assert "://" not in page


@pytest.mark.parametrize("kind", ["RGBA", "12 bits in 16"])
def test_small_images_of_a_named_board_give_the_rig(kind, photos, tmp_path, json_of):
    for number in (*SIX, "02", "04"):
        for side in ("left", "right"):
            grey = cv2.imread(str(photos / f"{side}{number}.jpg"), cv2.IMREAD_GRAYSCALE)
            small = cv2.resize(grey, (320, 240), interpolation=cv2.INTER_AREA)
            stored = cv2.cvtColor(small, cv2.COLOR_GRAY2BGRA) if kind == "RGBA" else small.astype(np.uint16) * 16
            cv2.imwrite(str(tmp_path / f"{side}_{number}.png"), stored)
    out = ("--board", "9x6", "--square", "25mm", "--model", "brown", "--out", tmp_path / "rig.toml")
    result = json_of("calibrate", "board", tmp_path, *out)
    assert result["views_used"] == 8
    assert result["stereo_rms_px"] < 0.15
    assert result["baseline_squares"] == pytest.approx(3.34, rel=0.01)


def test_wrong_counts_are_refused(photos, tmp_path, refused):
    folder = copy(photos, tmp_path / "p", SIX)
    expected = refused("calibrate", "board", folder, "--square", "25mm", "--board", "8x6", "--out", tmp_path / "r.toml")
    assert "expected a board of 8x6 inner corners, found one of 9x6" in expected


BOARD = ("--square", "25mm", "--board", "9x6", "--out", "r.toml")


def test_too_few_images_are_refused(photos, tmp_path, refused):
    few = copy(photos, tmp_path / "few", SIX[:2])
    assert "found 2 of 2" in refused("calibrate", "board", few, *BOARD)


def test_images_of_two_sizes_are_refused(photos, tmp_path, refused):
    mixed = copy(photos, tmp_path / "mixed", SIX[:3])
    cv2.imwrite(str(mixed / "right03.jpg"), np.zeros((240, 320), np.uint8))
    assert "640x480, found 320x240 in left03.jpg" in refused("calibrate", "board", mixed, *BOARD)


def test_images_without_a_board_are_refused_with_the_reason(tmp_path, refused):
    for name in ("left1.png", "right1.png"):
        cv2.imwrite(str(tmp_path / name), np.full((120, 160), 128, np.uint8))
    assert "none of 1 pairs" in refused("calibrate", "board", tmp_path, *BOARD)
    (tmp_path / "left1.png").write_bytes(b"no image")
    assert "left1.png cannot be decoded" in refused("calibrate", "board", tmp_path, *BOARD)


def test_pairs_side_by_side_in_a_video_give_the_same_rig(photos, tmp_path, json_of):
    frames = [
        np.hstack([cv2.imread(str(photos / f"{side}{n}.jpg")) for side in ("left", "right")])
        for n in (*SIX, "02", "04", "06", "11", "12")
    ]
    write_frames(tmp_path / "v.avi", frames)
    out = str(tmp_path / "rig.toml")
    result = json_of("calibrate", "board", tmp_path / "v.avi", "--square", "25mm", "--model", "brown", "--out", out)
    assert result["baseline_m"] / 0.025 == pytest.approx(3.34, rel=0.01)
    assert result["views_used"] >= 10


KEYS = {"height_m", "tilt_deg", "roll_deg", "inlier_fraction"}
HEIGHT_M = 2.5
"""Of the toy camera."""


@pytest.fixture(scope="module")
def small(pairs, tmp_path_factory) -> Path:
    return write_toy_recording(tmp_path_factory.mktemp("floor") / "recording", toy_rig(), pairs[::9])


@pytest.fixture
def own(small, tmp_path) -> Path:
    """A copy that may be written into."""
    return Path(shutil.copytree(small, tmp_path / "own"))


def files(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*")}


def test_every_command_finds_the_floor_of_a_run(small, json_of):
    of_run = set_up(open_recording(small), load_config()).floor
    floor = examine(small, frames=4).floor
    assert floor.world_SE3_left.matrix.tolist() == of_run.world_SE3_left.matrix.tolist()
    printed = json_of("calibrate", "floor", small)
    assert printed["height_m"] == of_run.height_m
    assert printed["inlier_fraction"] == of_run.inlier_fraction


def test_configured_search_is_that_of_the_run():
    config = load_config(None, [FEW, "sgbm.block_px=7", "floor.max_height_m=5", "range.nearest_m=1"])
    search = floor_search(config)
    assert (search.frames, search.sgbm, search.floor, search.range) == (4, config.sgbm, config.floor, config.range)


def test_nothing_is_written_without_a_place_to_write_to(cli, small, json_of):
    before = files(small)
    found = json_of("calibrate", "floor", small, "--frames", 2)
    assert found.keys() >= KEYS
    assert found["height_m"] == pytest.approx(HEIGHT_M, abs=0.05)
    assert found["world"] is None
    assert "--save keeps this floor" in " ".join(cli("calibrate", "floor", small, "--frames", 2)[1].split())
    assert files(small) == before


def test_out_writes_the_floor_with_its_picture(succeed, small, tmp_path):
    before = files(small)
    succeed("calibrate", "floor", small, "--frames", 2, "--out", tmp_path / "new" / "world.toml")
    assert load_world(tmp_path / "new" / "world.toml").height_m == pytest.approx(HEIGHT_M, abs=0.05)
    assert files(tmp_path / "new") == {"world.toml", "world.png"}
    assert files(small) == before


def test_save_gives_the_recording_a_floor_that_runs_take(succeed, own):
    succeed("calibrate", "floor", own, "--frames", 2, "--save")
    assert set_up(open_recording(own), load_config()).floor_source == "world.toml"


def test_points_in_metres_give_their_plane(small, json_of):
    words = ["--points", "1,2,3", "2,2,3", "1,2,5", "--frames", "1"]
    found = json_of("calibrate", "floor", small, *words)
    assert (found["height_m"], found["tilt_deg"], found["roll_deg"]) == pytest.approx((2.0, 90.0, 0.0), abs=1e-6)
    assert found["inlier_fraction"] is None


def test_points_in_pixels_lie_on_the_floor_by_their_depth(small, json_of):
    words = ["--points", "80,200", "240,200", "160,160", "--frames", "2"]
    assert json_of("calibrate", "floor", small, *words)["height_m"] == pytest.approx(HEIGHT_M, abs=0.1)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--frames", "0"], "--frames: expected 1 to 1000, found 0"),
        (["--points", "1,2", "3,4"], "--points: expected three or more, found 2"),
        (["--points", "1,2", "3,4", "5,6", "--tracks", "t.csv"], "points and tracks cannot be combined"),
        (["--out", "w.toml", "--save"], "out and save cannot be combined"),
        (["--points", "10,10", "900,10", "50,90", "--frames", "1"], "expected pixels inside 320x240"),
        (["--tracks", "none.csv", "--frames", "1"], "none.csv"),
        (["--picture", "floor.txt", "--frames", "1"], "floor.txt: expected a picture's name"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(refused, small, words, sentence):
    assert sentence in refused("calibrate", "floor", small, *words)
