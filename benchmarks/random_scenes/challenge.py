"""Scenes of the challenge suite: a stereo pair on the wall or the ceiling, and people who do something together."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks.random_scenes import choreography as together
from benchmarks.random_scenes import things
from benchmarks.random_scenes.appearance import clothes, lights_and_sensor, looks
from benchmarks.random_scenes.choreography import Part, visit
from benchmarks.random_scenes.stage import Stage
from benchmarks.random_scenes.tables import Challenge, Choreography, NoPlaceError, Plot, RandomScene
from calib.types import F64
from planview.synthetic.motion import Obstacles, scripted_motion, wander
from planview.synthetic.scene import Scene

PLOTS: dict[Plot, Callable[[Stage, Choreography], Iterable[Part]]] = {
    "cross": together.cross, "meet": together.meet, "stand": visit(0.55, together.stand), "pair": together.pair,
    "return": together.come_back, "wander": together.wander, "cartwheel": visit(1.3, together.cartwheels),
    "postures": visit(0.6, together.postures), "sit": things.sit, "floor": visit(0.75, together.sit_on_floor),
    "chair": things.chair, "bag": things.bag, "book": things.book, "partition": things.partition,
}  # fmt: skip
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
    """How many times two people hide each other.

    Args:
        a, b: (N, 2) their places from the camera.
        both: (N,) whether both are in view.
    """
    far = np.maximum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1))
    hidden = both & (np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / far < HIDDEN_M)
    return int((hidden[1:] & ~hidden[:-1]).sum()) + int(hidden[0])


def refuse_too_near(places: Sequence[F64]) -> None:
    """Raises NoPlaceError: people walk through each other, by their places (N, 2) at the same times."""
    for i, j in itertools.combinations(range(len(places)), 2):
        if (np.linalg.norm(places[i] - places[j], axis=1) < APART_M).any():
            raise NoPlaceError(f"people {i + 1} and {j + 1} walk through each other")
