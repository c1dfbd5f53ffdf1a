"""What people of a random scene do with things: seats, rolling chairs, bags, books, partitions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.random_scenes.challenge import Choreography
from benchmarks.random_scenes.choreography import Part, arriving, begin_s, fidget, unit
from benchmarks.random_scenes.stage import NoPlaceError, Stage
from calib.types import F64
from planview.synthetic.people import PUSH_M
from planview.synthetic.scene import Surface

PUT_M = 0.5
"""A carried thing is put down so far ahead of the hips (``Cast``)."""
_FAR = (0.0, -60.0)
"""Where things wait that a person brings along: outside of everything."""
_COLOURS = ("#703838", "#2c4a70", "#386048", "#3a3a40", "#8a6a30", "#5a4a7a")


def _surface(stage: Stage, scale_m: float = 0.05) -> Surface:
    return Surface(colour=str(stage.rng.choice(_COLOURS)), scale_m=scale_m, contrast=0.3)


def _name(stage: Stage, kind: str) -> str:
    return f"{kind} {len(stage.furniture) + 1}"


def _to_camera(stage: Stage, place: F64) -> float:
    offset = stage.camera_xy - place
    return float(np.arctan2(offset[1], offset[0]))


def _outside(stage: Stage, plan: Choreography) -> Part:
    """The first person of a plan before any step, out of view."""
    part = Part(stage, begin_s(plan, 0), None, plan.speed_mps)
    part.steps.pop()
    part.time_s, part.place = part.enter_s, part.start
    return part


def sit(stage: Stage, plan: Choreography) -> Iterator[Part]:
    """Sit on chairs, one of them low."""
    seats = []
    for k in range(plan.people):
        place = stage.spot(1.15)
        heading = np.rad2deg(_to_camera(stage, place)) + stage.rng.uniform(-120, 120)
        low = k % 2 == 1
        seats.append(
            stage.put(
                kind="bench" if low else str(stage.rng.choice(("chair", "office_chair"))),
                name=_name(stage, "seat"), at_m=tuple(place), heading_deg=float(heading),
                size_m=(0.45, 0.5, 0.33) if low else None, surface=_surface(stage),
            )
        )  # fmt: skip
    for seat, part in zip(seats, arriving(stage, plan), strict=True):
        part.take_seat(seat, plan.duration_s)
        part.do("stand", 1.0)
        part.leave()
        yield part


def floor(stage: Stage, plan: Choreography) -> Iterator[Part]:
    """Sit on the floor."""
    for part in arriving(stage, plan):
        place = stage.spot(0.75)
        part.walk_to(place)
        face = _to_camera(stage, place) + float(stage.rng.uniform(-1.5, 1.5))
        part.do("stand", 1.0, face)
        part.do("sit", plan.duration_s, face)
        part.do("stand", 1.5, face)
        part.leave()
        yield part


def chair(stage: Stage, plan: Choreography) -> Iterator[Part]:
    """The first person rolls a chair to another place and leaves it; every further one rolls it on."""
    here = stage.spot(0.9, reserve=False)
    item = _name(stage, "chair")
    stage.put(kind="office_chair", name=item, at_m=tuple(here), heading_deg=float(stage.rng.uniform(0, 360)),
              surface=_surface(stage))  # fmt: skip
    ready = 0.0
    for k in range(plan.people):
        good = stage.spots(0.8)
        good = good[np.linalg.norm(good - here, axis=1) > 1.2]
        if len(good) == 0:
            raise NoPlaceError("no other place for a chair")
        there = good[int(stage.rng.integers(len(good)))]
        way = (there - here) / np.linalg.norm(there - here)
        face = float(np.arctan2(way[1], way[0]))
        part = Part(stage, max(begin_s(plan, k), ready - 4), None, plan.speed_mps)
        part.walk_to(here - PUSH_M * way)
        part.until(max(part.time_s + 1.0, ready), face)
        part.go([there - PUSH_M * way], 0.8, push=item)
        ready = part.time_s + 1.0
        part.do("stand", 1.0, face)
        part.go([there - (PUSH_M + 0.4) * way])
        part.leave()
        yield part
        here = there


def bag(stage: Stage, plan: Choreography) -> list[Part]:
    """One person brings a bag or a box and leaves it on the floor; another takes it away."""
    item, kind = _name(stage, "bag"), str(stage.rng.choice(("bag", "box")))
    size = (0.3, 0.4, float(stage.rng.uniform(0.3, 0.55)))
    place = stage.spot(0.9)
    stage.put(kind=kind, name=item, at_m=_FAR, size_m=size, surface=_surface(stage))
    bringer = _outside(stage, plan)
    way = stage.route(bringer.inside, place)
    bringer.go([bringer.behind, bringer.inside, *way], carry=item)
    put = place + PUT_M * unit(_to(way[-2] if len(way) > 1 else bringer.inside, way[-1]))
    bringer.do("bend", 1.2)
    bringer.leave()
    taker = Part(stage, max(begin_s(plan, 1), bringer.time_s + plan.duration_s - 6), None, plan.speed_mps)
    taker.walk_to(put + 0.95 * unit(_to(put, taker.place)))
    taker.do("bend", 1.5, _to(taker.place, put))
    taker.take_away(item, taker.place)
    return [bringer, taker]


def _to(a: F64, b: F64) -> float:
    return float(np.arctan2(b[1] - a[1], b[0] - a[0]))


def book(stage: Stage, plan: Choreography) -> list[Part]:
    """One person puts a book on a shelf at eye level, another takes it."""
    spots = stage.spots(0.3)
    far = spots[spots[:, 1] > np.quantile(spots[:, 1], 0.7)]
    x = float(far[int(stage.rng.integers(len(far))), 0])
    shelf_y = min(stage.room.size_m[1] - 0.2, float(far[:, 1].max()) + 0.55)
    stage.put(kind="shelf", at_m=(x, shelf_y), heading_deg=-90.0)
    item, z = _name(stage, "book"), float(stage.rng.uniform(1.4, 1.65))
    stage.put(kind="box", name=item, at_m=_FAR, size_m=(0.22, 0.07, 0.3), surface=_surface(stage, 0.08))
    at = np.array([x, shelf_y - 0.2 - PUT_M])
    before = at - np.array([0.0, 0.45])
    bringer = _outside(stage, plan)
    way = stage.route(bringer.inside, before)
    bringer.go([bringer.behind, bringer.inside, *way, at], carry=item, put_z_m=z)
    bringer.do("reach", 1.5, np.pi / 2)
    bringer.go([before])
    bringer.leave()
    taker = Part(stage, max(begin_s(plan, 1), bringer.time_s + plan.duration_s - 8), None, plan.speed_mps)
    taker.walk_to(before)
    taker.go([at])
    taker.do("reach", 1.5, np.pi / 2)
    taker.take_away(item, before)
    return [bringer, taker]


def partition(stage: Stage, plan: Choreography) -> Iterator[Part]:
    """Walk to and fro behind a row of partitions that leave heads in view, and behind a screen that leaves nothing."""
    spots = stage.spots(0.2)
    low, high = np.quantile(spots[:, 1], [0.1, 0.98])
    y = float(low + stage.rng.uniform(0.35, 0.6) * (high - low))
    behind = spots[np.abs(spots[:, 1] - (y + 0.75)) < 0.1, 0]
    if len(behind) == 0 or np.ptp(behind) < 2.4:
        raise NoPlaceError("no room behind partitions")
    x0, x1 = float(behind.min()), float(behind.max())
    length = min(2.4, (x1 - x0) * 0.6)
    x = float(stage.rng.uniform(x0 + length / 2, x1 - length / 2))
    stage.put(
        kind="partition", at_m=(x, y), heading_deg=90.0, size_m=(0.06, length, float(stage.rng.uniform(1.2, 1.4)))
    )
    free = x0 + 0.4 if x - x0 > x1 - x else x1 - 0.4
    if abs(free - x) > length / 2 + 0.6:
        stage.put(kind="partition", at_m=(free, y + 0.1), heading_deg=90.0, size_m=(0.06, 0.9, 2.05))
    for k, part in enumerate(arriving(stage, plan)):
        lane = y + 0.75 + 0.62 * (k % 2)
        end = part.time_s + plan.duration_s
        while part.time_s < end:
            for at in (x0, x1) if part.side == "west" else (x1, x0):
                part.walk_to(np.array([at, lane]))
            part.go([np.array([x, lane])])
            fidget(part, 3.0, ("stand",))
        part.leave()
        yield part
