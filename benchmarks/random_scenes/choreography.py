"""What people of a random scene do together, written step by step with the time that it takes."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.random_scenes.challenge import Choreography
from benchmarks.random_scenes.stage import NoPlaceError, Stage
from calib.types import F64
from planview.synthetic.room import furniture_size
from planview.synthetic.scene import Furniture

GATE_M = 0.75
"""People who meet come to this distance from the circle before they step into it [m]."""


class Part:
    """Steps of one person, who comes through an opening.

    Attributes:
        time_s: when the steps so far are done.
        place: (2,) where the person then is.
    """

    def __init__(self, stage: Stage, enter_s: float, side: str | None = None, speed_mps: float = 1.1) -> None:
        self.stage, self.enter_s, self.speed_mps = stage, enter_s, speed_mps
        self.side = side or stage.side()
        self.hidden, self.behind, self.inside = stage.door(self.side)
        self.start, self.place, self.time_s = self.hidden, self.hidden, enter_s
        self.steps: list[dict[str, Any]] = []
        self.wander: dict[str, Any] | None = None
        self.leaves = False
        self.go([self.behind, self.inside])

    def go(self, points: list[F64], speed_mps: float | None = None, **values: Any) -> None:
        """Straight through points."""
        speed = speed_mps or self.speed_mps
        self.steps.append({"go": [_pair(p) for p in points], "speed_mps": float(speed), **values})
        for point in points:
            self.time_s += float(np.linalg.norm(point - self.place)) / speed
            self.place = np.asarray(point, np.float64)

    def walk_to(self, point: F64, **values: Any) -> None:
        """Around obstacles to a point."""
        self.go(self.stage.route(self.place, point), **values)

    def leave(self, side: str | None = None) -> None:
        """Walk out of an opening (the person's own when none is named) and be gone."""
        if side is not None and side != self.side:
            self.hidden, self.behind, self.inside = self.stage.door(side)
        self.walk_to(self.inside)
        self.go([self.behind, self.hidden])
        self.leaves = True

    def do(self, action: str, seconds: float, face: float | None = None) -> None:
        """Stand, bend, reach, crouch or sit on the floor for a time, facing a direction [rad]."""
        self._face({f"{action}_s": float(seconds)}, face)
        self.time_s += seconds

    def until(self, time_s: float, face: float | None = None) -> None:
        """Stand until a time. Raises NoPlaceError: it is past already."""
        if time_s < self.time_s - 0.2:
            raise NoPlaceError(f"late by {self.time_s - time_s:.1f} s")
        self._face({"until_s": float(time_s)}, face)
        self.time_s = max(time_s, self.time_s)

    def _face(self, step: dict[str, Any], face: float | None) -> None:
        self.steps.append(step if face is None else step | {"face_deg": float(np.rad2deg(face))})

    def take_seat(self, seat: Furniture, seconds: float) -> None:
        """Come to the front of a seat, sit down, and stand up again."""
        front = np.deg2rad(seat.heading_deg)
        ahead = np.array([np.cos(front), np.sin(front)])
        # People come to this point in front of a seat before they sit down [m].
        self.walk_to(np.array(seat.at_m) + max(0.8, furniture_size(seat)[0] / 2 + 0.4) * ahead)
        self.steps.append({"sit_s": float(seconds), "on": seat.name})
        self.time_s += seconds + 2.0
        self.place = np.array(seat.at_m) + 0.32 * ahead

    def take_away(self, item: str, via: F64) -> None:
        """Carry a thing out of the room, first to a point."""
        self.go([via, *self.stage.route(via, self.inside), self.behind, self.hidden], carry=item)
        self.leaves = True

    def cartwheel(self, point: F64) -> None:
        """Turn a cartwheel to a point."""
        self.steps.append({"cartwheel": _pair(point)})
        self.time_s += 1.6 + float(np.linalg.norm(point - self.place)) / 1.3
        self.place = np.asarray(point, np.float64)

    def to_table(self) -> dict[str, Any]:
        """Movement of the person, as a table of ``[[people]]``."""
        inward = self.inside - self.behind
        table: dict[str, Any] = {
            "start_m": _pair(self.start),
            "enter_s": float(self.enter_s),
            "face_deg": float(np.rad2deg(np.arctan2(inward[1], inward[0]))),
            "steps": self.steps,
            "leaves": self.leaves,
        }
        return table if self.wander is None else table | {"wander": self.wander}


def _pair(point: F64) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def begin_s(plan: Choreography, k: int) -> float:
    """When the k-th person sets out."""
    return plan.start_s + k * plan.every_s


def arriving(stage: Stage, plan: Choreography) -> Iterator[Part]:
    """The people of a plan; what one of them does is decided before the next one comes."""
    for k in range(plan.people):
        yield Part(stage, begin_s(plan, k), None, plan.speed_mps)


def unit(angle: float) -> F64:
    return np.array([np.cos(angle), np.sin(angle)])


def cross(stage: Stage, plan: Choreography) -> list[Part]:
    """Walk through the view from opening to opening and back until the time is over, each in a lane of its own."""
    parts = []
    for k, (west, east) in enumerate(_lanes(stage, plan.people)):
        side = ("west", "east")[int(stage.rng.integers(2))]
        part = Part(stage, begin_s(plan, k), side, plan.speed_mps * float(stage.rng.uniform(0.9, 1.1)))
        while True:
            ends = _walked(stage, plan, [west, east] if side == "west" else [east, west])
            part.walk_to(ends[0])
            part.go(ends[1:])
            side = "east" if ends[-1] is east else "west"
            if part.time_s > plan.start_s + plan.duration_s:
                break
            pause_s, (_, behind, inside) = float(stage.rng.uniform(*plan.away_s)), stage.door(side)
            part.walk_to(inside)
            part.go([behind])
            part.do("stand", pause_s)
            part.go([inside])
        part.leave(side)
        parts.append(part)
    return parts


def _walked(stage: Stage, plan: Choreography, ends: list[F64]) -> list[F64]:
    """The ends of a lane in the order in which they are reached, with turns in view where the plan has some."""
    turns = int(stage.rng.integers(1, plan.turns + 1)) if plan.turns else 0
    # People who turn in view do so at this distance from the end of their lane, with the whole body in the image [m].
    inward = 0.35 * (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    inside = [ends[0] + inward, ends[1] - inward]
    return [ends[0], *(inside[k % 2] for k in range(1, turns + 1)), ends[(turns + 1) % 2]]


def _lanes(stage: Stage, n: int) -> list[tuple[F64, F64]]:
    """Ends of n lanes across the view, at least 0.6 m apart, in random order."""
    spots = stage.spots()
    low, high = np.quantile(spots[:, 1], [0.05, 0.95])
    if high - low < 0.6 * (n - 1) + 0.05:
        raise NoPlaceError(f"no {n} lanes in view")
    slack = np.sort(stage.rng.uniform(0, high - low - 0.6 * (n - 1), n))
    lanes = []
    for y in low + slack + 0.6 * np.arange(n):
        row = spots[np.abs(spots[:, 1] - y) < 0.1, 0]
        if len(row) == 0:
            raise NoPlaceError("a lane out of view")
        lanes.append((np.array([row.min(), y]), np.array([row.max(), y])))
    return [lanes[k] for k in stage.rng.permutation(n)]


def meet(stage: Stage, plan: Choreography) -> list[Part]:
    """Come together on a circle, move around each other, part; joiners come later and go earlier."""
    n = plan.people
    radius = plan.spacing_m / (2 * np.sin(np.pi / max(n, 2)))
    centre = stage.spot(radius + GATE_M + 0.15)
    angles = stage.rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(n) / n
    parts = [Part(stage, begin_s(plan, k), None, plan.speed_mps) for k in range(n)]
    early = n - plan.joiners
    for k in range(early):
        parts[k].walk_to(centre + (radius + GATE_M) * unit(angles[k]))
    together = max(p.time_s for p in parts[:early]) + 0.3
    beats, moments = _beats(stage, plan, together)
    joining, parting = moments[len(moments) // 3], moments[2 * len(moments) // 3]
    for k, part in enumerate(parts):
        late = k >= early
        if late:
            part.walk_to(centre + (radius + GATE_M) * unit(angles[k] + _turned(beats, joining)))
        part.until(joining if late else together)
        _mill(part, centre, radius, angles[k], beats, (joining, parting) if late else (together, moments[-1] + 1))
        end = angles[k] + _turned(beats, part.time_s + 0.01)
        part.do("stand", 0.2 + (0.0 if late else 1.2 * k))
        part.go([centre + (radius + GATE_M) * unit(end)])
        part.leave()
    return parts


def _beats(stage: Stage, plan: Choreography, start_s: float) -> tuple[list[tuple[float, float, float]], list[float]]:
    """Turns of the whole circle as (begin [s], end [s], angle), and the times between them."""
    beats, moments, t = [], [start_s], start_s + 1.5
    while t < start_s + plan.duration_s:
        moments.append(t)
        t += 1.4  # Others step in and out while no person turns.
        angle = float(stage.rng.choice((-1, 1)) * stage.rng.uniform(0.8, 3.3))
        length = abs(angle) * float(stage.rng.uniform(0.9, 1.6))
        beats.append((t, t + length, angle))
        t += length + float(stage.rng.uniform(0.3, 1.2))
    return beats, [*moments, t]


def _turned(beats: list[tuple[float, float, float]], time_s: float) -> float:
    return sum(angle for begin, _, angle in beats if begin < time_s)


def _mill(
    part: Part,
    centre: F64,
    radius: float,
    angle: float,
    beats: list[tuple[float, float, float]],
    span: tuple[float, float],
) -> None:
    """Step into the circle, turn with it, facing its centre."""
    at = angle + _turned(beats, span[0])
    part.go([centre + radius * unit(at)], 0.8)
    for begin, end, turn in beats:
        if begin < span[0] or begin >= span[1]:
            continue
        part.until(begin, at + np.pi)
        n = max(2, int(abs(turn) / 0.26))
        points = [centre + radius * unit(at + turn * i / n) for i in range(1, n + 1)]
        at += turn
        part.go(points, max(0.12, radius * abs(turn) / (end - begin)))
    if span[1] > part.time_s:
        part.until(span[1], at + np.pi)


def stand(stage: Stage, plan: Choreography) -> Iterator[Part]:
    """Stand at a place for a long time: shift, look around, scratch, bend."""
    for part in arriving(stage, plan):
        place = stage.spot(0.55)
        part.walk_to(place)
        fidget(part, plan.duration_s, ("stand", "stand", "reach", "bend"))
        part.leave()
        yield part


def fidget(part: Part, duration_s: float, actions: tuple[str, ...]) -> None:
    """Small movements on the spot, with pauses of 3 to 9 s."""
    rng, place, end = part.stage.rng, part.place, part.time_s + duration_s
    face = float(rng.uniform(-np.pi, np.pi))
    while part.time_s < end - 1:
        face += float(rng.uniform(-0.9, 0.9))
        action = str(rng.choice(actions))
        part.do(action, float(rng.uniform(3, 9) if action == "stand" else rng.uniform(0.8, 2.0)), face)
        if rng.random() < 0.4:
            part.go([place + rng.uniform(-0.09, 0.09, 2)], 0.3)


def postures(stage: Stage, plan: Choreography) -> Iterator[Part]:
    """Crouch, bend and reach, with short stands between."""
    for part in arriving(stage, plan):
        part.walk_to(stage.spot(0.6))
        for action in stage.rng.permutation(["crouch", "bend", "reach", "crouch"]):
            face = float(stage.rng.uniform(-np.pi, np.pi))
            part.do("stand", float(stage.rng.uniform(0.8, 2.0)), face)
            part.do(str(action), float(stage.rng.uniform(1.5, 4.0)), face)
        part.do("stand", 1.0)
        part.leave()
        yield part


def cartwheel(stage: Stage, plan: Choreography) -> Iterator[Part]:
    """Turn a cartwheel across the view, with a run-up, and one back."""
    for part in arriving(stage, plan):
        centre, way = stage.spot(1.3), unit(float(stage.rng.uniform(-0.5, 0.5)))
        ends = [centre - 1.0 * way, centre + 1.0 * way]
        part.walk_to(ends[0])
        part.do("stand", 1.0, float(np.arctan2(way[1], way[0])) - np.pi / 2)
        part.cartwheel(ends[1])
        part.do("stand", float(stage.rng.uniform(2, 4)))
        part.cartwheel(ends[0])
        part.do("stand", 2.0)
        part.leave()
        yield part


def pair(stage: Stage, plan: Choreography) -> list[Part]:
    """Two by two shoulder to shoulder in step, through the view and back."""
    parts = []
    for k in range(0, plan.people - 1, 2):
        side, doors = stage.side(), {wall: stage.door(wall) for wall in ("west", "east")}
        legs, last = _legs(stage, plan, begin_s(plan, k), side, {wall: doors[wall][1:] for wall in doors})
        shift = np.array([0.0, plan.spacing_m / 2])
        for offset in (shift, -shift):
            part = Part(stage, begin_s(plan, k), side, plan.speed_mps)
            part.start = part.place = doors[side][0] + offset
            part.steps, part.time_s = [], part.enter_s
            for leg in legs:
                part.go([p + offset for p in leg])
                part.do("stand", plan.away_s[0])
            part.go([doors[last][0] + offset])
            part.leaves = True
            parts.append(part)
    return parts


def _legs(
    stage: Stage, plan: Choreography, time_s: float, side: str, doors: dict[str, tuple[F64, F64]]
) -> tuple[list[list[F64]], str]:
    """Ways through the view, from behind an opening to behind one, until the time is over; and the last opening."""
    ((west, east),) = _lanes(stage, 1)
    legs: list[list[F64]] = []
    while time_s < plan.start_s + plan.duration_s:
        ends = _walked(stage, plan, [west, east] if side == "west" else [east, west])
        behind, inside = doors[side]
        side = "east" if ends[-1] is east else "west"
        legs.append([behind, inside, *ends, *doors[side][::-1]])
        time_s += sum(float(np.linalg.norm(b - a)) for a, b in itertools.pairwise(legs[-1])) / plan.speed_mps
    return legs, side


def come_back(stage: Stage, plan: Choreography) -> Iterator[Part]:
    """Leave the view and come back after a while, again and again."""
    for part in arriving(stage, plan):
        while True:
            place = stage.spot(0.4, reserve=False)
            part.walk_to(place)
            part.do("stand", float(stage.rng.uniform(1.0, 3.0)), float(stage.rng.uniform(-np.pi, np.pi)))
            if part.time_s > plan.start_s + plan.duration_s:
                break
            _out_of_view(part, float(stage.rng.uniform(*plan.away_s)))
        part.leave()
        yield part


def _out_of_view(part: Part, pause_s: float) -> None:
    """Towards the opening until 0.5 m out of view, and a pause there so that ``pause_s`` passes out of view."""
    stage, inside = part.stage, part.inside
    points = [part.place, *stage.route(part.place, inside), part.behind]
    dense = [a + (b - a) * s for a, b in itertools.pairwise(points) for s in np.linspace(0, 1, 12)]
    hidden = np.flatnonzero(~stage.in_view(np.array(dense)))
    if len(hidden) == 0:
        raise NoPlaceError("the opening is in view")
    turn = dense[min(int(hidden[0]) + 5, len(dense) - 1)]
    part.walk_to(turn)
    part.do("stand", max(0.3, pause_s - 1.0))


def wander(stage: Stage, plan: Choreography) -> list[Part]:
    """Random walks in the view that give way to all others."""
    x0, y0, x1, y1 = stage.rectangle()
    if (x1 - x0) * (y1 - y0) < 0.55 * plan.people:
        raise NoPlaceError("too little floor in view for the wanderers")
    parts = []
    for k in range(plan.people):
        part = Part(stage, begin_s(plan, k), ("west", "east")[k % 2], plan.speed_mps)
        speed = plan.speed_mps * float(stage.rng.uniform(0.8, 1.1))
        part.wander = {"area_m": (x0, y0, x1, y1), "speed_mps": (0.6 * speed, speed), "pause_s": (0.0, 3.0)}
        if k % 3 == 2:
            exits = [tuple(map(float, p)) for p in (part.inside, part.behind, part.hidden)]
            part.wander |= {"until_s": float(plan.start_s + plan.duration_s), "exit_m": exits}
        parts.append(part)
    return parts
