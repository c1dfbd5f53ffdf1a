"""Foreground of one camera compared with OpenCV's MOG2 and KNN, on random views with exact masks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from cyclopts import Parameter
from pandas import DataFrame

from benchmarks.options import BenchOptions, Rendering, progress, rendered, report, scene_files
from benchmarks.random_scenes.generator import VIEWS, random_scene
from calib.errors import InputError
from calib.types import I32, I64, Bool
from planview.engine.config import Config
from planview.engine.open import open_engine
from planview.synthetic.render import SceneRenderer

CONDITIONS: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    "as is": {},
    "dark, noisy": {"light": {"brightness": 0.02, "full_well_e": 800.0}},
    "motion blur": {"capture": {"shutter_s": 0.08}},
    "automatic exposure, white balance": {"capture": {"auto_exposure": 0.9, "auto_white_balance": 0.6}},
    "lamp dimmed": {"light": {"changes": 1}},
    "compressed": {"capture": {"jpeg_quality": 25}},
    "polished floor": {"room": {"gloss": 0.25}},
    "thing moved": {"room": {"moved": True}},
    "clothes like the wall": {"room": {"grey_clothes": 1.0}},
}
"""Values that replace those of the seed, by condition."""


def pixel_counts(found: Bool, owner: I32) -> I64:
    """(4,) of a mask (H, W): people's pixels missed, people's pixels, the room's found, the room's, by whose pixels
    (H, W) they are; those of moving things do not count."""
    people, room = owner > 0, owner == 0
    return np.array([(people & ~found).sum(), people.sum(), (room & found).sum(), room.sum()], np.int64)


def score_foreground(
    path: Path, seed: int, condition: str, rendering: Rendering, config: Config
) -> dict[str, dict[str, float]]:
    """Rows by method: the engine's own foreground (with the ellipse-particle tracker's feedback), MOG2 and KNN on one
    condition.

    OpenCV's own have their defaults, a median of 3x3 pixels as the engine's has, and shadows removed.
    """
    scene, name = random_scene("views", seed, path, CONDITIONS[condition]).scene, path.stem
    recording = rendered(scene, f"view-{name}-{seed}", rendering)
    progress(f"{name} of seed {seed}, {condition}")
    engine = open_engine(recording, "ellipse-particle", config)
    others = {"MOG2": cv2.createBackgroundSubtractorMOG2(), "KNN": cv2.createBackgroundSubtractorKNN()}
    counts = {method: np.zeros(4, np.int64) for method in ("planview", *others)}
    renderer = SceneRenderer(scene)
    for result in engine:
        image, own = result.observation.image, result.observation.foreground
        assert image is not None and own is not None  # a single camera gives both
        found = {method: cv2.medianBlur(other.apply(image), 3) for method, other in others.items()}
        found["planview"] = cv2.resize(own, image.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        # Backgrounds are learned before anything counts [s].
        if result.timestamp_s >= 3.0:
            owner = renderer.owner(result.frame)
            for method, mask in found.items():
                counts[method] += pixel_counts(np.asarray(mask == 255), owner)
    return {method: shares(count) for method, count in counts.items()}


def shares(counts: I64) -> dict[str, float]:
    """Wrong pixels, people's pixels missed, and the room's that are foreground [%], from (4,) ``pixel_counts``."""
    missed, people, false, room = map(int, counts)
    wrong = 100 * (missed + false) / max(1, people + room)
    return {"wrong": wrong, "missed": 100 * missed / max(1, people), "false": 100 * false / max(1, room)}


@Parameter(name="*")
@dataclass(frozen=True)
class ForegroundOptions(BenchOptions):
    """Which views are rendered, and how much of them."""

    scene: Annotated[Sequence[str], Parameter(negative="")] = ("lobby",)
    """Views of data/synthetic/views, by name."""
    seeds: Annotated[Sequence[int], Parameter(negative="")] = (0,)
    """Seeds of the views; the engine was tuned on seeds 0 to 9."""
    frames: int = 150
    """Only the first frames of every view."""


def foreground(*, options: ForegroundOptions | None = None) -> None:
    """Share of wrong pixels of one camera's foreground, and of OpenCV's MOG2 and KNN, by condition.

    Each view is rendered once per condition (dark, blurred, compressed, a polished floor...); the first three seconds
    do not count.

    Example: python -m benchmarks foreground --scene lobby --seeds 0
    """
    o = options or ForegroundOptions()
    if o.frames < 1:
        raise InputError(f"--frames: expected at least 1, found {o.frames}")
    if not o.seeds or min(o.seeds) < 0:
        raise InputError("--seeds: expected numbers from 0")
    settings, rendering = o.settings(), Rendering(o.cache_folder, frames=o.frames)
    rows: list[dict[str, Any]] = []
    for seed, path, condition in product(o.seeds, scene_files(o.scene, VIEWS), CONDITIONS):
        named = {"view": path.stem, "seed": seed, "condition": condition}
        found = score_foreground(path, seed, condition, rendering, settings)
        rows += [{**named, "method": method, **figures} for method, figures in found.items()]
    means = DataFrame(rows).groupby(["condition", "method"], sort=False)[["wrong", "missed", "false"]].mean()
    report(o.json_output, **({"scores": rows} if o.json_output else {}), means=means.reset_index().to_dict("records"))
    progress("wrong pixels %; people's pixels missed %; the room's that are foreground %")
