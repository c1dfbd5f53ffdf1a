"""Random scenes of every kind: a seed decides room, cameras, light, people and ways."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

from benchmarks.random_scenes.challenge import challenge
from benchmarks.random_scenes.rooms import conference, two_rigs, view
from benchmarks.random_scenes.tables import NoPlaceError, RandomScene, resolved
from calib.errors import InputError, WorkError
from calib.io import load_toml
from calib.params import first_problem
from planview.synthetic.assets import SCENES

SUITE, VIEWS, LOADS = SCENES / "suite", SCENES / "views", SCENES / "loads"
SceneKind = Literal["suite", "views", "conference", "rigs"]
KINDS: dict[SceneKind, tuple[Path, Callable[[dict[str, Any], np.random.Generator], RandomScene]]] = {
    "suite": (SUITE, challenge),
    "views": (VIEWS, view),
    "conference": (SCENES / "single" / "conference.toml", conference),
    "rigs": (SCENES / "rigs" / "two.toml", two_rigs),
}
"""The committed table of a kind of scene, or the folder with its tables, and what makes a scene of a table."""
ATTEMPTS = 1000
"""Attempts in which people would walk through each other, or do not fit into the view, are repeated. Ways are random
without regard to when others pass, so the tightest scene, overhead, fits in one attempt of fifty: that all fail has
a probability of 2e-9."""


def random_scene(kind: SceneKind, seed: int, path: Path | None = None) -> RandomScene:
    """The scene of a seed; the same table and seed give the same scene.

    Args:
        seed: any non-negative integer.
        path: one of the tables of the kind; not needed where it has only one.
    Raises:
        InputError: unreadable, no table of the kind, or a value out of its range.
        WorkError: no attempt fits; the ranges ask for too much.
    """
    path = path or KINDS[kind][0]
    try:
        return scene_of_table(kind, load_toml(path, "a random scene in TOML"), seed, path.stem)
    except ValidationError as error:
        raise InputError(f"{path}: {first_problem(error)}") from error


def scene_of_table(kind: SceneKind, table: Mapping[str, Any], seed: int, name: str) -> RandomScene:
    """As ``random_scene``; a seed gives other values under every name. Raises pydantic.ValidationError: no table of the
    kind."""
    reason = ""
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, zlib.crc32(name.encode()), attempt])
        try:
            return KINDS[kind][1](resolved(table, rng), rng)
        except NoPlaceError as error:
            reason = str(error)
    raise WorkError(f"{name}, seed {seed}: none of {ATTEMPTS} attempts fits into its room: {reason}")
