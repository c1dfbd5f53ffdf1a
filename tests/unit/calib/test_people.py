"""Cameras from people: the model, the solution, its assessment."""

import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors import InputError, WorkError
from calib.ground_camera import GroundCamera
from calib.people.calibration import Assessment, HumanCalibration, calibrate_from_people, weighted_errors
from calib.people.model import HULL_POINTS, HumanModel, KnownValues
from calib.people.samples import COLUMNS, HumanSample, choose_spread, only_boxes, read_samples, write_samples
from calib.types import F64
from planview.tracking.human_model.model_map import (
    HumanModelMapParams,
    build_model_map,
    visible_fraction,
)
from tests.people import standing_people

OBLIQUE = GroundCamera(160, 120, 150.0, 4.0, math.radians(60))
OVERHEAD = GroundCamera(160, 120, 100.0, 4.0, 0.0)
COARSE = HumanModelMapParams(step_px=8)


MODEL = HumanModel()


def test_model_has_the_sizes_of_the_paper():
    assert MODEL.planes == ((0.0, 0.12), (0.79, 0.21), (pytest.approx(1.49), 0.21), (pytest.approx(1.76), 0.09))


def test_scaled_model_keeps_its_proportions():
    half = MODEL.scaled(0.88)
    assert half.height_m == pytest.approx(0.88)
    assert half.torso_radius_m == pytest.approx(0.105)


def test_model_without_a_head_is_refused():
    with pytest.raises(ValueError, match="positive"):
        HumanModel(head_m=0.0)


def test_box_from_above_is_that_of_the_shoulders():
    # Shoulders at 1.49 m are 2.51 m below the camera: radius 100 * 0.21 / 2.51 = 8.37 px.
    box = [79.5 - 8.367, 59.5 - 8.367, 16.733, 16.733]
    np.testing.assert_allclose(MODEL.boxes(OVERHEAD, (0.0, 0.0)), box, atol=1e-3)


def test_head_is_above_the_foot_from_the_side():
    foot = OBLIQUE.project((0.5, 6.0, 0.0))
    np.testing.assert_allclose(MODEL.foot(OBLIQUE, (0.5, 6.0)), foot)
    assert MODEL.head(OBLIQUE, (0.5, 6.0))[1] < foot[1] - 20


def test_hull_is_the_convex_hull_of_the_circles():
    hull = MODEL.hulls(OBLIQUE, (0.5, 6.0))
    exact = cv2.contourArea(cv2.convexHull(MODEL.outline_points(OBLIQUE, (0.5, 6.0)).astype(np.float32)))
    assert 0.99 * exact <= cv2.contourArea(hull.astype(np.float32)) <= exact


def test_hulls_of_many_places_are_those_of_each():
    hulls = MODEL.hulls(OBLIQUE, np.array([[[0.0, 5.0], [0.5, 6.0]]]))
    assert hulls.shape == (1, 2, HULL_POINTS, 2)
    np.testing.assert_array_equal(hulls[0, 1], MODEL.hulls(OBLIQUE, (0.5, 6.0)))


def test_hull_behind_the_camera_is_nan():
    assert np.isnan(MODEL.hulls(OBLIQUE, (0.0, -9.0))).all()


@given(
    st.floats(-1.4, 1.4), st.floats(2.2, 8.0), st.floats(-20, 20), st.floats(-20, 40), st.sampled_from([0.9, 1.76, 2.1])
)
def test_box_encloses_the_whole_person(tilt, height, x, y, person):
    camera = GroundCamera(320, 240, 300.0, height, tilt)
    model = HumanModel().scaled(person)
    hull = model.hulls(camera, (x, y))
    if np.isfinite(hull).all():
        left, top, width, high = model.boxes(camera, (x, y))
        points = np.vstack([hull, model.head(camera, (x, y)), model.foot(camera, (x, y))])
        slack = 1e-6 * (1 + np.abs(hull).max())
        assert (points >= [left - slack, top - slack]).all()
        assert (points <= [left + width + slack, top + high + slack]).all()


