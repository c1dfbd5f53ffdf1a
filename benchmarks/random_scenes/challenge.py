"""Scenes of the challenge suite: a stereo pair on the wall or the ceiling, and people who do something together."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from benchmarks.random_scenes import choreography as together
from benchmarks.random_scenes.choreography import Role, arriving, direction, unit, visit
from benchmarks.random_scenes.stage import Stage, clothes, lights_and_sensor, looks
from benchmarks.random_scenes.tables import Challenge, Choreography, NoPlaceError, Plot, RandomScene
from calib.types import F64
from planview.synthetic.motion import scripted_motion, wander
from planview.synthetic.people import PUSH_M, PUT_M
from planview.synthetic.room import Obstacles
from planview.synthetic.scene import Furniture, Scene

APART_M = 0.38
"""Smallest distance between two body axes: shoulders turned, touching."""
HIDDEN_M = 0.25
"""A person is hidden whose axis is this near to the line of sight to another one's: half a shoulder width."""


def challenge(table: dict[str, Any], rng: np.random.Generator) -> RandomScene:
    """One attempt at a scene. Raises NoPlaceError: it cannot be, or shows too little of what it covers."""
    values = Challenge.model_validate(table)
    stage = Stage(values, rng)
    parts = [part for plan in values.choreography for part in PLOTS[plan.kind](stage, plan)]
    lights, sensor = lights_and_sensor(values.light, stage.room.size_m, values.duration_s, rng)
    people = _people(values, len(parts), rng)
    scene = Scene.model_validate(
        {
            "description": values.description,
            "seed": int(rng.integers(1 << 31)),
            "fps": values.fps,
            "duration_s": values.duration_s,
            "room": stage.room,
            "rig": stage.rig,
            "sensor": sensor | {"grey": values.camera.grey},
            "lights": lights,
            "furniture": tuple(stage.furniture),
            "people": [person | part.to_table() for person, part in zip(people, parts, strict=True)],
        }
    )
    refuse_implausible(scene, stage)
    return RandomScene(scene)


