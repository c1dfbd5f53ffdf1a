import numpy as np
import pytest
from toy_stereo import ToyWorld, toy_rig

from calib.pose import SE3
from calib.rig import StereoRig
from stereo.depth import RectifiedGeometry
from stereo.rig_correction import RigCorrection, fit_correction, match_corners, measure_correction

GEOMETRY = RectifiedGeometry(640, 480, 500.0, 500.0, 319.5, 239.5, 0.12)


def matches_of(
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
    baseline_deg: tuple[float, float] = (0.0, 0.0),
    depths_m: tuple[float, float] = (1.5, 6.0),
    noise_px: float = 0.1,
    wrong: float = 0.0,
    count: int = 2000,
) -> np.ndarray:
    """Points all over the view of a pair whose right camera is turned, in pixels of the calibration without it."""
    rng = np.random.default_rng(1)
    u, v, depth = rng.uniform(0, 640, count), rng.uniform(0, 480, count), rng.uniform(*depths_m, count)
    points = GEOMETRY.rays(np.column_stack([u, v])) * depth[:, None]
    about_y, about_z = np.radians(baseline_deg)
    centre = 0.12 * np.array([1.0, about_z, -about_y])
    seen = (points - centre) @ SE3.from_rotvec(np.radians(turn_deg)).rotation  # p_turned = turn^T p
    right = 500.0 * seen[:, :2] / seen[:, 2:] + (319.5, 239.5)
    offset = right[:, 1] - v + rng.normal(size=count) * noise_px
    offset = np.where(rng.uniform(size=count) < wrong, rng.uniform(-6, 6, count), offset)
    return np.column_stack([u, v, right[:, 0], offset])


def test_roll_moves_rows_by_the_column():
    matches = matches_of((0.0, 0.0, 0.3), noise_px=0.0)
    column = matches[:, 2] - 319.5  # a camera turned to the right by 0.3 degrees sees its right half higher
    np.testing.assert_allclose(matches[:, 3], -column * np.tan(np.radians(0.3)), atol=0.03)
    found = fit_correction(matches, GEOMETRY)
    assert np.degrees(found.angles[2]) == pytest.approx(0.3, abs=0.003)
    assert list(found.is_applied) == [False, False, True]


@pytest.mark.parametrize("turn_deg", [(0.2, 0.0, 0.0), (0.0, 0.6, 0.0), (-0.5, 0.5, 0.5), (0.1, -0.6, -0.3)])
def test_turn_of_the_right_camera_is_found_among_wrong_matches(turn_deg):
    found = fit_correction(matches_of(turn_deg, wrong=0.2), GEOMETRY)
    assert np.all(np.abs(found.angles[:3] - np.radians(turn_deg)) < 3.0 * found.deviations[:3])
    pitch, yaw, roll = np.degrees(found.deviations[:3])
    assert max(pitch, roll) < 0.05
    assert 0.15 <= yaw < 0.16
    assert found.after_px < 0.12 < found.before_px


@pytest.mark.parametrize("depths_m", [(1.5, 6.0), (3.0, 3.01)])
def test_turn_of_the_baseline_is_not_taken_for_one_of_the_camera(depths_m):
    found = fit_correction(matches_of(baseline_deg=(0.3, 0.3), depths_m=depths_m), GEOMETRY)
    assert not found.is_applied.any()


@pytest.mark.parametrize("noise_px", [0.0, 0.1, 0.5])
def test_right_calibration_is_kept(noise_px):
    found = fit_correction(matches_of(noise_px=noise_px), GEOMETRY)
    assert np.abs(np.degrees(found.applied)).max() < 0.005
    assert found.before_px == pytest.approx(found.after_px, abs=2e-3)
    assert str(found) == "the calibration fits the images"


def test_correction_grows_steadily_with_the_turn():
    turns = np.array([0.0, 0.2, 0.3, 0.4, 0.6])
    yaws = [np.degrees(fit_correction(matches_of((0.0, turn, 0.0)), GEOMETRY).applied[1]) for turn in turns]
    assert np.all(np.diff(yaws) / np.diff(turns) < 3.0)  # no turn is taken for 0 that a little more is not
    np.testing.assert_allclose(np.array(yaws)[[0, -1]], [0.0, 0.6], atol=0.02)


