"""Random scenes from tables with ranges: a seed decides room, rig, lens, light, people and ways.

``{ min = 2.1, max = 3.2 }`` is a number of that range (a whole one between whole bounds), ``{ choose = [1, 2] }``
one of the list; everything else is taken as it is.
"""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.random_scenes import choreography as together
from benchmarks.random_scenes import things
from benchmarks.random_scenes.challenge import Challenge, Choreography, Kind, clothes, looks, random_light
from benchmarks.random_scenes.choreography import Part
from benchmarks.random_scenes.stage import NoPlaceError, Stage
from calib.errors import WorkError
from calib.types import F64
from planview.synthetic.motion import Obstacles, scripted_motion, wander
from planview.synthetic.scene import Scene

ATTEMPTS = 1000
"""Attempts in which people would walk through each other, or do not fit into the view, are repeated. Ways are random
without regard to when others pass, so the tightest scene, overhead, fits in one attempt of fifty: that all fail has
a probability of 2e-9."""

CHOREOGRAPHIES: dict[Kind, Callable[[Stage, Choreography], Iterable[Part]]] = {
    "cross": together.cross, "meet": together.meet, "stand": together.stand, "pair": together.pair,
    "return": together.come_back, "wander": together.wander, "cartwheel": together.cartwheel,
    "postures": together.postures, "sit": things.sit, "floor": things.floor, "chair": things.chair,
    "bag": things.bag, "book": things.book, "partition": things.partition,
}  # fmt: skip


def implausible(scene: Scene, stage: Stage) -> str:
    """Why a scene cannot be, or shows too little of what its challenge covers; empty when it is good."""
    furniture = {f.name: f for f in scene.furniture if f.name}
    scripted = [scripted_motion(p, furniture, scene.duration_s) for p in scene.people]
    times = np.arange(0.0, scene.duration_s, 0.1)
    fixed = [m.places(times) for m, person in zip(scripted, scene.people, strict=True) if not person.wander]
    if reason := too_near(fixed):  # before the slow part: those who wander give way to these
        return reason
    places = [m.places(times) for m in wander(scene, scripted)]
    if reason := too_near(places):
        return reason
    # Things are put down and taken within the recording.
    for i, (person, motion) in enumerate(zip(scene.people, scripted, strict=True)):
        handles = any(s.carry or s.push for s in person.steps)
        # People who carry or push things are on their way out at the end, at most so long from the end of
        # their steps [s].
        if handles and motion.script_end_s > scene.duration_s + 4.0:
            return f"person {i + 1} is not done with a thing at the end"
    # Seats and handled things are meant to be near.
    touched = {s.on or s.push or s.carry for p in scene.people for s in p.steps}
    obstacles = Obstacles(scene.room, [f for f in scene.furniture if f.name not in touched])
    for i, place in enumerate(places):
        known = place[np.isfinite(place[:, 0])]
        if len(known) and obstacles.distance(known).min() < 0.2:
            return f"person {i + 1} walks through a wall or furniture"
    in_view = np.array([stage.in_view(np.nan_to_num(p, nan=-1e3)) for p in places])
    # Smallest share of the frames with a person in view.
    if in_view.any(axis=0).mean() < 0.5:
        return "no person is in view for half of the time"
    if not in_view.any(axis=1).all():
        return f"person {int(np.argmin(in_view.any(axis=1))) + 1} is never in view"
    if "occlusion by people" not in stage.challenge.covers:
        return ""
    n = 0
    for i, j in itertools.combinations(range(len(places)), 2):
        both = in_view[i] & in_view[j]
        a, b = places[j][both] - stage.camera_xy, places[i][both] - stage.camera_xy
        far = np.maximum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1))
        hidden = np.zeros(len(both), np.bool_)
        # A person is hidden whose axis is so near to the line of sight to another one's: half a shoulder width [m].
        hidden[both] = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / far < 0.25
        n += int((hidden[1:] & ~hidden[:-1]).sum()) + int(hidden[0])
    # Least number of times that people hide each other where a challenge covers occlusion by people.
    return "" if n >= 3 else f"people hide each other {n} times only"


def too_near(places: Sequence[F64]) -> str:
    """Which people walk through each other, by their places (N, 2) at the same times; empty when none do."""
    for i, j in itertools.combinations(range(len(places)), 2):
        # Smallest distance between two body axes: shoulders turned, touching [m].
        if (np.linalg.norm(places[i] - places[j], axis=1) < 0.38).any():
            return f"people {i + 1} and {j + 1} walk through each other"
    return ""


def random_scene(table: Mapping[str, Any], seed: int, name: str) -> Scene:
    """The scene of a seed; the same table, seed and name give the same scene.

    Args:
        table: a challenge (``benchmarks.random_scenes.challenge``) with ranges in it.
        seed: any non-negative integer.
        name: of the scene; a seed gives other values in every scene.
    Raises:
        pydantic.ValidationError: the table is no challenge.
        WorkError: no attempt fits; the ranges ask for too much.
    """
    reason = ""
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, zlib.crc32(name.encode()), attempt])
        challenge = Challenge.model_validate(resolved(table, rng))
        try:
            stage = Stage(challenge, rng)
            scene = _composed(stage)
        except NoPlaceError as error:
            reason = str(error)
            continue
        reason = implausible(scene, stage)
        if not reason:
            return scene
    raise WorkError(f"{name}, seed {seed}: none of {ATTEMPTS} attempts fits into its room: {reason}")


def resolved(value: Any, rng: np.random.Generator) -> Any:
    """A table with a number for each range and one entry for each choice."""
    if isinstance(value, Mapping):
        if set(value) == {"min", "max"}:
            low, high = value["min"], value["max"]
            whole = isinstance(low, int) and isinstance(high, int)
            return int(rng.integers(low, high + 1)) if whole else float(rng.uniform(low, high))
        if set(value) == {"choose"}:
            return resolved(value["choose"][int(rng.integers(len(value["choose"])))], rng)
        return {key: resolved(value[key], rng) for key in value}
    if isinstance(value, list):
        return [resolved(item, rng) for item in value]
    return value


def _composed(stage: Stage) -> Scene:
    challenge, rng = stage.challenge, stage.rng
    parts = [part for plan in challenge.choreography for part in CHOREOGRAPHIES[plan.kind](stage, plan)]
    lights, sensor = random_light(challenge, rng)
    return Scene.model_validate(
        {
            "description": challenge.description,
            "seed": int(rng.integers(1 << 31)),
            "fps": challenge.fps,
            "duration_s": challenge.duration_s,
            "room": stage.room,
            "rig": stage.rig,
            "sensor": sensor,
            "lights": lights,
            "furniture": tuple(stage.furniture),
            "people": [p | t.to_table() for p, t in zip(_people(challenge, len(parts), rng), parts, strict=True)],
        }
    )


def _people(challenge: Challenge, n: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Looks of n people, children among them."""
    children = set(rng.permutation(n)[: challenge.children].tolist())
    shared = clothes(rng)
    pairs = {i for plan in challenge.choreography if plan.kind == "pair" for i in range(n)}
    people, tall = [], float(rng.uniform(*challenge.people_m))
    for i in range(n):
        if i not in pairs or i % 2 == 0:
            tall = float(rng.uniform(1.0, 1.2) if i in children else rng.uniform(*challenge.people_m))
        people.append(looks(rng, tall) | (shared if challenge.clothes == "similar" else clothes(rng)))
    return people
