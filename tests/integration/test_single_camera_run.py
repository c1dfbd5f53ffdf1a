"""Both single-camera trackers on clips that are hard or wrong: no nonsense, and a sentence where one is due."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_recordings import write_frames

from calib.ground_camera import CameraDeviations, GroundCamera, load_ground_camera, save_ground_camera
from calib.types import U8
from planview.output.folder import RunInfo, read_run_info
from planview.trajectories.table import read_tracks

CLOTHES = (40, 40, 200)


def texture(seed: int) -> U8:
    """(200, 300, 3) uint8, a larger scene of soft patches."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(40, 216, (20, 30, 3), dtype=np.uint8)
    return cv2.resize(coarse, (300, 200), interpolation=cv2.INTER_CUBIC)


def frame_of(scene: U8, i: int, left_px: int = 0, person_px: float | None = None) -> U8:
    """(120, 160, 3) uint8: a window of the scene with noise, and a person of 14 x 40 px at a column."""
    noise = np.random.default_rng(i).normal(0.0, 2.0, (120, 160, 3))
    image = scene[20:140, left_px : left_px + 160].astype(np.float64)
    if person_px is not None:
        x = round(person_px)
        image[50:90, max(0, x - 7) : max(0, x + 7)] = CLOTHES
    return np.clip(image + noise, 0, 255).astype(np.uint8)


SCENE, OTHER = texture(1), texture(2)


def panned(i: int) -> U8:
    return frame_of(SCENE, i, left_px=3 * i)


def walked(i: int) -> U8:
    """Two seconds, a person from the left to the right."""
    return frame_of(SCENE, i, person_px=9.0 * i - 10)


def there_throughout(i: int) -> U8:
    return frame_of(SCENE, i, person_px=80 + 50 * math.sin(2 * math.pi * i / 120))


def cut(i: int) -> U8:
    """A person walks by, then the scene is another one and empty."""
    return frame_of(SCENE, i, person_px=5.0 * i) if i < 20 else frame_of(OTHER, i)


def write_clip(path: Path, paint: Callable[[int], U8], n_frames: int) -> Path:
    write_frames(path, [paint(i) for i in range(n_frames)])
    return path


def camera(folder: Path, width: int = 160) -> Path:
    """The person of 40 px is 1.7 m high at 4.6 m from a camera 2.5 m high that looks down by 20 degrees."""
    save_ground_camera(GroundCamera(width, 120, 110.0, 2.5, math.radians(70)), folder / "camera.toml")
    return folder / "camera.toml"


Run = Callable[[Callable[[int], U8], int], tuple[RunInfo, str]]


@pytest.fixture(params=["human-model", "ellipse-particle"])
def run(request, succeed, tmp_path) -> Run:
    """Track a clip: run.json, and what is printed."""

    def run_on(paint, n_frames):
        clip = write_clip(tmp_path / "clip.avi", paint, n_frames)
        given = ["--camera", camera(tmp_path)] if request.param == "human-model" else []
        printed = succeed("run", clip, "--tracker", request.param, "--out", tmp_path / "out", *given)
        return read_run_info(tmp_path / "out" / "run.json"), " ".join(printed.split())

    return run_on


def test_clip_without_motion_gives_no_people(run, tmp_path):
    info, printed = run(lambda i: np.full((120, 160, 3), 90, np.uint8), 20)
    assert "nothing of a person's size moved in 20 frames" in printed
    assert info.remark.startswith("nothing")
    assert len((tmp_path / "out" / "tracks.csv").read_text().splitlines()) == 1


def test_deviations_of_the_camera_reach_the_tracks(cli, tmp_path):
    clip = write_clip(tmp_path / "clip.avi", there_throughout, 60)
    known = replace(load_ground_camera(camera(tmp_path)), std=CameraDeviations(0.1, 1.5, 0.12, 1.0, 0.02, 0.1))
    file = tmp_path / "camera.toml"
    save_ground_camera(known, file)
    _, printed = cli("run", clip, "--tracker", "human-model", "--camera", file, "--out", tmp_path / "out")
    tracks = read_tracks(tmp_path / "out" / "tracks.csv")
    assert "to 10% from the camera" in " ".join(printed.split())
    np.testing.assert_allclose(tracks.std_m, 0.1 * np.hypot(tracks.x_m, tracks.y_m) / math.sqrt(2), atol=1e-3)


@pytest.mark.parametrize("setting", ["min_height_px=1000", "max_distance_m=1e-9"])
def test_settings_that_leave_no_place_for_people_are_refused(refused, tmp_path, setting):
    clip = write_clip(tmp_path / "clip.avi", walked, 3)
    words = ["--tracker", "human-model", "--out", tmp_path / "out", "--camera", camera(tmp_path)]
    printed = refused("run", clip, *words, "--set", f"human_model.map.{setting}")
    assert "human_model.map: expected floor on which people of min_height_px show within max_distance_m" in printed


def test_moving_camera_counts_nobody(run):
    info, printed = run(panned, 40)
    assert info.people == 0
    assert [warning.name for warning in info.warnings] == ["camera moved"]
    assert "the camera has rotated by" in printed


def test_scene_cut_makes_no_people(run):
    info, _ = run(cut, 60)
    assert info.people <= 1
    assert [warning.name for warning in info.warnings] == ["camera moved"]
    assert "the camera shows another view at frame" in info.warnings[0].text


def test_person_throughout_is_counted(run):
    info, _ = run(there_throughout, 60)
    assert 1 <= info.people <= (1 if info.tracker == "ellipse-particle" else 2)
    assert not info.warnings


def test_two_seconds_count_no_more_than_are_there(run):
    info, _ = run(walked, 20)
    assert info.people <= 1
    assert not info.warnings
