"""Other recordings of the same plot: new walks, another rig, other people, so that nothing is tuned to one clip."""

from __future__ import annotations

from typing import Any

import numpy as np

from planview.synthetic.persons import Person
from planview.synthetic.scene import Rig, Scene


def varied(scene: Scene, seed: int) -> Scene:
    """A scene with its random numbers and measures changed; seed 0 is the scene itself.

    Wanderers walk elsewhere, the noise differs, and the rig is up to 10 % off in focal length and baseline,
    20 cm in height and 4 degrees in tilt (a camera straight down stays so); people are up to 5 cm taller or shorter.
    """
    if seed == 0:
        return scene
    rng = np.random.default_rng([scene.seed, seed])
    people = tuple(_person(p, rng) for p in scene.people)
    update: dict[str, Any] = {"seed": scene.seed + 1000 * seed, "people": people}
    if scene.rig is not None:
        update["rig"] = _rig(scene.rig, scene.room.size_m[2], rng)
    return scene.model_copy(update=update)


def _rig(rig: Rig, room_height_m: float, rng: np.random.Generator) -> Rig:
    x, y, z = rig.at_m
    overhead = rig.tilt_deg < 5
    return rig.model_copy(
        update={
            "focal_px": rig.focal_px * float(rng.uniform(0.9, 1.1)),
            "baseline_m": rig.baseline_m * float(rng.uniform(0.9, 1.1)),
            "at_m": (x, y, float(np.clip(z + rng.uniform(-0.2, 0.2), 2.1, room_height_m - 0.1))),
            "tilt_deg": rig.tilt_deg + (0.0 if overhead else float(rng.uniform(-4, 4))),
        }
    )


def _person(person: Person, rng: np.random.Generator) -> Person:
    return person.model_copy(update={"height_m": float(np.clip(person.height_m + rng.uniform(-0.05, 0.05), 0.9, 2.2))})
