"""``planview calibrate human``: what it writes, and which image sizes and videos it refuses."""

import math
from pathlib import Path

import numpy as np
import pytest
from say import JsonOf, Refused

from calib.ground_camera import GroundCamera, load_ground_camera
from calib.people.samples import HumanSample, read_image_size, write_samples
from planview.calibration.people import bodies_of, usual_sizes
from tests.people import standing_people

CAMERA = GroundCamera(640, 480, 500.0, 4.0, math.radians(45), "normal-wide")


@pytest.fixture
def people(tmp_path: Path) -> Path:
    path = tmp_path / "people.json"
    write_samples(standing_people(CAMERA, 8, seed=1), path, CAMERA.size)
    return path


HUMAN = ("calibrate", "human")


def test_camera_and_picture_are_written_for_the_image_size_of_the_file(people: Path, json_of: JsonOf) -> None:
    out = people.parent / "out" / "camera.toml"
    told = json_of(*HUMAN, people, "--lens", "normal-wide", "--out", out)
    camera = load_ground_camera(out)
    assert camera.size == (640, 480)
    assert told["height_m"] == camera.height_m == pytest.approx(4.0, rel=0.01)
    assert sorted(p.name for p in out.parent.iterdir()) == ["camera.png", "camera.toml"]


def test_image_size_that_contradicts_the_file_is_refused(people: Path, refused: Refused) -> None:
    told = refused(*HUMAN, people, "--image-size", "1280x960", "--out", people.parent / "camera.toml")
    assert "--image-size: expected the image size of" in told
    assert "640x480, found 1280x960" in told


def test_samples_without_image_size_need_one(tmp_path: Path, refused: Refused) -> None:
    path = tmp_path / "people.json"
    write_samples(standing_people(CAMERA, 8, seed=1), path)
    assert read_image_size(path) is None
    assert "expected WxH of the image" in refused(*HUMAN, path, "--out", tmp_path / "camera.toml")


@pytest.mark.parametrize("size", ["[640]", "[640, -1]", '"640x480"'])
def test_image_size_that_is_none_is_refused_by_name(size: str, tmp_path: Path, refused: Refused) -> None:
    path = tmp_path / "people.json"
    path.write_text(f'{{"image_size": {size}, "samples": []}}')
    assert "image_size" in refused(*HUMAN, path)


def body(mask: np.ndarray, left: int, top: int = 40, height: int = 50) -> None:
    """A body of 20 columns with a narrower head."""
    mask[top + 10 : top + height, left : left + 20] = 255
    mask[top : top + 10, left + 6 : left + 14] = 255


def test_one_body_is_a_sample() -> None:
    mask = np.zeros((120, 160), np.uint8)
    body(mask, 60)
    (sample,) = bodies_of(mask, 7)
    assert sample.box_px == (59.5, 39.5, 20, 50)
    assert sample.frame == 7


def test_bodies_apart_are_samples_each() -> None:
    mask = np.zeros((120, 160), np.uint8)
    body(mask, 30)
    body(mask, 90)
    assert len(bodies_of(mask, 7)) == 2


def test_body_in_two_pieces_is_no_sample() -> None:
    mask = np.zeros((120, 160), np.uint8)
    body(mask, 60, height=60)
    mask[70:80] = 0
    assert bodies_of(mask, 7) == []


def test_pairs_and_halves_are_not_of_the_usual_size() -> None:
    def standing(u: float, v: float, height: float) -> HumanSample:
        return HumanSample((u - 10, v - height, 20, height), (u, v - height), (u, v))

    people = [standing(u, v, 0.3 * v) for u in range(50, 300, 50) for v in range(100, 220, 20)]
    people += [standing(80, 150, 80), standing(120, 170, 25)]
    usual = usual_sizes(people)
    assert usual[:-2].all()
    assert not usual[-2:].any()
