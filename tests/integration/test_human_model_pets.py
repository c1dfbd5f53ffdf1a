"""The human-model tracker on PETS S2-L1 view 1, with a camera calibrated from people marked by hand."""

from pathlib import Path

import pytest

from benchmarks.pets import score_pets
from calib.ground_camera import save_ground_camera
from calib.people.calibration import calibrate_from_people
from calib.people.samples import read_image_size, read_samples

PEOPLE = Path(__file__).resolve().parents[1] / "data" / "pets_people.json"


@pytest.fixture
def camera(tmp_path: Path) -> Path:
    path = tmp_path / "camera.toml"
    size = read_image_size(PEOPLE)
    assert size is not None
    save_ground_camera(calibrate_from_people(read_samples(PEOPLE), size, "pinhole").camera, path)
    return path


def test_pets_boxes_reach_what_is_asked(shared_data: Path, camera: Path) -> None:
    scores = score_pets("human-model", shared_data / "pets09-s2l1-view001", camera)
    assert scores.frames == 400
    assert scores.boxes.truth_rows == 2396
    assert scores.boxes.clear.mota >= 0.80
    assert scores.boxes.identity.idf1 >= 0.88
    assert scores.floor is not None
