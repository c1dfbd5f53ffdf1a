"""Samples for ``planview calibrate human`` from a video of people walking by (Zhang et al. 2008, 3.3), and pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

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
from planview.foreground.ghosts import Blobs, find_blobs
from planview.progress import Progress, unseen
from stereo.recording import Recording, SingleCamera, refuse_untimed

GIVEN = (255, 140, 0)
COMPUTED = (200, 60, 255)
MIN_SIZE = 0.06
"""A person is at least this share of the image's height [1]: smaller ones add nothing about a camera."""
SIZE_TOLERANCE = 0.15
"""Sizes differ by this part from what most people have at that place [1] (body heights, strides)."""


def draw_samples(image: U8, camera: GroundCamera, model: HumanModel, samples: Sequence[HumanSample]) -> U8:
    """What was given (blue) and what was computed (pink) of each sample (figure 6a), on a copy."""
    canvas = as_colour(image).copy()
    for sample in samples:
        left, top, width, height = sample.box_px
        corners = np.array([(left, top), (left + width, top), (left + width, top + height), (left, top + height)])
        _outline(canvas, corners, (sample.head_px, sample.foot_px), GIVEN)
        draw_person(canvas, camera, model, camera.back_project(sample.foot_px), COMPUTED)
    return canvas


def draw_person(
    canvas: U8, camera: GroundCamera, model: HumanModel, xy_m: ArrayLike, colour: tuple[int, int, int]
) -> None:
    """One computed person: outline, head and foot; nothing where the camera cannot see them."""
    hull = model.hull(camera, *(float(v) for v in np.asarray(xy_m)))
    if np.isfinite(hull).all():
        _outline(canvas, hull, (model.head(camera, xy_m), model.foot(camera, xy_m)), colour)


def _outline(canvas: U8, corners: F64, dots: Sequence[ArrayLike], colour: tuple[int, int, int]) -> None:
    """A closed line through (N, 2) corners, with dots."""
    cv2.polylines(canvas, [np.rint(corners).astype(np.int32).reshape(-1, 1, 2)], True, colour, 1, cv2.LINE_AA)
    for u, v in (np.asarray(dot, dtype=np.float64) for dot in dots):
        if math.isfinite(u + v) and max(abs(u), abs(v)) < 1e5:
            cv2.circle(canvas, (round(float(u)), round(float(v))), 3, colour, -1, cv2.LINE_AA)


def floor_around(camera: GroundCamera, samples: Sequence[HumanSample]) -> tuple[float, float, float, float] | None:
    """The floor 2 m around where people of samples stand [m]; None where none stands on it."""
    feet = camera.back_project(np.array([s.foot_px for s in samples]).reshape(-1, 2))
    feet = feet[np.isfinite(feet).all(axis=1)]
    if not len(feet):
        return None
    (x_min, y_min), (x_max, y_max) = (feet.min(axis=0) - 2.0).tolist(), (feet.max(axis=0) + 2.0).tolist()
    return x_min, y_min, x_max, y_max


