"""Rectification, and rigs of several cameras."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from toy_stereo import ToyWorld, toy_rig, walking

from calib.camera import Camera
from calib.images import as_grey
from calib.pose import SE3
from calib.rig import StereoRig
from stereo.readers.open import SeveralSensors
from stereo.recording import Frame, Shot, Skipped
from stereo.rectify import (
    Rectifier,
    RectifyParams,
    aligned_rectifier,
    fold_radius,
    ideal_pinhole,
    is_ideal,
    rectified_rig,
    source_pixels,
)
from stereo.rig_correction import match_corners

TURN = (0.5, -0.6, 0.8)
BROWN = (-0.2, 0.05, 0.001, -0.001, 0.0)
RATIONAL = (-9.2, 65.3, -5e-05, 0.0005, -87.7, -9.29, 65.5, -87.8)


def test_rectifying_an_ideal_pair_changes_neither_its_images_nor_its_geometry():
    rectifier, (left, right) = Rectifier(toy_rig()), ToyWorld().pair(toy_rig())
    pair, geometry = rectifier(left, right), rectifier.geometry
    np.testing.assert_array_equal(pair.image, left)
    np.testing.assert_array_equal(pair.right_grey, right)
    assert geometry.size == (320, 240)
    assert geometry.focal_u_px == pytest.approx(230.0)
    assert (geometry.cu_px, geometry.cv_px, geometry.baseline_m) == pytest.approx((159.5, 119.5, 0.12))


FISHEYE = Camera(320, 240, 140.0, 140.0, 159.5, 119.5, "fisheye", (0.02, -0.01, 0.0, 0.0))


@pytest.mark.parametrize(("distortion", "lens", "most"), [((), None, 0.06), (BROWN, None, 0.06), ((), FISHEYE, 0.1)])
def test_rows_of_a_turned_pair_are_aligned(distortion, lens, most):
    rig = toy_rig(rotation_deg=TURN, distortion=distortion)
    rig = StereoRig(lens, lens, rig.right_SE3_left) if lens else rig
    pair = Rectifier(rig)(*ToyWorld().pair(rig, walking(10)))
    offsets = match_corners(pair.left_grey, pair.right_grey, 45.0)[:, 3]
    assert len(offsets) > 60
    assert np.median(np.abs(offsets)) < most


def test_cameras_one_above_the_other_give_an_upright_strip():
    camera = toy_rig().left
    rig = StereoRig(camera, camera, SE3(np.eye(3), np.array([0.0, -0.12, 0.0])))
    assert Rectifier(rig).geometry.size == (240, 320)


def test_large_images_are_reduced_to_the_working_size_unless_the_full_size_is_asked_for():
    rig = toy_rig((1280, 960), focal_px=920.0)
    assert Rectifier(rig, RectifyParams(working_px=0)).geometry.size == (1280, 960)
    rectifier = Rectifier(rig)
    assert rectifier.geometry.size == (640, 480)
    assert rectifier.geometry.focal_u_px == pytest.approx(460.0)
    checker = np.kron(np.indices((480, 640)).sum(axis=0) % 2, np.ones((2, 2))).astype(np.uint8) * 255
    np.testing.assert_array_equal(rectifier(checker, checker).image, checker[::2, ::2])


def test_odd_sizes_are_reduced_without_a_shift():
    ramp = np.tile(np.arange(1281) / 6.0, (801, 1)).astype(np.uint8)
    row = Rectifier(toy_rig((1281, 801), focal_px=900.0))(ramp, ramp).image[200].astype(float)
    expected = ((np.arange(640) + 0.5) * 1281 / 640 - 0.5) / 6.0
    assert np.abs(row - expected)[5:-5].mean() < 0.7


def test_folding_lens_model_is_not_followed_outside_its_range():
    camera = Camera(1280, 800, 808.0, 808.0, 634.0, 408.0, "rational", RATIONAL)
    assert 0.7 < fold_radius(camera) < 0.9 < fold_radius(toy_rig().left) == np.inf
    rectifier = Rectifier(StereoRig(camera, camera, SE3(np.eye(3), np.array([-0.07, 0.0, 0.0]))))
    rays = rectifier.geometry.rays(np.stack(np.meshgrid(*map(np.arange, rectifier.geometry.size)), axis=-1))
    radius = np.hypot(rays[..., 0], rays[..., 1])
    assert not rectifier.mask[radius > 0.9].any()
    assert rectifier.mask[radius < 0.4].all()


def test_field_grows_with_the_share_of_border_kept():
    rig = toy_rig(distortion=BROWN)
    rotation, _ = rig.rectifying_rotations()
    focals = [ideal_pinhole(rig.left, rotation, 640, q, 0.12).focal_u_px for q in (0.0, 0.5, 1.0)]
    assert focals[0] > focals[1] > focals[2]


def test_source_pixels_lead_back_to_the_recorded_pixel():
    rig = toy_rig(rotation_deg=TURN, distortion=BROWN)
    rotation, _ = rig.rectifying_rotations()
    g = Rectifier(rig).geometry
    ray = rotation @ rig.left.unproject([[100.0, 80.0]])[0]
    shift = np.eye(3)
    shift[:2, 2] = (g.matrix @ ray)[:2] / ray[2]  # its first pixel is that of the ray
    found = source_pixels(rig.left, rotation, np.linalg.inv(g.matrix) @ shift, (2, 2))
    np.testing.assert_allclose(found[0, 0], [100.0, 80.0], atol=1e-3)


@pytest.mark.parametrize("turn_deg", [(0.3, 0.0, 0.3), (0.0, 0.5, 0.0)])
def test_aligned_rectifier_takes_out_a_turn_the_calibration_missed(turn_deg):
    true, claimed = toy_rig(rotation_deg=turn_deg), toy_rig()
    world = ToyWorld()
    frames = [Frame(i, i, (world.pair(true, walking(i), i),)) for i in (0, 20)]
    _, rectifier, found = aligned_rectifier(claimed, frames, RectifyParams())
    left = (rectifier.rig.right_SE3_left @ true.right_SE3_left.inverse()).rotvec
    assert np.degrees(np.abs(left)).max() < 0.03
    assert found.after_px < 0.1 < found.before_px


def test_rectifier_keeps_the_colours_of_the_left_image():
    image = np.zeros((240, 320, 3), np.uint8)
    image[..., 2] = 200
    pair = Rectifier(toy_rig())(image, image)
    assert pair.image.shape == (240, 320, 3)
    assert pair.left_grey[100, 100] == pair.right_grey[100, 100] == as_grey(image)[0, 0]


def test_rectifier_refuses_images_of_another_size():
    wide = np.zeros((240, 321), np.uint8)
    with pytest.raises(ValueError, match=r"\(240, 320\)"):
        Rectifier(toy_rig())(wide, wide)


def test_a_reduced_pair_has_means_of_the_whole_image():
    rig = toy_rig(rotation_deg=TURN, distortion=BROWN)
    rectifier, images = Rectifier(rig), ToyWorld().pair(rig)
    whole, reduced = rectifier(*images), rectifier.reduce(*images, 2)
    np.testing.assert_array_equal(reduced.picture(), whole.image)
    np.testing.assert_array_equal(reduced.left_grey, whole.left_grey)
    np.testing.assert_array_equal(reduced.right_grey, whole.right_grey)
    means = whole.image.reshape(120, 2, 160, 2).mean(axis=(1, 3))
    assert reduced.image.shape == means.shape
    inside = rectifier.mask[::2, ::2] > 0
    assert abs((reduced.image - means)[inside].mean()) < 0.5
    near = (0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)
    off = [np.abs(np.roll(reduced.image, by, (0, 1)) - means)[inside].mean() for by in near]
    assert off[0] < 0.5 * min(off[1:])


class Times:
    """A recording of which only the times matter."""

    def __init__(self, times_s: list[float], fps: float = 10.0) -> None:
        self.times_s, self.fps, self.n_frames = times_s, fps, len(times_s)
        self.skipped = []
        self.name = ""

    def __iter__(self) -> Iterator[Frame[Shot]]:
        return (Frame(i, t, ((np.full((2, 2), i, np.uint8),),)) for i, t in enumerate(self.times_s))


def moments(*sensors: tuple[Times, float]) -> list[tuple[float, list[int | None]]]:
    """Time of every moment, and the frame index of each sensor."""
    recording = SeveralSensors(Path("r"), cast(Any, [times for times, _ in sensors]), [start for _, start in sensors])
    return [(round(m.timestamp_s, 4), [int(s[0][0, 0]) if s else None for s in m.shots]) for m in recording]


JITTER = 0.004 * np.array([0, 1, -1, 1, 0, -1])


@pytest.mark.parametrize(
    ("first", "second", "start_s", "frames"),
    [
        (Times([0.0, 0.1, 0.2]), Times([0.0, 0.1, 0.2]), 0.12, [[0, None], [1, 0], [2, 1], [None, 2]]),
        (Times([0.0, 0.1, 0.2]), Times([0.0, 0.2]), 0.0, [[0, 0], [1, None], [2, 1]]),
        (Times([0.0, 0.05, 0.1, 0.15, 0.2], 20.0), Times([0.0, 0.1, 0.2], 10.0), 0.0, [[0, 0], [2, 1], [4, 2]]),
        (Times(list(np.arange(6) / 10)), Times(list(np.arange(6) / 10 + JITTER)), 0.05, [[i, i] for i in range(6)]),
    ],
    ids=["clocks apart", "a frame missing", "a faster sensor", "half a period apart with jitter"],
)
def test_sensors_give_the_frames_of_each_moment(first, second, start_s, frames):
    assert [found for _, found in moments((first, 0.0), (second, start_s))] == frames


def test_times_are_means_that_begin_with_the_earliest_sensor():
    assert moments((Times([0.0]), 0.0), (Times([0.0]), -3.0))[0] == (0.0, [None, 0])
    even = Times([0.0, 0.1, 0.2])
    assert [time for time, _ in moments((even, 0.0), (even, 0.12))] == [0.0, 0.11, 0.21, 0.32]


def test_skipped_frames_name_their_sensor():
    times = Times([0.0])
    times.skipped.append(Skipped(4, "left: file is missing"))
    times.name = "north"
    recording = SeveralSensors(Path("r"), cast(Any, [times]), [0.0])
    assert [(s.index, s.why) for s in recording.skipped] == [(4, "north: left: file is missing")]
    assert recording.fps == pytest.approx(10.0)


def test_calibration_of_rectified_images_is_ideal():
    turned = toy_rig((320, 240), rotation_deg=(3.0, 0.0, 0.0))
    ideal = rectified_rig(turned)
    assert is_ideal(ideal)
    assert not is_ideal(turned)
    assert ideal.baseline_m == pytest.approx(turned.baseline_m)
    assert rectified_rig(ideal) is ideal