def test_visible_fraction_of_squares():
    square = np.array([[0, 0], [4, 0], [4, 4], [0, 4]])
    shifts = np.array([[2, 2], [-2.5, 2], [-2.5, -2.5], [-9, 2], [9.5, 5.5]])
    found = visible_fraction(square + shifts[:, None], 12, 8)
    np.testing.assert_allclose(found, [1.0, 0.5, 0.25, 0.0, 0.25])


@pytest.fixture(scope="module")
def coarse_map():
    return build_model_map(OBLIQUE, params=COARSE)


def test_map_covers_the_floor_where_people_would_show(coarse_map):
    horizon = 59.5 - 150.0 / math.tan(math.radians(60))
    assert coarse_map.foot_px[:, 1].min() > horizon
    assert coarse_map.foot_px[:, 1].max() > 130
    assert (np.linalg.norm(coarse_map.floor_m, axis=1) <= 60.0).all()
    assert (coarse_map.visibility > 0.05).all()
    assert coarse_map.entry_at((80.0, horizon - 9.0)) == -1
    assert coarse_map.visibility.max() == 1.0


def test_map_entries_are_the_model_at_the_pixel(coarse_map):
    entry = int(coarse_map.entry_at((83.0, 66.0)))
    foot = coarse_map.foot_px[entry]
    assert np.abs(foot - (83, 66)).max() <= 4
    floor = OBLIQUE.back_project(foot)
    np.testing.assert_allclose(coarse_map.floor_m[entry], floor, rtol=1e-5)
    np.testing.assert_allclose(coarse_map.hull_px[entry], HumanModel().hulls(OBLIQUE, floor), rtol=1e-4)


def test_map_refuses_a_grid_beyond_its_limit():
    with pytest.raises(ValueError, match="enlarge step_px"):
        build_model_map(GroundCamera(4000, 3000, 3000.0, 4.0, 1.0), params=HumanModelMapParams(step_px=1))


CAMERAS = {
    "overhead": GroundCamera(640, 480, 400.0, 3.5, 0.0, "pinhole"),
    "oblique": GroundCamera(640, 480, 500.0, 4.0, math.radians(45), "normal-wide"),
    "near-horizontal": GroundCamera(640, 480, 600.0, 4.0, math.radians(68), "normal"),
}


def test_error_of_a_sample_is_how_far_its_ends_are_off_over_the_radius_of_its_box():
    sample = standing_people(OBLIQUE, 1)[0]
    places = OBLIQUE.back_project([sample.foot_px])
    moved = np.add(sample.row(), [0, 0, 0, 0, 3, 0, 3, 0])
    width, height = sample.box_px[2:]
    length_share = math.dist(sample.head_px, sample.foot_px) / math.hypot(width, height)
    expected = length_share * 3.0 / math.sqrt(width * height / math.pi)
    assert weighted_errors(OBLIQUE, places, moved[None], HumanModel()) == pytest.approx(expected, rel=1e-6)


def camera_errors(camera: GroundCamera, truth: GroundCamera) -> F64:
    """Relative error of the height, error of the tilt [rad] and relative error of the focal length."""
    height = math.log(camera.height_m / truth.height_m)
    focal = math.log(camera.focal_px / truth.focal_px)
    return np.abs([height, camera.tilt_rad - truth.tilt_rad, focal])


@pytest.mark.parametrize("truth", CAMERAS.values(), ids=CAMERAS)
def test_calibration_is_exact_without_noise(truth):
    found = calibrate_from_people(standing_people(truth, 8, seed=1), truth.size, truth.lens)
    assert (camera_errors(found.camera, truth) < (0.01, math.radians(0.3), 0.015)).all()
    assert found.error < 0.02


@pytest.mark.parametrize("truth", CAMERAS.values(), ids=CAMERAS)
def test_calibration_from_noisy_samples_is_within_its_deviation(truth):
    found = calibrate_from_people(standing_people(truth, 12, 2, 2.0), truth.size, truth.lens)
    std = (found.std.height, math.radians(found.std.tilt_deg), found.std.focal)
    limits = 3 * np.array(std) + (0.005, 0.002, 0.005)
    assert (camera_errors(found.camera, truth) < limits).all()


