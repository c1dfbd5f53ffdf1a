"""What people of a challenge do with things: seats, rolling chairs, bags, books, partitions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.random_scenes.choreography import Part, arriving, direction, unit
from benchmarks.random_scenes.stage import Stage
from benchmarks.random_scenes.tables import Choreography, NoPlaceError
from calib.types import F64
from planview.synthetic.people import PUSH_M, PUT_M
from planview.synthetic.scene import Furniture

FAR = (0.0, -60.0)
"""Where things wait that a person brings along: outside of everything."""
COLOURS = ("#703838", "#2c4a70", "#386048", "#3a3a40", "#8a6a30", "#5a4a7a")


def _put(stage: Stage, kind: str, at: F64 | tuple[float, float], scale_m: float = 0.05, **values: Any) -> Furniture:
    """A thing with a name and a random colour."""
    surface = {"colour": str(stage.rng.choice(COLOURS)), "scale_m": scale_m, "contrast": 0.3}
    name = f"{kind} {len(stage.furniture) + 1}"
    return stage.put(kind=kind, name=name, at_m=tuple(at), surface=surface, **values)


def sit(stage: Stage, plan: Choreography) -> Iterator[Part]:
    """Sit on chairs, one of them low."""
    seats = []
    for k in range(plan.people):
        place = stage.spot(1.15)
        heading = np.rad2deg(direction(place, stage.camera_xy)) + stage.rng.uniform(-120, 120)
        if k % 2:
            seats.append(_put(stage, "bench", place, heading_deg=heading, size_m=(0.45, 0.5, 0.33)))
        else:
            seats.append(_put(stage, str(stage.rng.choice(("chair", "office_chair"))), place, heading_deg=heading))
    for seat, part in zip(seats, arriving(stage, plan), strict=True):
        part.take_seat(seat, plan.duration_s)
        part.do("stand", 1.0)
        part.leave()
        yield part


def chair(stage: Stage, plan: Choreography) -> Iterator[Part]:
    """The first person rolls a chair to another place and leaves it; every further one rolls it on."""
    here, ready = stage.spot(0.9, reserve=False), 0.0
    item = _put(stage, "office_chair", here, heading_deg=float(stage.rng.uniform(0, 360)))
    for k in range(plan.people):
        good = stage.spots(0.8)
        good = good[np.linalg.norm(good - here, axis=1) > 1.2]
        if len(good) == 0:
            raise NoPlaceError("no other place for a chair")
        there = np.asarray(stage.rng.choice(good))
        face = direction(here, there)
        part = Part(stage, max(plan.begin_s(k), ready - 4), plan.speed_mps)
        part.walk_to(here - PUSH_M * unit(face))
        part.until(max(part.time_s + 1.0, ready), face)
        part.go([there - PUSH_M * unit(face)], 0.8, push=item.name)
        ready = part.time_s + 1.0
        part.do("stand", 1.0, face)
        part.go([there - (PUSH_M + 0.4) * unit(face)])
        part.leave()
        yield part
        here = there


def bag(stage: Stage, plan: Choreography) -> Iterator[Part]:
    """One person brings a bag or a box and leaves it on the floor; another takes it away."""
    place, kind = stage.spot(0.9), str(stage.rng.choice(("bag", "box")))
    item = _put(stage, kind, FAR, size_m=(0.3, 0.4, float(stage.rng.uniform(0.3, 0.55))))
    bringer = Part(stage, plan.begin_s(0), plan.speed_mps, waits=True)
    way = [bringer.behind, bringer.inside, *stage.floor.route(bringer.inside, place)]
    bringer.go(way, carry=item.name)
    put = place + PUT_M * unit(direction(way[-2], way[-1]))
    bringer.do("bend", 1.2)
    bringer.leave()
    yield bringer
    taker = Part(stage, max(plan.begin_s(1), bringer.time_s + plan.duration_s - 6), plan.speed_mps)
    taker.walk_to(put + 0.95 * unit(direction(put, taker.place)))
    taker.do("bend", 1.5, direction(taker.place, put))
    taker.take_away(item.name, taker.place)
    yield taker


def book(stage: Stage, plan: Choreography) -> Iterator[Part]:
    """One person puts a book on a shelf at eye level, another takes it."""
    spots = stage.spots(0.3)
    far = spots[spots[:, 1] > np.quantile(spots[:, 1], 0.7)]
    x = float(stage.rng.choice(far)[0])
    shelf_y = min(stage.room.size_m[1] - 0.2, float(far[:, 1].max()) + 0.55)
    stage.put(kind="shelf", at_m=(x, shelf_y), heading_deg=-90.0)
    item = _put(stage, "box", FAR, 0.08, size_m=(0.22, 0.07, 0.3))
    at = np.array([x, shelf_y - 0.2 - PUT_M])
    before = at - np.array([0.0, 0.45])
    bringer = Part(stage, plan.begin_s(0), plan.speed_mps, waits=True)
    way = [bringer.behind, bringer.inside, *stage.floor.route(bringer.inside, before), at]
    bringer.go(way, carry=item.name, put_z_m=float(stage.rng.uniform(1.4, 1.65)))
    bringer.do("reach", 1.5, np.pi / 2)
    bringer.go([before])
    bringer.leave()
    yield bringer
    taker = Part(stage, max(plan.begin_s(1), bringer.time_s + plan.duration_s - 8), plan.speed_mps)
    taker.walk_to(before)
    taker.go([at])
    taker.do("reach", 1.5, np.pi / 2)
    taker.take_away(item.name, before)
    yield taker


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
    x, height = float(stage.rng.uniform(x0 + length / 2, x1 - length / 2)), float(stage.rng.uniform(1.2, 1.4))
    stage.put(kind="partition", at_m=(x, y), heading_deg=90.0, size_m=(0.06, length, height))
    free = x0 + 0.4 if x - x0 > x1 - x else x1 - 0.4
    if abs(free - x) > length / 2 + 0.6:
        stage.put(kind="partition", at_m=(free, y + 0.1), heading_deg=90.0, size_m=(0.06, 0.9, 2.05))
    for k, part in enumerate(arriving(stage, plan)):
        lane, end = y + 0.75 + 0.62 * (k % 2), part.time_s + plan.duration_s
        while part.time_s < end:
            for at in (x0, x1) if part.side == "west" else (x1, x0):
                part.walk_to(np.array([at, lane]))
            part.go([np.array([x, lane])])
            part.fidget(3.0, ("stand",))
        part.leave()
        yield part
