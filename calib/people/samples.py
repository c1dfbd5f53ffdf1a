"""Samples of standing people (Zhang et al. 2008, section 3.3, figure 5), and the choice of those to calibrate from."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import InputError
from calib.io import expecting, read_text, write_whole
from calib.types import F64, I64, Bool

COLUMNS = (
    "left_px", "top_px", "width_px", "height_px", "head_x_px", "head_y_px", "foot_x_px", "foot_y_px",
)  # fmt: skip
"""Columns of a CSV of samples, besides an optional ``frame`` and ``height_m`` (the person's); the suffix ``_px`` may be
left out."""
MIN_SAMPLES = 3
"""The paper asks for a person at 3 or more positions."""


@dataclass(frozen=True)
class HumanSample:
    """One standing person. Raises ValueError: values that are not finite, an empty box, a head or foot far outside the
    box, or no body height.

    Attributes:
        box_px: left, top, width, height [px].
        head_px: top of the head (u, v) [px].
        foot_px: middle between the feet (u, v) [px].
        frame: index in the video it was taken from, -1 when unknown.
        height_m: of this person, with shoes [m]; None when unknown.
    """

    box_px: tuple[float, float, float, float]
    head_px: tuple[float, float]
    foot_px: tuple[float, float]
    frame: int = -1
    height_m: float | None = None

    def __post_init__(self) -> None:
        pixels = (*self.box_px, *self.head_px, *self.foot_px)
        if not all(map(math.isfinite, pixels)):
            raise ValueError(f"expected finite pixels, got {pixels}")
        if self.height_m is not None and not 0.5 <= self.height_m <= 2.5:
            raise ValueError(f"expected a person of 0.5 to 2.5 m, got {self.height_m:g}")
        left, top, width, height = self.box_px
        if width <= 0 or height <= 0:
            raise ValueError(f"expected a box of positive width and height, got {width:g}x{height:g}")
        # A point marked by hand may miss the box by some pixels, not by a quarter of the person.
        slack = 8.0 + 0.25 * max(width, height)
        for name, (u, v) in (("head", self.head_px), ("foot", self.foot_px)):
            across = left - slack <= u <= left + width + slack
            down = top - slack <= v <= top + height + slack
            if not (across and down):
                raise ValueError(f"expected the {name} within its box {self.box_px}, got ({u:g}, {v:g})")

    @property
    def diagonal_px(self) -> float:
        """Diagonal of the box."""
        return math.hypot(self.box_px[2], self.box_px[3])

    def row(self) -> F64:
        """(8,) left, top, right, bottom, head u, v, foot u, v [px]."""
        left, top, width, height = self.box_px
        return np.array([left, top, left + width, top + height, *self.head_px, *self.foot_px])


@dataclass(frozen=True, eq=False)
class MarkedPeople:
    """Samples as arrays.

    Attributes:
        rows: (n, 8) float64 (see ``HumanSample.row``).
        scale: (n,) float64 height that is expected of each over the model's [1]; scale_std: its deviation.
        given: (n,) bool whose height was given; the others' follows the people's mean.
        repeats: number of samples that are worth one independent sample [1].
    """

    rows: F64
    scale: F64
    scale_std: F64
    given: Bool
    repeats: float = 1.0

    def __len__(self) -> int:
        return len(self.rows)

    def without(self, rows: I64) -> MarkedPeople:
        """The other people than those of some rows."""
        rest = np.delete(np.arange(len(self)), rows)
        return MarkedPeople(self.rows[rest], self.scale[rest], self.scale_std[rest], self.given[rest], self.repeats)


def refuse_bad_samples(samples: Sequence[HumanSample], size: tuple[int, int], name: str) -> None:
    """Refuse samples from which no camera can be determined."""
    if len(samples) < MIN_SAMPLES:
        raise InputError(f"{name}: expected at least {MIN_SAMPLES} samples at different places, found {len(samples)}")
    width, height = size
    for number, sample in enumerate(samples, 1):
        left, top, box_width, box_height = sample.box_px
        slack = 3.0 + 0.02 * max(box_width, box_height)
        over_right = left + box_width - width
        over_bottom = top + box_height - height
        if max(-left, -top, over_right, over_bottom) > slack:
            actual = f"sample {number} at ({left:g}, {top:g}) of {box_width:g}x{box_height:g} (wrong image size?)"
            raise InputError(f"{name}: expected boxes inside the image of {width}x{height}, found {actual}")


def only_boxes(rows: F64) -> bool:
    """True if heads and feet of (n, 8) rows are but the middles of the boxes' edges, so that they add nothing.

    Taken at their word they would mean that people never lean outwards in the image, which is an infinite focal length.
    """
    middle = (rows[:, 0] + rows[:, 2]) / 2
    ends = np.stack([middle, rows[:, 1], middle, rows[:, 3]], axis=1)
    return bool((np.abs(rows[:, 4:] - ends) <= 1.0).all())


def level_ends(rows: F64) -> bool:
    """True if the boxes of (n, 8) rows end at the marked heads and feet, where an outline reaches beyond them."""
    ends = np.sort(rows[:, [5, 7]], axis=1)
    return bool((np.abs(ends - rows[:, [1, 3]]) <= 1.0).all())


def read_samples(path: Path) -> tuple[HumanSample, ...]:
    """Read samples from CSV (columns ``COLUMNS``) or JSON.

    JSON is a list of objects, or an object with such a list under "samples"; each has "box" [left, top, width,
    height], "head" [u, v], "foot" [u, v] and optionally "frame" and the person's "height_m", or the columns of the CSV
    as keys. Raises InputError: unreadable, columns missing, or values that cannot be a person's.
    """
    samples = []
    data = _load(path)
    rows = data.get("samples") if isinstance(data, dict) else data
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"{path}: expected a list of samples with box, head and foot, found something else")
    for number, row in enumerate(rows, 1):
        try:
            samples.append(_sample(row))
        except KeyError as error:
            columns = f"the columns {', '.join(COLUMNS)} (or box, head, foot in JSON)"
            raise InputError(f"{path}: expected {columns}, found no {error} in sample {number}") from error
        except (ValueError, TypeError, OverflowError) as error:
            raise InputError(f"{path}: expected a standing person in sample {number}, found: {error}") from error
    return tuple(samples)


def read_image_size(path: Path) -> tuple[int, int] | None:
    """(width, height) [px] of the image that the samples of a JSON were taken in; None where it has none. Raises
    InputError: unreadable, or an "image_size" that is not two positive whole numbers."""
    data = _load(path)
    size = data.get("image_size") if isinstance(data, dict) else None
    if size is None:
        return None
    match size:
        case [int(width), int(height)] if width > 0 and height > 0:
            return width, height
    raise InputError(f'{path}: expected "image_size" as [width, height] in pixels, found {size!r}')


def write_samples(samples: Sequence[HumanSample], path: Path, image_size: tuple[int, int] | None = None) -> None:
    """Write samples as JSON with the (width, height) of their image."""
    data: dict[str, Any] = {}
    if image_size is not None:
        data["image_size"] = image_size
    data["samples"] = []
    for sample in samples:
        row = {"frame": sample.frame, "box": sample.box_px, "head": sample.head_px, "foot": sample.foot_px}
        if sample.height_m is not None:
            row["height_m"] = sample.height_m
        data["samples"].append(row)
    write_whole(path, json.dumps(data, indent=1) + "\n")


def _load(path: Path) -> Any:
    """The value of a JSON, or the rows of a CSV."""
    text = read_text(path, "a CSV or JSON file of samples", 10_000_000)
    if text.lstrip()[:1] in ("[", "{"):
        with expecting(path, "JSON", ValueError, RecursionError):
            return json.loads(text)
    with expecting(path, "a CSV of samples", csv.Error):
        return list(csv.DictReader(text.splitlines(), skipinitialspace=True))


def _sample(row: Mapping[str, Any]) -> HumanSample:
    if "box" in row:
        values = [*row["box"], *row["head"], *row["foot"]]
    else:
        values = []
        for name in COLUMNS:
            short = name.removesuffix("_px")
            values.append(row[short] if short in row else row[name])
    left, top, width, height, head_u, head_v, foot_u, foot_v = map(_number, values)
    frame = row.get("frame")
    height_m = row.get("height_m")
    return HumanSample(
        (left, top, width, height),
        (head_u, head_v),
        (foot_u, foot_v),
        frame=-1 if frame in (None, "") else int(float(frame)),
        height_m=None if height_m in (None, "") else _number(height_m),
    )


def _number(value: Any) -> float:
    if isinstance(value, bool) or value is None:
        raise ValueError(f"expected a number, got {value!r}")
    return float(value)


def choose_spread(samples: Sequence[HumanSample], count: int) -> tuple[HumanSample, ...]:
    """Samples that cover the places where people were observed: of each of ``count`` areas of feet the one whose box is
    the median in height among those near the area's centre, which no stoop, stride or half a person is."""
    if len(samples) <= count:
        return tuple(samples)
    from scipy.cluster.vq import kmeans2  # a tenth of a second, and only many samples need it

    feet = np.array([s.foot_px for s in samples])
    area = kmeans2(feet, count, minit="++", rng=0)[1]
    heights = np.array([s.box_px[3] for s in samples])
    chosen = []
    for number in np.unique(area):
        members = np.flatnonzero(area == number)
        offsets = feet[members] - feet[members].mean(axis=0)
        by_distance = members[np.argsort(np.hypot(*offsets.T), kind="stable")]
        near = by_distance[: max(3, len(members) // 2)]
        # Height follows the foot's row; what is left over is the person.
        rows = np.column_stack([np.ones(len(near)), feet[near, 1]])
        line = np.linalg.lstsq(rows, heights[near], rcond=None)[0]
        by_height = near[np.argsort(heights[near] - rows @ line, kind="stable")]
        chosen.append(int(by_height[len(near) // 2]))
    return tuple(samples[i] for i in sorted(chosen))