def _people(values: Challenge, n: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Looks of n people, children among them; those who walk as a pair are equally tall."""
    children = set(rng.permutation(n)[: values.children].tolist())
    shared, in_pairs = clothes(rng), any(plan.kind == "pair" for plan in values.choreography)
    people, tall = [], 0.0
    for i in range(n):
        if not in_pairs or i % 2 == 0:
            tall = float(rng.uniform(1.0, 1.2) if i in children else rng.uniform(*values.people_m))
        people.append(looks(rng, tall) | (shared if values.clothes == "similar" else clothes(rng)))
    return people


def refuse_implausible(scene: Scene, stage: Stage) -> None:
    """Raises NoPlaceError: people walk through each other or things, or are mostly out of view, a thing is not taken in
    time, or people hide each other fewer than three times where the challenge covers that."""
    furniture = {f.name: f for f in scene.furniture if f.name}
    scripted = [scripted_motion(p, furniture, scene.duration_s) for p in scene.people]
    times = np.arange(0.0, scene.duration_s, 0.1)
    # Before the slow part: those who wander give way to the others.
    refuse_too_near([m.places(times) for m, p in zip(scripted, scene.people, strict=True) if not p.wander])
    places = [m.places(times) for m in wander(scene, scripted)]
    refuse_too_near(places)
    for i, (person, motion) in enumerate(zip(scene.people, scripted, strict=True), 1):
        # People who carry or push things are on their way out at the end, at most so long from it [s].
        if person.things and motion.script_end_s > scene.duration_s + 4.0:
            raise NoPlaceError(f"person {i} is not done with a thing at the end")
    touched = {name for p in scene.people for name in (*p.things, *p.seats)}
    obstacles = Obstacles(scene.room, [f for f in scene.furniture if f.name not in touched])
    for i, place in enumerate(places, 1):
        known = place[np.isfinite(place[:, 0])]
        if len(known) and obstacles.distance(known).min() < 0.2:
            raise NoPlaceError(f"person {i} walks through a wall or furniture")
    in_view = np.array([stage.in_view(np.nan_to_num(p, nan=-1e3)) for p in places])
    if in_view.any(axis=0).mean() < 0.5:
        raise NoPlaceError("no person is in view for half of the time")
    if not in_view.any(axis=1).all():
        raise NoPlaceError(f"person {int(np.argmin(in_view.any(axis=1))) + 1} is never in view")
    if "occlusion by people" in stage.challenge.covers:
        n = sum(
            _occlusions(places[i] - stage.camera_xy, places[j] - stage.camera_xy, in_view[i] & in_view[j])
            for i, j in itertools.combinations(range(len(places)), 2)
        )
        if n < 3:
            raise NoPlaceError(f"people hide each other {n} times only")


def _occlusions(a: F64, b: F64, both: F64) -> int:
    """How many times two people hide each other, by (N, 2) places from the camera and whether both are in view (N,)."""
    far = np.maximum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1))
    hidden = both & (np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / far < HIDDEN_M)
    return int((hidden[1:] & ~hidden[:-1]).sum()) + int(hidden[0])


def refuse_too_near(places: Sequence[F64]) -> None:
    """Raises NoPlaceError: people walk through each other, by their places (N, 2) at the same times."""
    for i, j in itertools.combinations(range(len(places)), 2):
        if (np.linalg.norm(places[i] - places[j], axis=1) < APART_M).any():
            raise NoPlaceError(f"people {i + 1} and {j + 1} walk through each other")


OUT_OF_SCENE_M = (0.0, -60.0)
"""Where things wait that a person brings along: outside of everything."""
COLOURS = ("#703838", "#2c4a70", "#386048", "#3a3a40", "#8a6a30", "#5a4a7a")


def _put(stage: Stage, kind: str, at: F64 | tuple[float, float], scale_m: float = 0.05, **values: Any) -> Furniture:
    """A thing with a name and a random colour."""
    surface = {"colour": str(stage.rng.choice(COLOURS)), "scale_m": scale_m, "contrast": 0.3}
    name = f"{kind} {len(stage.furniture) + 1}"
    return stage.put(kind=kind, name=name, at_m=tuple(at), surface=surface, **values)


def sit(stage: Stage, plan: Choreography) -> Iterator[Role]:
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


def chair(stage: Stage, plan: Choreography) -> Iterator[Role]:
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
        part = Role(stage, max(plan.begin_s(k), ready - 4), plan.speed_mps)
        part.walk_to(here - PUSH_M * unit(face))
        part.until(max(part.time_s + 1.0, ready), face)
        part.go([there - PUSH_M * unit(face)], 0.8, push=item.name)
        ready = part.time_s + 1.0
        part.do("stand", 1.0, face)
        part.go([there - (PUSH_M + 0.4) * unit(face)])
        part.leave()
        yield part
        here = there


def bag(stage: Stage, plan: Choreography) -> Iterator[Role]:
    """One person brings a bag or a box and leaves it on the floor; another takes it away."""
    place, kind = stage.spot(0.9), str(stage.rng.choice(("bag", "box")))
    item = _put(stage, kind, OUT_OF_SCENE_M, size_m=(0.3, 0.4, float(stage.rng.uniform(0.3, 0.55))))
    bringer = Role(stage, plan.begin_s(0), plan.speed_mps, waits=True)
    way = [bringer.behind, bringer.inside, *stage.floor.route(bringer.inside, place)]
    bringer.go(way, carry=item.name)
    put = place + PUT_M * unit(direction(way[-2], way[-1]))
    bringer.do("bend", 1.2)
    bringer.leave()
    yield bringer
    taker = Role(stage, max(plan.begin_s(1), bringer.time_s + plan.duration_s - 6), plan.speed_mps)
    taker.walk_to(put + 0.95 * unit(direction(put, taker.place)))
    taker.do("bend", 1.5, direction(taker.place, put))
    taker.take_away(item.name, taker.place)
    yield taker


def book(stage: Stage, plan: Choreography) -> Iterator[Role]:
    """One person puts a book on a shelf at eye level, another takes it."""
    spots = stage.spots(0.3)
    far = spots[spots[:, 1] > np.quantile(spots[:, 1], 0.7)]
    x = float(stage.rng.choice(far)[0])
    shelf_y = min(stage.room.size_m[1] - 0.2, float(far[:, 1].max()) + 0.55)
    stage.put(kind="shelf", at_m=(x, shelf_y), heading_deg=-90.0)
    item = _put(stage, "box", OUT_OF_SCENE_M, 0.08, size_m=(0.22, 0.07, 0.3))
    at = np.array([x, shelf_y - 0.2 - PUT_M])
    before = at - np.array([0.0, 0.45])
    bringer = Role(stage, plan.begin_s(0), plan.speed_mps, waits=True)
    way = [bringer.behind, bringer.inside, *stage.floor.route(bringer.inside, before), at]
    bringer.go(way, carry=item.name, put_z_m=float(stage.rng.uniform(1.4, 1.65)))
    bringer.do("reach", 1.5, np.pi / 2)
    bringer.go([before])
    bringer.leave()
    yield bringer
    taker = Role(stage, max(plan.begin_s(1), bringer.time_s + plan.duration_s - 8), plan.speed_mps)
    taker.walk_to(before)
    taker.go([at])
    taker.do("reach", 1.5, np.pi / 2)
    taker.take_away(item.name, before)
    yield taker


def partition(stage: Stage, plan: Choreography) -> Iterator[Role]:
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


PLOTS: dict[Plot, Callable[[Stage, Choreography], Iterable[Role]]] = {
    "cross": together.cross, "meet": together.meet, "stand": visit(0.55, together.stand), "pair": together.pair,
    "return": together.come_back, "wander": together.wander,
    "postures": visit(0.6, together.postures), "sit": sit, "floor": visit(0.75, together.sit_on_floor),
    "chair": chair, "bag": bag, "book": book, "partition": partition,
}  # fmt: skip