def test_roll_is_found():
    truth = GroundCamera(640, 480, 600.0, 6.0, math.radians(65), "pinhole", math.radians(3))
    found = calibrate_from_people(standing_people(truth, 12, seed=1), truth.size, truth.lens)
    assert math.degrees(found.camera.roll_rad) == pytest.approx(3.0, abs=0.2)
    assert found.camera.focal_px == pytest.approx(truth.focal_px, rel=0.02)
    assert found.error < 0.03


@pytest.mark.parametrize(
    ("people", "size", "message"),
    [
        (standing_people(CAMERAS["oblique"], 2), (640, 480), "found 2"),
        (standing_people(CAMERAS["oblique"], 8), (320, 240), "wrong image size"),
    ],
    ids=["too few", "another image size"],
)
def test_calibration_refuses_samples_that_determine_no_camera(people, size, message):
    with pytest.raises(InputError, match=message):
        calibrate_from_people(people, size, "normal")


def test_calibration_refuses_boxes_that_no_person_has():
    places = [(60, 60), (300, 200), (500, 60), (60, 330)]
    up = [HumanSample((x, y, 30, 120), (x + 14, y + 2), (x + 16, y + 117)) for x, y in places]
    down = [HumanSample((x + 40, y, 60, 60), (x + 44, y + 57), (x + 96, y + 2)) for x, y in places]
    with pytest.raises(WorkError, match="no camera fits"):
        calibrate_from_people(up + down, (640, 480), "pinhole")


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


def test_samples_survive_a_round_trip(tmp_path):
    samples = standing_people(CAMERAS["oblique"], 4, noise_px=1.0)
    write_samples(samples, tmp_path / "samples.json")
    assert list(read_samples(tmp_path / "samples.json")) == samples


def test_samples_of_unknown_height_are_written_without_it(tmp_path):
    write_samples(standing_people(CAMERAS["oblique"], 1), tmp_path / "samples.json")
    assert set(json.loads((tmp_path / "samples.json").read_text())["samples"][0]) == {"frame", "box", "head", "foot"}


