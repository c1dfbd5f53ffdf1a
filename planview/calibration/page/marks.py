"""What is marked on a frame, and how its parts are picked up and moved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from calib.people.samples import HumanSample

Point = tuple[float, float]
Part = Literal["head", "foot", "nw", "ne", "sw", "se", "whole", "point"]
CORNERS: dict[Part, Point] = {"nw": (0.0, 0.0), "ne": (1.0, 0.0), "sw": (0.0, 1.0), "se": (1.0, 1.0)}
"""Corners of a box by its width and height."""


@dataclass
class Draft:
    """A person being marked; what is not marked yet is None."""

    box_px: tuple[float, float, float, float] | None = None
    head_px: Point | None = None
    foot_px: Point | None = None

    @property
    def step(self) -> Literal["box", "head", "foot"]:
        """What is marked next."""
        return "box" if self.box_px is None else "head" if self.head_px is None else "foot"


class Handle(NamedTuple):
    """A part of a numbered sample, "whole" for all of a person, or a numbered floor point ("point")."""

    number: int
    part: Part


def handle_points(sample: HumanSample) -> list[tuple[Part, Point]]:
    """Head, foot and corners of a sample [px]."""
    left, top, width, height = sample.box_px
    corners = [(part, (left + a * width, top + b * height)) for part, (a, b) in CORNERS.items()]
    return [("head", sample.head_px), ("foot", sample.foot_px), *corners]


def grabbed(samples: Sequence[tuple[int, HumanSample]], at: Point, reach_px: float) -> Handle | None:
    """What of numbered samples lies under the mouse: the nearest part within reach, else the smallest box around it."""
    found = [
        (math.hypot(u - at[0], v - at[1]), Handle(number, part))
        for number, sample in samples
        for part, (u, v) in handle_points(sample)
    ]
    near = [entry for entry in found if entry[0] <= reach_px]
    if near:
        return min(near, key=lambda entry: entry[0])[1]
    around = [(s.box_px[2] * s.box_px[3], Handle(number, "whole")) for number, s in samples if _inside(s, at)]
    return min(around)[1] if around else None


def nearest(points: Sequence[Point], at: Point, reach_px: float) -> Handle | None:
    """The floor point under the mouse."""
    distances = [math.hypot(u - at[0], v - at[1]) for u, v in points]
    best = min(range(len(points)), key=distances.__getitem__, default=-1)
    return Handle(best, "point") if best >= 0 and distances[best] <= reach_px else None


def moved(sample: HumanSample, part: Part, by: Point) -> HumanSample:
    """A sample with one part, or all of it, moved [px]. Raises ValueError: it would be no standing person any more."""
    (left, top, width, height), (du, dv) = sample.box_px, by
    if part == "whole":
        box = (left + du, top + dv, width, height)
        return replace(sample, box_px=box, head_px=_add(sample.head_px, by), foot_px=_add(sample.foot_px, by))
    if part == "head":
        return replace(sample, head_px=_add(sample.head_px, by))
    if part == "foot":
        return replace(sample, foot_px=_add(sample.foot_px, by))
    right, bottom = CORNERS[part]  # 1 for the edge that moves, else the opposite one does
    left, width = (left, width + du) if right else (left + du, width - du)
    top, height = (top, height + dv) if bottom else (top + dv, height - dv)
    return replace(sample, box_px=(left, top, width, height))


def _add(point: Point, by: Point) -> Point:
    return point[0] + by[0], point[1] + by[1]


def _inside(sample: HumanSample, at: Point) -> bool:
    left, top, width, height = sample.box_px
    return left <= at[0] <= left + width and top <= at[1] <= top + height
