"""Samples for ``planview calibrate human``, collected from a video of one person walking alone (Zhang 2008, 3.3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calib.errors import WorkError
from calib.human.choice import choose_spread
from calib.human.samples import MIN_SAMPLES, HumanSample
from calib.types import F64, U8, Bool
from planview.foreground.blobs import Blobs, find_blobs
from planview.pipeline.single_camera import SingleCamera, SingleCameraParams
from stereo.recording import Video

WARM_UP_S = 1.0
"""The background is learned for so long before samples are taken [s] (our choice)."""
MIN_HEIGHT_SHARE = 0.06
"""A person is at least this share of the image's height [1]: smaller ones say nothing about a camera (our choice)."""
RIVAL_SHARE = 0.25
"""Another blob above this share of the largest is another person, or a piece of the same: the frame is passed over
(our choice)."""
MAX_CROWDED = 0.2
"""Share of the frames with people from which two people side by side mean that this is no lone walker [1] (our choice).
Where several people walk, blobs merge and hide each other also in the frames that show one blob: with four people in
view the height came out 11 % low at a stated deviation of 2 %."""
MIN_FILL, MAX_FILL = 0.3, 0.95
"""A standing person fills this share of the box [1]; streaks and lit rectangles do not."""


@dataclass(frozen=True)
class BlobSighting:
    """What one frame shows of the walker.

    Attributes:
        sample: the only whole person in view, None where there is none.
        crowded: two people are side by side.
    """

    sample: HumanSample | None
    crowded: bool


def collect_samples(
    video: Video, count: int = 12, params: SingleCameraParams | None = None, done: Callable[[], None] = lambda: None
) -> tuple[HumanSample, ...]:
    """Follow the only moving thing and take samples where it stands apart from the image's edge.

    Head and foot are the ends of the blob's longest axis, the head the upper one; of a blob without a longest axis
    (from straight above) both are its middle.

    Args:
        video: of one person walking alone.
        count: how many samples to take.
        done: called after every frame.
    Raises:
        WorkError: fewer than 3 frames with a whole person, or several people at once in more than ``MAX_CROWDED`` of
            the frames with people.
    """
    camera = SingleCamera(params or SingleCameraParams(), video.size)
    sightings = []
    for frame in video:
        observation = camera.observe(frame)
        if frame.timestamp_s >= WARM_UP_S and observation.foreground is not None:
            sightings.append(sighting_of(observation.foreground, frame.index))
        done()
    _check_alone(sightings, str(video.path))
    usual = _usual([s.sample for s in sightings if s.sample is not None])
    if len(usual) < MIN_SAMPLES:
        raise WorkError(
            f"{video.path}: expected one person walking alone, found {len(usual)} frames in which a single whole "
            f"person is in view (at least {MIN_SAMPLES} needed)"
        )
    return choose_spread(usual, count)


def sighting_of(mask: U8, frame: int) -> BlobSighting:
    """The only person of a (H, W) foreground mask, and whether there are several side by side."""
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((7, 5), np.uint8))
    blobs = find_blobs(np.asarray(closed, dtype=np.uint8))
    if len(blobs) < 2:
        return BlobSighting(None, crowded=False)
    best, *others = (int(i) for i in np.argsort(blobs.area_px[1:])[::-1] + 1)
    rivals = [i for i in others if blobs.area_px[i] > RIVAL_SHARE * blobs.area_px[best]]
    tall = blobs.box_px[best][3] >= MIN_HEIGHT_SHARE * mask.shape[0]
    if rivals or not tall:
        return BlobSighting(None, crowded=bool(tall) and any(_side_by_side(blobs, best, i) for i in rivals))
    return BlobSighting(_whole_person(blobs, best, mask.shape, frame), crowded=False)


def _check_alone(sightings: Sequence[BlobSighting], name: str) -> None:
    with_people = sum(s.crowded or s.sample is not None for s in sightings)
    crowded = sum(s.crowded for s in sightings)
    if crowded > MAX_CROWDED * with_people:
        raise WorkError(
            f"{name}: expected one person walking alone, found several people at once in "
            f"{crowded / with_people:.0%} of the frames with people: mark samples by hand instead"
        )


def _side_by_side(blobs: Blobs, one: int, other: int) -> bool:
    """Whether two blobs share no column and neither is a scrap: pieces of one upright body are above each other."""
    (left, _, width, height), (u, _, w, h) = (blobs.box_px[i] for i in (one, other))
    return bool((u >= left + width or left >= u + w) and h >= RIVAL_SHARE * height)


def _whole_person(blobs: Blobs, label: int, shape: tuple[int, ...], frame: int) -> HumanSample | None:
    """Sample of a blob in an image of (H, W), None where it is cut off or no body."""
    left, top, width, height = (int(v) for v in blobs.box_px[label])
    rows, columns = shape
    cut = left <= 1 or top <= 1 or left + width >= columns - 1 or top + height >= rows - 1
    fill = float(blobs.area_px[label]) / (width * height)
    if cut or not MIN_FILL <= fill <= MAX_FILL:
        return None
    inside: Bool = np.asarray(blobs.labels[top : top + height, left : left + width] == label)
    head, foot = _ends(inside)
    return HumanSample(
        (float(left), float(top), float(width), float(height)),
        (left + float(head[0]), top + float(head[1])),
        (left + float(foot[0]), top + float(foot[1])),
        frame,
    )


def _ends(inside: Bool) -> tuple[F64, F64]:
    """Head and foot (u, v) within the box."""
    v, u = np.nonzero(inside)
    points = np.column_stack([u, v]).astype(np.float64)
    centre = points.mean(axis=0)
    spread, axes = np.linalg.eigh(np.cov((points - centre).T))
    if spread[1] < 2.0 * spread[0]:
        return centre, centre
    axis = axes[:, 1] if axes[1, 1] > 0 else -axes[:, 1]
    along = (points - centre) @ axis
    low, high = np.quantile(along, (0.005, 0.995))
    return centre + low * axis, centre + high * axis


def _usual(sightings: list[HumanSample]) -> list[HumanSample]:
    """Without the odd ones: boxes much larger or smaller than others near them are parts, shadows or two people."""
    if len(sightings) < 5:
        return sightings
    feet = np.array([s.foot_px for s in sightings])
    heights = np.array([s.box_px[3] for s in sightings])
    kept = []
    for sample, foot, height in zip(sightings, feet, heights, strict=True):
        near = np.argsort(np.hypot(*(feet - foot).T))[: max(5, len(sightings) // 10)]
        if abs(height - np.median(heights[near])) < 0.15 * height:
            kept.append(sample)
    return kept