def crowd(camera: GroundCamera, model: HumanModel) -> F64:
    """(N, 2) floor positions [m] with feet on an even grid of pixels, where a whole person is in the image."""
    u = (np.arange(6) + 0.5) / 6 * camera.width
    v = (np.arange(4) + 1.0) / 4 * camera.height * 0.98
    feet = camera.back_project(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    feet = feet[np.isfinite(feet).all(axis=1) & (np.hypot(feet[:, 0], feet[:, 1]) < 60.0)]
    boxes = model.boxes(camera, feet)
    far = boxes[:, :2] + boxes[:, 2:]
    inside = (boxes[:, :2] > 0).all(axis=1) & (far < np.array(camera.size)).all(axis=1)
    return np.asarray(feet[inside])


@dataclass(eq=False)
class _Path:
    """Blobs of one walker."""

    samples: list[HumanSample]
    last_frame: int

    @property
    def walks(self) -> bool:
        boxes = np.array([s.box_px for s in self.samples])
        middles = boxes[:, :2] + boxes[:, 2:] / 2
        size = float(np.median([s.diagonal_px for s in self.samples]))
        # What moves by less than half a body, or is met in fewer frames, is furniture, light or a ghost.
        return len(self.samples) >= 4 and float(np.hypot(*np.ptp(middles, axis=0))) >= 0.5 * size


class CollectedSamples(NamedTuple):
    """Samples of people walking, and how many of them are independent of each other."""

    samples: tuple[HumanSample, ...]
    independent: int


def collect_samples(video: Recording[SingleCamera], count: int = 50, progress: Progress = unseen) -> CollectedSamples:
    """Take samples of people who walk by, where each is whole and apart from the others.

    Every frame gives a sample per blob that touches neither the image's edge nor another blob. Blobs that walk are
    kept, and of these the ones that have the size of most blobs at their place, so that pairs, parts and shadows fall
    out. Head and foot are the ends of the blob's longest axis, the head the upper one; where most blobs have no longest
    axis (from straight above) both are its middle. Raises InputError: frames without times. WorkError: too few
    samples, or none of a usual size.
    """
    refuse_untimed(video)
    camera = CameraSensor(SingleCameraParams(), video.sensor.size)
    clock = StageClock()
    paths: list[_Path] = []
    for frame in video:
        mask = camera.look(camera.measure(frame.images, clock), frame, clock).foreground
        # The background is learned for so long before samples are taken [s].
        if frame.timestamp_s >= 1.0 and mask is not None:
            _continue(paths, bodies_of(mask, frame.index), frame.index)
        progress(frame.index + 1, video.n_frames or None)
    walking = [path for path in paths if path.walks]
    walkers = [sample for path in walking for sample in path.samples]
    name = str(video.path)
    upright = [s for s in walkers if s.head_px != s.foot_px]
    bodies = upright if len(upright) >= 0.5 * len(walkers) else walkers
    if len(bodies) < MIN_SAMPLES:
        found = f"{len(bodies)} sightings of a whole person apart from others in {video.n_frames} frames"
        raise WorkError(
            f"{name}: expected people who walk by, found {found} (at least {MIN_SAMPLES} needed): the camera must "
            "stand still, and people must cross the view one by one, head and feet inside it and at least "
            f"{MIN_SIZE:.0%} of its height; else mark people by hand"
        )
    usual = usual_sizes(bodies)
    # Share of the blobs that must have one person's size to have a usual size [1].
    if usual.sum() < max(MIN_SAMPLES, 0.35 * len(bodies)):
        raise WorkError(
            f"{name}: expected walkers of one person's size each, found {usual.mean():.0%} of {len(bodies)} blobs of "
            "one size: people hide each other too much, mark samples by hand instead"
        )
    chosen = choose_spread([s for s, ok in zip(bodies, usual, strict=True) if ok], count)
    # A lone walker is worth eight independent samples (the same body at other places).
    return CollectedSamples(chosen, max(len(walking), 8))


def bodies_of(mask: U8, frame: int) -> list[HumanSample]:
    """Whole people apart from others in a (H, W) foreground mask."""
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((7, 5), np.uint8))
    blobs = find_blobs(np.asarray(closed, dtype=np.uint8))
    large = [i for i in range(1, len(blobs)) if max(blobs.box_px[i][2:]) >= MIN_SIZE * mask.shape[0]]
    samples = (_whole_person(blobs, i, mask.shape, frame) for i in large if not _crowded(blobs, i))
    return [sample for sample in samples if sample is not None]


def usual_sizes(samples: Sequence[HumanSample]) -> Bool:
    """(n,) whether the size is that of most people at its place.

    A standing person's size in the image is linear in the foot's pixel, but for steep cameras nearly so; of the planes
    through three samples the one is taken that most samples lie on.
    """
    feet = np.array([s.foot_px for s in samples])
    sizes = np.array([s.diagonal_px for s in samples])
    terms = np.column_stack([np.ones(len(feet)), feet])
    rng = np.random.default_rng(0)
    best = np.zeros(len(sizes), dtype=np.bool_)
    for _ in range(400):
        chosen = rng.choice(len(sizes), 3, replace=False)
        if abs(np.linalg.det(terms[chosen])) >= 1.0:
            expected = terms @ np.linalg.solve(terms[chosen], sizes[chosen])
            fits = np.abs(sizes - expected) < SIZE_TOLERANCE * np.maximum(expected, 1.0)
            best = max(best, fits, key=np.count_nonzero)
    return best if best.any() else np.abs(sizes - np.median(sizes)) < SIZE_TOLERANCE * sizes


