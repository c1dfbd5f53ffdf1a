"""Samples for ``planview calibrate human`` from a video of people walking by (Zhang et al. 2008, 3.3), and pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike

from calib.errors import WorkError
from calib.ground_camera import GroundCamera
from calib.images import as_colour
from calib.people.calibration import HumanCalibration
from calib.people.model import HumanModel
from calib.people.samples import MIN_SAMPLES, HumanSample, choose_spread
from calib.types import F64, U8, Bool
from planview.calibration.floor import draw_grid
from planview.engine.config import SingleCameraParams
from planview.engine.sensor import CameraSensor, StageClock
from planview.foreground.bodies import MIN_SIZE, BodyPath, bodies_of, continue_paths
from planview.progress import Progress, unseen
from stereo.recording import Recording, SingleCamera, refuse_untimed

GIVEN = (255, 140, 0)
COMPUTED = (200, 60, 255)
SIZE_TOLERANCE = 0.15
"""Sizes differ by this part from what most people have at that place [1] (body heights, strides)."""


def draw_samples(image: U8, camera: GroundCamera, model: HumanModel, samples: Sequence[HumanSample]) -> U8:
    """Draw what was given (blue) and what was computed (pink) of each sample (figure 6a), on a copy."""
    canvas = as_colour(image).copy()
    for sample in samples:
        left, top, width, height = sample.box_px
        right = left + width
        bottom = top + height
        corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
        _outline(canvas, corners, (sample.head_px, sample.foot_px), GIVEN)
        draw_person(canvas, camera, model, camera.back_project(sample.foot_px), COMPUTED)
    return canvas


def draw_person(
    canvas: U8, camera: GroundCamera, model: HumanModel, xy_m: ArrayLike, colour: tuple[int, int, int]
) -> None:
    """Draw one computed person: outline, head and foot; nothing where the camera cannot see them."""
    hull = model.hulls(camera, xy_m)
    if np.isfinite(hull).all():
        _outline(canvas, hull, (model.head(camera, xy_m), model.foot(camera, xy_m)), colour)


def _outline(canvas: U8, corners: F64, dots: Sequence[ArrayLike], colour: tuple[int, int, int]) -> None:
    """Draw a closed line through (N, 2) corners, and dots."""
    points = np.rint(corners).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(canvas, [points], True, colour, 1, cv2.LINE_AA)
    for dot in dots:
        u, v = np.asarray(dot, dtype=np.float64).tolist()
        if math.isfinite(u + v) and max(abs(u), abs(v)) < 1e5:
            cv2.circle(canvas, (round(u), round(v)), 3, colour, -1, cv2.LINE_AA)


def floor_around(camera: GroundCamera, samples: Sequence[HumanSample]) -> tuple[float, float, float, float] | None:
    """The floor 2 m around where people of samples stand [m]; None where none stands on it."""
    pixels = np.array([sample.foot_px for sample in samples])
    feet = camera.back_project(pixels.reshape(-1, 2))
    feet = feet[np.isfinite(feet).all(axis=1)]
    if not len(feet):
        return None
    x_min, y_min = (feet.min(axis=0) - 2.0).tolist()
    x_max, y_max = (feet.max(axis=0) + 2.0).tolist()
    return x_min, y_min, x_max, y_max


def crowd(camera: GroundCamera, model: HumanModel) -> F64:
    """(N, 2) floor positions [m] with feet on an even grid of pixels, where a whole person is in the image."""
    u = (np.arange(6) + 0.5) / 6 * camera.width
    v = (np.arange(4) + 1.0) / 4 * camera.height * 0.98
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    feet = camera.back_project(pixels)
    is_near = np.isfinite(feet).all(axis=1) & (np.hypot(feet[:, 0], feet[:, 1]) < 60.0)
    feet = feet[is_near]
    boxes = model.boxes(camera, feet)
    left_top = boxes[:, :2]
    right_bottom = left_top + boxes[:, 2:]
    is_whole = (left_top > 0).all(axis=1) & (right_bottom < np.array(camera.size)).all(axis=1)
    return np.asarray(feet[is_whole])


def collect_samples(
    video: Recording[SingleCamera], count: int = 50, progress: Progress = unseen
) -> tuple[tuple[HumanSample, ...], int]:
    """Take samples of people who walk by, where each is whole and apart from the others; and how many of them are
    independent of each other.

    Every frame gives a sample per blob that touches neither the image's edge nor another blob. Blobs that walk are
    kept, and of these the ones that have the size of most blobs at their place, so that pairs, parts and shadows fall
    out. Head and foot are the ends of the blob's longest axis, the head the upper one; where most blobs have no longest
    axis (from straight above) both are its middle. Raises InputError: frames without times. WorkError: too few
    samples, or none of a usual size.
    """
    refuse_untimed(video)
    camera = CameraSensor(SingleCameraParams(), video.sensor.size)
    clock = StageClock()
    paths: list[BodyPath] = []
    for frame in video:
        mask = camera.look(camera.measure(frame.images, clock), frame, clock).foreground
        # How long the background is learned before samples are taken [s].
        if frame.timestamp_s >= 1.0 and mask is not None:
            continue_paths(paths, bodies_of(mask, frame.index), frame.index)
        progress(frame.index + 1, video.n_frames or None)
    walking = [path for path in paths if path.walks]
    walkers = [sample for path in walking for sample in path.samples]
    name = str(video.path)
    bodies = [sample for sample in walkers if sample.head_px != sample.foot_px]
    if len(bodies) < 0.5 * len(walkers):
        bodies = walkers
    if len(bodies) < MIN_SAMPLES:
        found = f"{len(bodies)} sightings of a whole person apart from others in {video.n_frames} frames"
        raise WorkError(
            f"{name}: expected people who walk by, found {found} (at least {MIN_SAMPLES} needed): the camera must "
            "stand still, and people must cross the view one by one, head and feet inside it and at least "
            f"{MIN_SIZE:.0%} of its height; else mark people by hand"
        )
    is_usual = usual_sizes(bodies)
    # Share of the blobs that must have one person's size to have a usual size [1].
    if is_usual.sum() < max(MIN_SAMPLES, 0.35 * len(bodies)):
        raise WorkError(
            f"{name}: expected walkers of one person's size each, found {is_usual.mean():.0%} of {len(bodies)} blobs "
            "of one size: people hide each other too much, mark samples by hand instead"
        )
    chosen = choose_spread([bodies[i] for i in np.flatnonzero(is_usual)], count)
    # A lone walker is worth eight independent samples (the same body at other places).
    return chosen, max(len(walking), 8)


def usual_sizes(samples: Sequence[HumanSample]) -> Bool:
    """(n,) mask of the samples of the size of most people at their place.

    A standing person's size in the image is linear in the foot's pixel, but for steep cameras nearly so; of the planes
    through three samples the one is taken that most samples lie on.
    """
    feet = np.array([sample.foot_px for sample in samples])
    sizes = np.array([sample.diagonal_px for sample in samples])
    terms = np.column_stack([np.ones(len(feet)), feet])
    rng = np.random.default_rng(0)
    best = np.zeros(len(sizes), dtype=np.bool_)
    for _ in range(400):
        three = rng.choice(len(sizes), 3, replace=False)
        if abs(np.linalg.det(terms[three])) < 1.0:
            continue
        expected = terms @ np.linalg.solve(terms[three], sizes[three])
        is_fit = np.abs(sizes - expected) < SIZE_TOLERANCE * np.maximum(expected, 1.0)
        if is_fit.sum() > best.sum():
            best = is_fit
    if best.any():
        return best
    return np.asarray(np.abs(sizes - np.median(sizes)) < SIZE_TOLERANCE * sizes)


def people_picture(
    found: HumanCalibration, samples: Sequence[HumanSample], video: Recording[SingleCamera] | None
) -> U8:
    """Given and computed features next to people all over the floor (figure 6)."""
    camera = found.camera
    width, height = camera.size
    image: U8 = np.full((height, width, 3), 60, dtype=np.uint8)
    if video is not None:
        _paste(samples, video, image)
    given = draw_samples(image, camera, found.model, samples)
    crowded = draw_grid(image, camera.project, floor_around(camera, samples) or (-5.0, -5.0, 5.0, 5.0))
    for xy in crowd(camera, found.model):
        draw_person(crowded, camera, found.model, xy, COMPUTED)
    return np.hstack([given, crowded])


def _paste(samples: Sequence[HumanSample], video: Recording[SingleCamera], canvas: U8) -> None:
    """Put the first frame with a sample onto a canvas, then the people of the other samples."""
    by_frame = {sample.frame: sample for sample in samples if 0 <= sample.frame < video.n_frames}
    for number, frame in enumerate(video.at(sorted(by_frame) or [0])):
        image = as_colour(frame.image)
        if number == 0:
            canvas[:] = image
            continue
        left, top, width, height = (round(v) for v in by_frame[frame.index].box_px)
        part = np.s_[max(0, top - 4) : top + height + 4, max(0, left - 4) : left + width + 4]
        canvas[part] = image[part]
