"""Scenes with ranges: a seed draws room, rig, lens, light, people and ways, so that every seed is another recording.

``{ min = 2.1, max = 3.2 }`` is a number of that range (a whole one between whole bounds), ``{ choose = [1, 2] }``
one of the list; everything else is taken as it is.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from calib.errors import WorkError
from planview.synthetic import choreography as together
from planview.synthetic import choreography_props as props
from planview.synthetic.challenge import Challenge, Choreography, Kind
from planview.synthetic.illumination import drawn_light
from planview.synthetic.parts import Part
from planview.synthetic.plausible import implausible
from planview.synthetic.scene import Scene
from planview.synthetic.stage import NoPlaceError, Stage
from planview.synthetic.wardrobe import clothes, looks

ATTEMPTS = 60
"""Draws in which people would walk through each other, or do not fit into the view, are drawn again."""

CHOREOGRAPHIES: dict[Kind, Callable[[Stage, Choreography], list[Part]]] = {
    "cross": together.cross, "meet": together.meet, "stand": together.stand, "pair": together.pair,
    "return": together.come_back, "wander": together.wander, "cartwheel": together.cartwheel,
    "postures": together.postures, "sit": props.sit, "floor": props.floor, "chair": props.chair,
    "bag": props.bag, "book": props.book, "partition": props.partition,
}  # fmt: skip


def draw(table: Mapping[str, Any], seed: int, name: str) -> Scene:
    """The scene of a seed; the same table, seed and name give the same scene.

    Args:
        table: a challenge (``planview.synthetic.challenge``) with ranges in it.
        seed: any non-negative integer.
        name: of the scene; the same seed draws independently in every scene.
    Raises:
        pydantic.ValidationError: the table is no challenge.
        WorkError: no draw fits; the ranges ask for too much.
    """
    reason = ""
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, zlib.crc32(name.encode()), attempt])
        challenge = Challenge.model_validate(resolved(table, rng))
        try:
            stage = Stage(challenge, rng)
            scene = _composed(stage, seed)
        except NoPlaceError as error:
            reason = str(error)
            continue
        reason = implausible(scene, stage)
        if not reason:
            return scene
    raise WorkError(f"{name}, seed {seed}: no draw of {ATTEMPTS} fits into its room: {reason}")


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


def _composed(stage: Stage, seed: int) -> Scene:
    challenge, rng = stage.challenge, stage.rng
    parts = [part for plan in challenge.choreography for part in CHOREOGRAPHIES[plan.kind](stage, plan)]
    lights, sensor = drawn_light(challenge, rng)
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