def _continue(paths: list[_Path], bodies: Sequence[HumanSample], frame: int) -> None:
    """Append every body to the path of the frame before that it overlaps most, or begin one."""
    open_paths = [path for path in paths if 0 < frame - path.last_frame <= 2]
    for body in bodies:
        overlaps, (a, b, w, h) = [], body.box_px
        for c, d, v, g in (path.samples[-1].box_px for path in open_paths):
            common = max(0.0, min(a + w, c + v) - max(a, c)) * max(0.0, min(b + h, d + g) - max(b, d))
            overlaps.append(common / (w * h + v * g - common))
        best = int(np.argmax(overlaps)) if overlaps else -1
        # Boxes of one walker in frames that follow each other overlap by this part of their union [1].
        if best >= 0 and overlaps[best] >= 0.3:
            path = open_paths.pop(best)
            path.samples.append(body)
            path.last_frame = frame
        else:
            paths.append(_Path([body], frame))


def _crowded(blobs: Blobs, label: int) -> bool:
    """Whether another blob that is not noise is near the box."""
    low = blobs.box_px[:, :2]
    high = blobs.box_px[:, :2] + blobs.box_px[:, 2:]
    # Nearer blobs may be pieces of one person, or hide each other [px]; above and below, within this share of the
    # body's height [1]: bodies break at belt and collar.
    gap = np.array([4.0, max(4.0, 0.35 * float(blobs.box_px[label][3]))])
    near = ((low < high[label] + gap) & (high > low[label] - gap)).all(axis=1)
    # A blob above this share of another's area is not noise [1].
    near &= blobs.area_px > 0.08 * blobs.area_px[label]
    near[[0, label]] = False
    return bool(near.any())


def _whole_person(blobs: Blobs, label: int, shape: tuple[int, ...], frame: int) -> HumanSample | None:
    """Sample of a blob in an image of (H, W), None where it is cut off or no body."""
    left, top, width, height = (int(v) for v in blobs.box_px[label])
    rows, columns = shape
    cut = left <= 1 or top <= 1 or left + width >= columns - 1 or top + height >= rows - 1
    fill = float(blobs.area_px[label]) / (width * height)
    if cut or not 0.3 <= fill <= 0.95:  # the share that a standing person fills; streaks and lit rectangles do not
        return None
    inside: Bool = np.asarray(blobs.labels[top : top + height, left : left + width] == label)
    ends = _ends(inside)
    (u, v), (foot_u, foot_v) = (ends + np.array([left, top])).tolist()
    # A box of pixels ends half a pixel beyond their centres.
    return HumanSample((left - 0.5, top - 0.5, float(width), float(height)), (u, v), (foot_u, foot_v), frame)


def _ends(inside: Bool) -> F64:
    """(2, 2) head and foot (u, v) within the box."""
    v, u = np.nonzero(inside)
    points = np.column_stack([u, v]).astype(np.float64)
    centre = points.mean(axis=0)
    spread, axes = np.linalg.eigh(np.cov((points - centre).T))
    # Variance along a body over that across it from which head and feet are its ends [1].
    if spread[1] < 2.0 * spread[0]:
        return np.stack([centre, centre])
    axis = axes[:, 1] if axes[1, 1] > 0 else -axes[:, 1]
    along = (points - centre) @ axis
    low, high = np.quantile(along, (0.002, 0.998))
    return np.stack([centre + (low - 0.5) * axis, centre + (high + 0.5) * axis])


def people_picture(
    found: HumanCalibration, samples: Sequence[HumanSample], video: Recording[SingleCamera] | None
) -> U8:
    """Given and computed features next to people all over the floor (figure 6)."""
    camera = found.camera
    image = _background(camera.size, samples, video)
    given = draw_samples(image, camera, found.model, samples)
    crowded = draw_grid(image, camera.project, floor_around(camera, samples) or (-5.0, -5.0, 5.0, 5.0))
    for xy in crowd(camera, found.model):
        draw_person(crowded, camera, found.model, xy, COMPUTED)
    return np.hstack([given, crowded])


def _background(size: tuple[int, int], samples: Sequence[HumanSample], video: Recording[SingleCamera] | None) -> U8:
    """The frame of the first sample with the other samples' people pasted in, or plain grey without a video."""
    canvas: U8 = np.full((size[1], size[0], 3), 60, dtype=np.uint8)
    if video is None:
        return canvas
    by_frame = {s.frame: s for s in samples if s.frame >= 0}
    for frame in video:
        image = as_colour(frame.image)
        if frame.index == 0:
            canvas = image.copy()
        if sample := by_frame.get(frame.index):
            left, top, width, height = (round(v) for v in sample.box_px)
            part = np.s_[max(0, top - 4) : top + height + 4, max(0, left - 4) : left + width + 4]
            canvas[part] = image[part]
        if frame.index >= max(by_frame, default=0):
            break
    return canvas
