import json
import math

import numpy as np
import pytest

from calib.errors import InputError, WorkError
from calib.ground_camera import GroundCamera
from calib.people._kernels import candidate_errors
from calib.people.calibration import calibrate_from_people
from calib.people.model import HumanModel
from calib.people.samples import COLUMNS, HumanSample, choose_spread, only_boxes, read_samples, write_samples
from tests.people import standing_people
from tests.reference.human_error import weighted_error

CAMERAS = {
    "overhead": GroundCamera(640, 480, 400.0, 3.5, 0.0, "pinhole"),
    "oblique": GroundCamera(640, 480, 500.0, 4.0, math.radians(45), "normal-wide"),
    "near-horizontal": GroundCamera(640, 480, 600.0, 4.0, math.radians(68), "normal"),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_kernel_error_is_the_weighted_formula(name):
    camera, sample = CAMERAS[name], standing_people(CAMERAS[name], 1, seed=4)[0]
    rows = sample.row()[None]
    centre = np.tile([(camera.width - 1) / 2, (camera.height - 1) / 2], 4)
    ends = camera.back_project(sample.foot_px)
    moved = HumanSample(
        (sample.box_px[0] + 5, sample.box_px[1] - 3, sample.box_px[2], sample.box_px[3]), sample.head_px, sample.foot_px
    )
    marked = moved.row()[None] - centre
    k = camera.distortion_k
    points = (rows - centre)[:, 4:].reshape(2, 2)
    r = np.hypot(*points.T)
    flat = (points * (2 / (1 + np.sqrt(1 + 4 * k * r)))[:, None]).reshape(1, 4)
    out = np.empty(1)
    values = np.array([[camera.focal_px, camera.height_m, camera.tilt_rad]])
    model = HumanModel()
    candidate_errors(values, k, flat, marked, model.circles(), model.height_m, math.inf, out)
    assert out[0] == pytest.approx(weighted_error(camera, moved, ends), rel=1e-6)


@pytest.mark.parametrize("name", CAMERAS)
def test_calibration_is_exact_without_noise(name):
    truth = CAMERAS[name]
    found = calibrate_from_people(standing_people(truth, 8, seed=1), truth.size, truth.lens)
    assert found.camera.height_m == pytest.approx(truth.height_m, rel=0.01)
    assert math.degrees(found.camera.tilt_rad) == pytest.approx(math.degrees(truth.tilt_rad), abs=0.3)
    assert found.camera.focal_px == pytest.approx(truth.focal_px, rel=0.015)
    assert found.error < 0.02


def test_roll_is_found_and_kept():
    truth = GroundCamera(640, 480, 600.0, 6.0, math.radians(65), "pinhole", math.radians(3))
    found = calibrate_from_people(standing_people(truth, 12, seed=1), truth.size, truth.lens)
    assert math.degrees(found.camera.roll_rad) == pytest.approx(3.0, abs=0.2)
    assert found.camera.focal_px == pytest.approx(truth.focal_px, rel=0.02)
    assert found.error < 0.03


@pytest.mark.parametrize("name", CAMERAS)
def test_calibration_of_noisy_samples_is_within_its_own_deviation(name):
    truth = CAMERAS[name]
    found = calibrate_from_people(standing_people(truth, 12, seed=2, noise_px=2.0), truth.size, truth.lens)
    height, tilt, focal, _ = found.std
    assert abs(math.log(found.camera.height_m / truth.height_m)) < 3 * height + 0.005
    assert abs(found.camera.tilt_rad - truth.tilt_rad) < 3 * tilt + 0.002
    assert abs(math.log(found.camera.focal_px / truth.focal_px)) < 3 * focal + 0.005


@pytest.mark.parametrize(
    ("people", "size", "message"),
    [
        (standing_people(CAMERAS["oblique"], 2), (640, 480), "at least 3 samples at different places, found 2"),
        (standing_people(CAMERAS["oblique"], 1) * 5, (640, 480), "height and focal length cannot be told apart"),
        (standing_people(CAMERAS["oblique"], 8), (320, 240), "wrong image size"),
    ],
    ids=["too few", "one place", "another image size"],
)
def test_calibration_refuses_samples_that_tell_no_camera(people, size, message):
    with pytest.raises(InputError, match=message):
        calibrate_from_people(people, size, "normal")


def test_calibration_refuses_boxes_that_no_person_has():
    places = [(60, 60), (300, 200), (500, 60), (60, 330)]
    up = [HumanSample((x, y, 30, 120), (x + 14, y + 2), (x + 16, y + 117)) for x, y in places]
    down = [HumanSample((x + 40, y, 60, 60), (x + 44, y + 57), (x + 96, y + 2)) for x, y in places]
    lying = up + down
    with pytest.raises(WorkError, match=r"no camera fits|cannot be told apart"):
        calibrate_from_people(lying, (640, 480), "pinhole")


def test_boxes_alone_are_known_as_such():
    box = HumanSample((100, 50, 40, 120), (120, 50), (120, 170)).row()
    marked = HumanSample((100, 50, 40, 120), (112, 53), (126, 166)).row()
    assert only_boxes(np.stack([box, box]))
    assert not only_boxes(np.stack([box, marked]))


@pytest.mark.parametrize(
    ("box", "head", "foot", "message"),
    [
        ((0, 0, 40, math.nan), (20, 0), (20, 90), "finite"),
        ((0, 0, -40, 90), (20, 0), (20, 90), "positive width"),
        ((0, 0, 40, 90), (20, 200), (20, 90), "head within its box"),
    ],
)
def test_sample_refuses_what_is_no_person(box, head, foot, message):
    with pytest.raises(ValueError, match=message):
        HumanSample(box, head, foot)


@pytest.mark.parametrize("name", ["samples.csv", "samples.json"])
def test_samples_survive_a_round_trip(tmp_path, name):
    samples = standing_people(CAMERAS["oblique"], 4, noise_px=1.0)
    write_samples(samples, tmp_path / name)
    assert list(read_samples(tmp_path / name)) == samples
    if name.endswith("json"):
        assert set(json.loads((tmp_path / name).read_text())["samples"][0]) == {"frame", "box", "head", "foot"}


def test_samples_are_read_without_suffixes_and_frame(tmp_path):
    names = ",".join(column.removesuffix("_px") for column in COLUMNS)
    (tmp_path / "s.csv").write_text(f"{names}\n10,20,40,100,30,21,30,118\n")
    assert read_samples(tmp_path / "s.csv")[0].foot_px == (30.0, 118.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("left_px,top_px\n1,2\n", "found no 'width_px' in sample 1"),
        ('[{"box": [1, 2, 3], "head": [1, 2], "foot": [1, 2]}]', "standing person in sample 1"),
        ('{"people": []}', "list of samples"),
        ("[1, 2", "expected JSON"),
        (",".join(COLUMNS) + "\n1,2,3,4,nan,6,7,8\n", "finite"),
    ],
)
def test_samples_that_cannot_be_read_are_refused_by_name(tmp_path, text, message):
    path = tmp_path / "bad"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_samples(path)
    assert str(path) in str(caught.value)


def test_choice_covers_the_image_and_passes_over_the_odd():
    samples = [
        HumanSample((x, y, 30, 80.0 + y / 10), (x + 15, y), (x + 15, y + 80.0 + y / 10))
        for x in range(20, 560, 20)
        for y in range(50, 350, 25)
    ]
    samples[40] = HumanSample((20, 50, 30, 40), (35, 50), (35, 90))
    chosen = choose_spread(samples, 9)
    assert len(chosen) == 9
    assert samples[40] not in chosen
    feet = np.array([s.foot_px for s in chosen])
    assert np.ptp(feet[:, 0]) > 300 and np.ptp(feet[:, 1]) > 150
