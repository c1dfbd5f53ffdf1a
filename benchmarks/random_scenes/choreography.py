"""What people of a challenge do together, written step by step with the time that it takes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from benchmarks.random_scenes.stage import Stage
from benchmarks.random_scenes.tables import Choreography, NoPlaceError
from calib.types import F64
from planview.synthetic.room import furniture_size
from planview.synthetic.scene import Furniture

GATE_M = 0.75
"""People who meet come to this distance from the circle before they step into it [m]."""


class Role:
    """Steps of one person, who comes through an opening.

    Attributes:
        time_s: when the steps so far are done.
        place: (2,) where the person then is.
    """

    def __init__(
        self, stage: Stage, enter_s: float, speed_mps: float, side: str | None = None, *, waits: bool = False
    ) -> None:
        """A person who comes in, or with ``waits`` stays out of view until the first step."""
        self.stage, self.enter_s, self.speed_mps = stage, enter_s, speed_mps
        self.side = side or stage.side()
        self.hidden, self.behind, self.inside = stage.door(self.side)
        self.start, self.place, self.time_s = self.hidden, self.hidden, enter_s
        self.steps: list[dict[str, Any]] = []
        self.wander: dict[str, Any] | None = None
        self.leaves = False
        if not waits:
            self.go([self.behind, self.inside])

    @property
    def rng(self) -> np.random.Generator:
        return self.stage.rng

    def go(self, points: list[F64], speed_mps: float | None = None, **values: Any) -> None:
        """Straight through points."""
        speed = speed_mps or self.speed_mps
        self.steps.append({"go": [_pair(p) for p in points], "speed_mps": float(speed), **values})
        for point in points:
            self.time_s += float(np.linalg.norm(point - self.place)) / speed
            self.place = np.asarray(point, np.float64)

    def walk_to(self, point: F64) -> None:
        """Around obstacles to a point."""
        self.go(self.stage.floor.route(self.place, point))

    def leave(self, side: str | None = None) -> None:
        """Walk out of an opening (the person's own when none is named) and be gone."""
        if side is not None and side != self.side:
            self.hidden, self.behind, self.inside = self.stage.door(side)
        self.walk_to(self.inside)
        self.go([self.behind, self.hidden])
        self.leaves = True

    def take_away(self, item: str, via: F64) -> None:
        """Carry a thing out of the room, first to a point."""
        self.go([via, *self.stage.floor.route(via, self.inside), self.behind, self.hidden], carry=item)
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
        ahead = unit(np.deg2rad(seat.heading_deg))
        self.walk_to(np.array(seat.at_m) + max(0.8, furniture_size(seat)[0] / 2 + 0.4) * ahead)
        self.steps.append({"sit_s": float(seconds), "on": seat.name})
        self.time_s += seconds + 2.0
        self.place = np.array(seat.at_m) + 0.32 * ahead

    def fidget(self, duration_s: float, actions: tuple[str, ...]) -> None:
        """Small movements on the spot, with pauses of 3 to 9 s."""
        place, end = self.place, self.time_s + duration_s
        face = self.any_direction()
        while self.time_s < end - 1:
            face += float(self.rng.uniform(-0.9, 0.9))
            action = str(self.rng.choice(actions))
            self.do(action, self.rng.uniform(3, 9) if action == "stand" else self.rng.uniform(0.8, 2.0), face)
            if self.rng.random() < 0.4:
                self.go([place + self.rng.uniform(-0.09, 0.09, 2)], 0.3)

    def any_direction(self) -> float:
        """A random direction [rad]."""
        return float(self.rng.uniform(-np.pi, np.pi))

    def to_table(self) -> dict[str, Any]:
        """Movement of the person, as a table of ``[[people]]``."""
        table: dict[str, Any] = {
            "start_m": _pair(self.start),
            "enter_s": float(self.enter_s),
            "face_deg": float(np.rad2deg(direction(self.behind, self.inside))),
            "steps": self.steps,
            "leaves": self.leaves,
        }
        return table if self.wander is None else table | {"wander": self.wander}


def _pair(point: F64) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def unit(angle: float) -> F64:
    return np.array([np.cos(angle), np.sin(angle)])


def direction(a: F64, b: F64) -> float:
    """From one point to another [rad]."""
    return float(np.arctan2(b[1] - a[1], b[0] - a[0]))


def arriving(stage: Stage, plan: Choreography) -> Iterator[Role]:
    """The people of a plan; what one of them does is decided before the next one comes."""
    for k in range(plan.people):
        yield Role(stage, plan.begin_s(k), plan.speed_mps)


def visit(
    radius_m: float, act: Callable[[Role, Choreography], None]
) -> Callable[[Stage, Choreography], Iterable[Role]]:
    """A plot in which each person comes to a place of their own, does something there and leaves."""

    def plot(stage: Stage, plan: Choreography) -> Iterator[Role]:
        for part in arriving(stage, plan):
            part.walk_to(stage.spot(radius_m))
            act(part, plan)
            part.leave()
            yield part

    return plot


def stand(part: Role, plan: Choreography) -> None:
    """Stand for a long time: shift, look around, scratch, bend."""
    part.fidget(plan.duration_s, ("stand", "stand", "reach", "bend"))


def postures(part: Role, plan: Choreography) -> None:
    """Crouch, bend and reach, with short stands between."""
    for action in part.rng.permutation(["crouch", "bend", "reach", "crouch"]):
        face = part.any_direction()
        part.do("stand", float(part.rng.uniform(0.8, 2.0)), face)
        part.do(str(action), float(part.rng.uniform(1.5, 4.0)), face)
    part.do("stand", 1.0)


def sit_on_floor(part: Role, plan: Choreography) -> None:
    """Sit on the floor, facing the camera's side."""
    face = direction(part.place, part.stage.camera_xy) + float(part.rng.uniform(-1.5, 1.5))
    for action, seconds in (("stand", 1.0), ("sit", plan.duration_s), ("stand", 1.5)):
        part.do(action, seconds, face)


def cross(stage: Stage, plan: Choreography) -> Iterator[Role]:
    """Walk through the view from opening to opening and back until the time is over, each in a lane of its own."""
    for k, lane in enumerate(_lanes(stage, plan.people)):
        side = stage.side()
        part = Role(stage, plan.begin_s(k), plan.speed_mps * float(stage.rng.uniform(0.9, 1.1)), side)
        while True:
            ends, side = _walked(stage, plan, lane, side)
            part.walk_to(ends[0])
            part.go(ends[1:])
            if part.time_s > plan.end_s:
                break
            pause_s, (_, behind, inside) = float(stage.rng.uniform(*plan.away_s)), stage.door(side)
            part.walk_to(inside)
            part.go([behind])
            part.do("stand", pause_s)
            part.go([inside])
        part.leave(side)
        yield part


def _lanes(stage: Stage, n: int) -> list[dict[str, F64]]:
    """West and east ends of n lanes across the view, at least 0.6 m apart, in random order."""
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
        lanes.append({"west": np.array([row.min(), y]), "east": np.array([row.max(), y])})
    return [lanes[k] for k in stage.rng.permutation(n)]


def _walked(stage: Stage, plan: Choreography, lane: dict[str, F64], side: str) -> tuple[list[F64], str]:
    """The ends of a lane in the order in which they are reached from a side, with turns in view where the plan has
    some, and the last side."""
    other = "east" if side == "west" else "west"
    turns = int(stage.rng.integers(1, plan.turns + 1)) if plan.turns else 0
    # People who turn in view do so at this distance from the end of their lane, with the whole body in the image [m].
    inward = 0.35 * (lane[other] - lane[side]) / np.linalg.norm(lane[other] - lane[side])
    inside = [lane[side] + inward, lane[other] - inward]
    last = side if turns % 2 else other
    return [lane[side], *(inside[k % 2] for k in range(1, turns + 1)), lane[last]], last


def pair(stage: Stage, plan: Choreography) -> Iterator[Role]:
    """Two by two shoulder to shoulder in step, through the view and back."""
    for k in range(0, plan.people - 1, 2):
        first = side = stage.side()
        doors, (lane,) = {wall: stage.door(wall) for wall in ("west", "east")}, _lanes(stage, 1)
        legs, time_s = [], plan.begin_s(k)
        while time_s < plan.end_s:
            _, behind, inside = doors[side]
            ends, side = _walked(stage, plan, lane, side)
            legs.append([behind, inside, *ends, *doors[side][:0:-1]])
            time_s += sum(float(np.linalg.norm(b - a)) for a, b in itertools.pairwise(legs[-1])) / plan.speed_mps
        for offset in (np.array([0.0, plan.spacing_m / 2]), np.array([0.0, -plan.spacing_m / 2])):
            part = Role(stage, plan.begin_s(k), plan.speed_mps, first, waits=True)
            part.start = part.place = doors[first][0] + offset
            for leg in legs:
                part.go([p + offset for p in leg])
                part.do("stand", plan.away_s[0])
            part.go([doors[side][0] + offset])
            part.leaves = True
            yield part


def meet(stage: Stage, plan: Choreography) -> list[Role]:
    """Come together on a circle, move around each other, part; joiners come later and go earlier."""
    n = plan.people
    radius = plan.spacing_m / (2 * np.sin(np.pi / max(n, 2)))
    centre = stage.spot(radius + GATE_M + 0.15)
    angles = stage.rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(n) / n
    parts = [Role(stage, plan.begin_s(k), plan.speed_mps) for k in range(n)]
    early = n - plan.joiners
    for part, angle in zip(parts[:early], angles, strict=False):
        part.walk_to(centre + (radius + GATE_M) * unit(angle))
    together = max(p.time_s for p in parts[:early]) + 0.3
    beats, moments = _beats(stage, plan, together)
    joining, parting = moments[len(moments) // 3], moments[2 * len(moments) // 3]
    for k, (part, angle) in enumerate(zip(parts, angles, strict=True)):
        late = k >= early
        if late:
            part.walk_to(centre + (radius + GATE_M) * unit(angle + _turned(beats, joining)))
        part.until(joining if late else together)
        _mill(part, centre, radius, angle, beats, (joining, parting) if late else (together, moments[-1] + 1))
        end = angle + _turned(beats, part.time_s + 0.01)
        part.do("stand", 0.2 + (0.0 if late else 1.2 * k))
        part.go([centre + (radius + GATE_M) * unit(end)])
        part.leave()
    return parts


Beat = tuple[float, float, float]
"""Begin [s], end [s] and angle of a turn of the whole circle."""


def _beats(stage: Stage, plan: Choreography, start_s: float) -> tuple[list[Beat], list[float]]:
    """Turns of the whole circle, and the times between them, in which others step in and out."""
    beats, moments, t = [], [start_s], start_s + 1.5
    while t < start_s + plan.duration_s:
        moments.append(t)
        t += 1.4
        angle = float(stage.rng.choice((-1, 1)) * stage.rng.uniform(0.8, 3.3))
        length = abs(angle) * float(stage.rng.uniform(0.9, 1.6))
        beats.append((t, t + length, angle))
        t += length + float(stage.rng.uniform(0.3, 1.2))
    return beats, [*moments, t]


def _turned(beats: list[Beat], time_s: float) -> float:
    return sum(angle for begin, _, angle in beats if begin < time_s)


def _mill(part: Role, centre: F64, radius: float, angle: float, beats: list[Beat], span: tuple[float, float]) -> None:
    """Step into the circle, turn with it, facing its centre."""
    at = angle + _turned(beats, span[0])
    part.go([centre + radius * unit(at)], 0.8)
    for begin, end, turn in beats:
        if span[0] <= begin < span[1]:
            part.until(begin, at + np.pi)
            n = max(2, int(abs(turn) / 0.26))
            points = [centre + radius * unit(at + turn * i / n) for i in range(1, n + 1)]
            at += turn
            part.go(points, max(0.12, radius * abs(turn) / (end - begin)))
    if span[1] > part.time_s:
        part.until(span[1], at + np.pi)


def come_back(stage: Stage, plan: Choreography) -> Iterator[Role]:
    """Leave the view and come back after a while, again and again."""
    for part in arriving(stage, plan):
        while True:
            part.walk_to(stage.spot(0.4, reserve=False))
            part.do("stand", float(stage.rng.uniform(1.0, 3.0)), part.any_direction())
            if part.time_s > plan.end_s:
                break
            _out_of_view(part, float(stage.rng.uniform(*plan.away_s)))
        part.leave()
        yield part


def _out_of_view(part: Role, pause_s: float) -> None:
    """Towards the opening until 0.5 m out of view, and a pause there so that ``pause_s`` passes out of view."""
    points = [part.place, *part.stage.floor.route(part.place, part.inside), part.behind]
    dense = [a + (b - a) * s for a, b in itertools.pairwise(points) for s in np.linspace(0, 1, 12)]
    hidden = np.flatnonzero(~part.stage.in_view(np.array(dense)))
    if len(hidden) == 0:
        raise NoPlaceError("the opening is in view")
    part.walk_to(dense[min(int(hidden[0]) + 5, len(dense) - 1)])
    part.do("stand", max(0.3, pause_s - 1.0))


def wander(stage: Stage, plan: Choreography) -> Iterator[Role]:
    """Random walks in the view that give way to all others."""
    x0, y0, x1, y1 = stage.rectangle()
    if (x1 - x0) * (y1 - y0) < 0.55 * plan.people:
        raise NoPlaceError("too little floor in view for the wanderers")
    for k in range(plan.people):
        part = Role(stage, plan.begin_s(k), plan.speed_mps, ("west", "east")[k % 2])
        speed = plan.speed_mps * float(stage.rng.uniform(0.8, 1.1))
        part.wander = {"area_m": (x0, y0, x1, y1), "speed_mps": (0.6 * speed, speed), "pause_s": (0.0, 3.0)}
        if k % 3 == 2:
            exits = [_pair(p) for p in (part.inside, part.behind, part.hidden)]
            part.wander |= {"until_s": plan.end_s, "exit_m": exits}
        yield part