def test_corrected_rig_is_the_true_one():
    turn_deg = (0.2, -0.3, 0.4)
    claimed, true = toy_rig(), toy_rig(rotation_deg=turn_deg)
    turned = SE3.from_rotvec(np.radians(turn_deg)).rotation.T  # toy_rig states the pose, right_SE3_left
    found = RigCorrection(SE3(turned, np.zeros(3)).rotvec, np.full(3, 1e-6), np.ones(3))(claimed)
    np.testing.assert_allclose(found.right_SE3_left.matrix, true.right_SE3_left.matrix, atol=1e-12)


def test_correction_turns_about_the_axes_of_the_rectified_frame():
    upright = toy_rig().left
    rig = StereoRig(upright, upright, SE3(np.eye(3), np.array([0.0, -0.12, 0.0])))  # one camera below the other
    corrected = RigCorrection(np.array([0.01, 0.0, 0.0]), np.full(3, 1e-6), np.ones(3))(rig)
    assert corrected.baseline_m == pytest.approx(0.12)
    pitch = corrected.right_SE3_left.rotvec
    np.testing.assert_allclose(pitch, [0.0, -0.01, 0.0], atol=1e-12)  # about the baseline, the camera's y axis


def test_sentence_names_the_angle_that_was_corrected():
    angles, deviations = np.radians([0.004, 0.06, 0.158]), np.radians([0.003, 0.03, 0.01])
    correction = RigCorrection(angles, deviations, np.array([0.25, 0.5, 1.0]))
    assert "roll corrected by 0.158 ± 0.010 degrees" in str(correction)


def test_a_rig_that_has_rolled_may_have_turned_as_far_about_the_vertical_which_rows_do_not_show():
    rolled = RigCorrection(np.array([0.0, 0.0, 2e-3]), np.array([0.0, 1e-3, 1e-4]), np.array([0.0, 0.5, 1.0]))
    yaw = np.sqrt(0.5 * 1e-3**2 + 0.5 * 2e-3**2)  # what was measured half surely, and the roll's half share of two
    np.testing.assert_allclose(rolled.left_over, [0.0, yaw, 1e-4])
    kept = RigCorrection(np.zeros(3), np.array([1e-4, 1e-3, 1e-4]), np.array([0.0, 0.5, 0.0]))
    np.testing.assert_allclose(kept.left_over, 0.0)
    assert np.degrees(RigCorrection().left_over) == pytest.approx([0.3 * np.sqrt(0.6)] * 3)  # nothing was measured


def test_matches_of_a_shifted_image_show_the_shift():
    left, _ = ToyWorld().pair(toy_rig())
    right = np.roll(left, (3, -20), axis=(0, 1))
    matches = match_corners(left, right, 40.0)
    assert len(matches) > 60
    assert np.median(matches[:, 3]) == pytest.approx(3.0, abs=0.02)
    assert np.median(matches[:, 0] - matches[:, 2]) == pytest.approx(20.0, abs=0.02)


def of_images(left: np.ndarray, right: np.ndarray) -> RigCorrection:
    geometry = RectifiedGeometry(320, 240, 230.0, 230.0, 159.5, 119.5, 0.12)
    return measure_correction([(left, right)], geometry, 40.0)


def test_images_that_do_not_agree_or_show_nothing_give_no_correction():
    left, other = (ToyWorld(seed=seed).pair(toy_rig())[seed - 1] for seed in (1, 2))
    assert not of_images(left, np.roll(left, (30, -20), axis=(0, 1))).is_applied.any()  # beyond the search
    assert not of_images(left, other).is_applied.any()
    for value in (0, 128, 255):
        found = of_images(*[np.full((240, 320), value, np.uint8)] * 2)
        assert np.isnan(found.before_px)
        assert np.isnan(found.deviations).all()
    assert not measure_correction([], GEOMETRY, 40.0).is_applied.any()


def test_texture_in_one_place_justifies_no_correction():
    left = np.full((240, 320), 100, np.uint8)
    left[100:140, 100:140] = ToyWorld().pair(toy_rig())[0][100:140, 100:140]
    found = of_images(left, np.roll(left, (2, -10), axis=(0, 1)))
    assert not found.is_applied.any()
    assert "too little texture" in str(found)


@pytest.mark.parametrize("gain", [0.4, 0.65, 1.0])
def test_corners_are_matched_in_a_darker_right_image(gain):
    left, right = ToyWorld(seed=1).pair(toy_rig())
    equal = len(match_corners(left, right, 40.0))
    assert len(match_corners(left, (right * gain).astype(np.uint8), 40.0)) > 0.8 * equal > 20
