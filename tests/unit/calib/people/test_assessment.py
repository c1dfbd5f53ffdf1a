import math
from dataclasses import replace

import numpy as np
import pytest

from calib.ground_camera import GroundCamera
from calib.people.calibration import calibrate_from_people
from calib.people.model import KnownValues
from calib.people.samples import HumanSample
from tests.people import standing_people

STREET = GroundCamera(480, 360, 740.0, 7.0, math.radians(73.5), "pinhole")


def test_known_focal_length_makes_a_poor_set_enough() -> None:
    people = standing_people(STREET, 4, seed=0, noise_px=3.0)
    alone = calibrate_from_people(people, STREET.size, "pinhole")
    told = calibrate_from_people(people, STREET.size, "pinhole", known=KnownValues(focal_px=740.0))
    assert not alone.assessment.enough
    assert alone.assessment.sentence.startswith("not enough: ")
    assert "focal length or field of view" in alone.assessment.sentence
    assert told.assessment.enough
    assert told.camera.focal_px == pytest.approx(740.0, rel=0.03)
    assert told.assessment.floor_error_m < alone.assessment.floor_error_m


def test_field_of_view_is_a_focal_length() -> None:
    field = math.degrees(2 * math.atan(240 / 740))
    assert KnownValues(field_deg=field).focal(480, 0.0) == pytest.approx(740.0)


def test_known_camera_height_tells_the_stature_of_the_people() -> None:
    # People of 1.76 m under a camera at 7 m give the images of people of 1.69 m under a camera at 6.7 m.
    found = calibrate_from_people(
        standing_people(STREET, 12, seed=1), STREET.size, "pinhole", known=KnownValues(focal_px=740.0, height_m=6.7)
    )
    assert 6.65 < found.camera.height_m < 6.85
    assert found.stature == pytest.approx(found.camera.height_m / 7.0, abs=0.03)
    assert found.stature < 0.99


def test_next_sample_is_a_place_in_the_image_that_lowers_the_error() -> None:
    found = calibrate_from_people(standing_people(STREET, 6, seed=2, noise_px=2.0), STREET.size, "pinhole")
    following = found.assessment.next_sample
    assert following is not None
    assert 0 <= following.foot_px[0] < 480 and 0 <= following.foot_px[1] < 360
    assert following.floor_error_m < found.assessment.floor_error_m


def test_next_sample_lies_where_something_moved() -> None:
    people = standing_people(STREET, 6, seed=2, noise_px=2.0)
    walked = np.zeros((360, 480), np.bool_)
    walked[:, :200] = True
    left = calibrate_from_people(people, STREET.size, "pinhole", walked=walked).assessment.next_sample
    right = calibrate_from_people(people, STREET.size, "pinhole", walked=~walked).assessment.next_sample
    assert left is not None and left.foot_px[0] < 201
    assert right is not None and right.foot_px[0] > 199
    none = calibrate_from_people(people, STREET.size, "pinhole", walked=np.zeros((360, 480), np.bool_)).assessment
    assert none.next_sample is None and "pixel" not in none.sentence


def test_middles_of_noisy_boxes_are_read_as_such() -> None:
    """Taken at their word, heads above feet everywhere would be a focal length without end."""
    rng = np.random.default_rng(0)
    samples = []
    for s in standing_people(STREET, 24, seed=5):
        left, top, width, height = s.box_px
        ends = np.array([left + width / 2, top, left + width / 2, top + height]) + rng.normal(0, 1, 4)
        samples.append(HumanSample(s.box_px, (ends[0], ends[1]), (ends[2], ends[3])))
    found = calibrate_from_people(samples, STREET.size, "pinhole")
    assert abs(math.log(found.camera.focal_px / 740.0)) < 2 * found.std.focal
    assert found.camera.focal_px < 1.4 * 740.0


def test_odd_sample_is_named_and_changes_little() -> None:
    people = standing_people(STREET, 12, seed=1, noise_px=1.0)
    left, top, width, height = people[4].box_px
    people[4] = HumanSample((left, top, width, height / 2), people[4].head_px, (left + width / 2, top + height / 2))
    found = calibrate_from_people(people, STREET.size, "pinhole", known=KnownValues(focal_px=740.0))
    assert found.odd == (4,)
    assert found.camera.height_m == pytest.approx(7.0, rel=0.04)


def test_two_known_values_for_one_are_refused() -> None:
    with pytest.raises(ValueError, match="focal_px or field_deg"):
        KnownValues(focal_px=700.0, field_deg=60.0)


def test_outlines_that_end_too_high_are_within_the_deviation() -> None:
    """Of four people, seen often, the lowest 2 px are missing everywhere, as where a shadow is removed."""
    truth = GroundCamera(640, 480, 450.0, 3.5, math.radians(65), "pinhole")
    cut = []
    for sample in standing_people(truth, 16, seed=3):
        left, top, width, height = sample.box_px
        (u, v) = sample.foot_px
        cut.append(replace(sample, box_px=(left, top, width, height - 2.0), foot_px=(u, v - 2.0)))
    by_hand = calibrate_from_people(cut, truth.size, truth.lens)
    found = calibrate_from_people(cut, truth.size, truth.lens, independent=4)
    off = abs(math.log(found.camera.focal_px / truth.focal_px))
    assert off < 2.0 * found.std.focal
    assert found.std.focal > by_hand.std.focal