def test_samples_are_read_without_units_in_their_names(tmp_path):
    names = ",".join(column.removesuffix("_px") for column in COLUMNS)
    (tmp_path / "s.csv").write_text(f"{names}\n10,20,40,100,30,21,30,118\n")
    assert read_samples(tmp_path / "s.csv")[0].foot_px == (30.0, 118.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("left_px,top_px\n1,2\n", "width_px"),
        ('[{"box": [1, 2, 3], "head": [1, 2], "foot": [1, 2]}]', "sample 1"),
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


def test_choice_is_spread_over_the_image_without_the_odd():
    heads = [(x, y, 80.0 + y / 10) for x in range(20, 560, 20) for y in range(50, 350, 25)]
    samples = [HumanSample((x, y, 30, h), (x + 15, y), (x + 15, y + h)) for x, y, h in heads]
    samples[40] = HumanSample((20, 50, 30, 40), (35, 50), (35, 90))
    chosen = choose_spread(samples, 9)
    assert len(chosen) == 9
    assert samples[40] not in chosen
    feet = np.array([s.foot_px for s in chosen])
    assert np.ptp(feet[:, 0]) > 300
    assert np.ptp(feet[:, 1]) > 150


STREET = GroundCamera(480, 360, 740.0, 7.0, math.radians(73.5), "pinhole")


def seen_in_the_street(count: int, seed: int, noise_px: float = 2.0, **known) -> HumanCalibration:
    people = standing_people(STREET, count, seed, noise_px)
    return calibrate_from_people(people, STREET.size, "pinhole", known=KnownValues(**known))


def test_known_focal_length_makes_places_better_known():
    alone, printed = seen_in_the_street(8, seed=0), seen_in_the_street(8, seed=0, focal_px=740.0)
    assert printed.camera.focal_px == pytest.approx(740.0, rel=0.03)
    assert printed.std.from_camera < 0.5 * alone.std.from_camera


def test_field_of_view_is_a_focal_length():
    field = math.degrees(2 * math.atan(240 / 740))
    assert KnownValues(field_deg=field).focal(480, 0.0) == pytest.approx(740.0)


def test_field_of_view_with_a_focal_length_is_refused():
    with pytest.raises(ValueError, match="focal_px or field_deg"):
        KnownValues(focal_px=700.0, field_deg=60.0)


def test_known_camera_height_outweighs_the_height_of_the_people():
    # People of 1.76 m under a camera at 7 m give the images of people of 1.69 m under a camera at 6.7 m.
    found = seen_in_the_street(12, seed=1, noise_px=0.0, focal_px=740.0, height_m=6.7)
    assert 6.65 < found.camera.height_m < 6.85


def assess(first: int, last: int) -> Assessment:
    """The verdict on six people where something moved in some columns of the image."""
    walked = np.zeros((360, 480), np.bool_)
    walked[:, first:last] = True
    people = standing_people(STREET, 6, seed=2, noise_px=2.0)
    return calibrate_from_people(people, STREET.size, "pinhole", walked=walked).assessment


@pytest.mark.parametrize(("first", "last"), [(0, 480), (0, 200), (200, 480)], ids=["everywhere", "left", "right"])
def test_next_sample_lies_where_something_moved(first, last):
    assessment = assess(first, last)
    u, v = assessment.next_sample
    assert first - 1 <= u < last + 1
    assert 0 <= v < 360


def test_no_next_sample_is_proposed_where_nothing_moved():
    assert assess(0, 0).next_sample is None


def test_middles_of_noisy_boxes_are_read_as_such():
    """Taken at their word, heads above feet everywhere would be a focal length without end."""
    rng, samples = np.random.default_rng(0), []
    for s in standing_people(STREET, 24, seed=5):
        left, top, width, height = s.box_px
        ends = np.array([left + width / 2, top, left + width / 2, top + height]) + rng.normal(0, 1, 4)
        samples.append(HumanSample(s.box_px, (ends[0], ends[1]), (ends[2], ends[3])))
    found = calibrate_from_people(samples, STREET.size, "pinhole")
    assert abs(math.log(found.camera.focal_px / 740.0)) < 2 * found.std.focal
    assert found.camera.focal_px < 1.4 * 740.0


def test_odd_sample_changes_little():
    people = standing_people(STREET, 12, seed=1, noise_px=1.0)
    left, top, width, height = people[4].box_px
    people[4] = HumanSample((left, top, width, height / 2), people[4].head_px, (left + width / 2, top + height / 2))
    found = calibrate_from_people(people, STREET.size, "pinhole", known=KnownValues(focal_px=740.0))
    assert found.odd == (4,)
    assert found.camera.height_m == pytest.approx(7.0, rel=0.04)


SLOPE = GroundCamera(640, 480, 450.0, 3.5, math.radians(65), "pinhole")


def outlines(count: int, cut_px: float, cut: int) -> list[HumanSample]:
    """Sightings in the order of their frames, of which the first ``cut`` end too high."""
    seen = []
    for k, sample in enumerate(standing_people(SLOPE, count, seed=3)):
        (left, top, width, height), (u, v), off = sample.box_px, sample.foot_px, cut_px * (k < cut)
        seen.append(replace(sample, box_px=(left, top, width, height - off), foot_px=(u, v - off), frame=k))
    return seen


def test_walker_whose_outlines_differ_from_the_others_makes_the_camera_less_certain():
    alike, odd = (
        calibrate_from_people(outlines(24, cut_px, 4), SLOPE.size, "pinhole", independent=24) for cut_px in (0.0, 15.0)
    )
    assert odd.std.height > 1.5 * alike.std.height


def test_outlines_that_end_too_high_are_within_the_deviation():
    """Of four people, seen often, the lowest 2 px are missing everywhere, as where a shadow is removed."""
    by_hand, found = (
        calibrate_from_people(outlines(16, 2.0, 16), SLOPE.size, "pinhole", independent=n) for n in (None, 4)
    )
    off = abs(math.log(found.camera.focal_px / SLOPE.focal_px))
    assert off < 2.0 * found.std.focal
    assert found.std.focal > by_hand.std.focal
