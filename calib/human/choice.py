"""Which of many observed people to calibrate from: few, spread over the image, none of them odd."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.human.samples import HumanSample
from calib.types import F64, I64


def choose_spread(samples: Sequence[HumanSample], count: int) -> tuple[HumanSample, ...]:
    """Samples that cover the places where people were observed.

    The feet are divided into ``count`` areas (k-means from farthest-point seeds). Of each area the sample is taken
    whose box is the median in height among those near the area's centre: a stoop, a stride or half a person differ
    from the median, so no odd one is taken.

    Args:
        samples: all there are.
        count: how many to take at most.
    Returns:
        At most ``count`` samples, in the order given.
    """
    if len(samples) <= count:
        return tuple(samples)
    feet = np.array([s.foot_px for s in samples])
    area = _areas(feet, count)
    heights = np.array([s.box_px[3] for s in samples])
    chosen = []
    for k in np.unique(area):
        members = np.flatnonzero(area == k)
        distance = np.hypot(*(feet[members] - feet[members].mean(axis=0)).T)
        near = members[np.argsort(distance, kind="stable")[: max(3, len(members) // 2)]]
        # Height follows the foot's row; what is left over is the person.
        left_over = heights[near] - _line(feet[near, 1], heights[near])
        chosen.append(int(near[np.argsort(left_over, kind="stable")[len(near) // 2]]))
    return tuple(samples[i] for i in sorted(chosen))


def _areas(feet: F64, count: int) -> I64:
    """(n,) number of the area of every foot."""
    centres = [feet[int(np.argmin(feet[:, 1]))]]
    for _ in range(count - 1):
        distance = np.min([np.hypot(*(feet - c).T) for c in centres], axis=0)
        centres.append(feet[int(np.argmax(distance))])
    means = np.array(centres)
    area = np.zeros(len(feet), dtype=np.int64)
    for _ in range(20):
        area = np.argmin(np.linalg.norm(feet[:, None] - means[None], axis=2), axis=1)
        means = np.array([feet[area == k].mean(axis=0) if (area == k).any() else means[k] for k in range(count)])
    return np.asarray(area, dtype=np.int64)


def _line(x: F64, y: F64) -> F64:
    spread = float(np.var(x))
    slope = float(np.mean((x - x.mean()) * (y - y.mean()))) / spread if spread > 0 else 0.0
    return np.asarray(y.mean() + slope * (x - x.mean()))
