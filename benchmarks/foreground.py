"""Foreground of one camera beside OpenCV's MOG2 and KNN, on drawn views with exact masks."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from cyclopts import Parameter
from rich.console import Console

from benchmarks.options import BenchOptions, Progress, Rendering, rendered, scene_files, show
from benchmarks.views import VIEWS, drawn_view
from calib.errors import InputError
from calib.types import I32, I64, Bool
from planview.engine.config import Config
from planview.engine.open import open_engine
from planview.synthetic.render import SceneRenderer

CONDITIONS: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    "as drawn": {},
    "dark, noisy": {"light": {"brightness": 0.02, "full_well_e": 800.0}},
    "motion blur": {"capture": {"shutter_s": 0.08}},
    "automatic exposure, white balance": {"capture": {"auto_exposure": 0.9, "auto_white_balance": 0.6}},
    "lamp dimmed": {"light": {"dimmed": True}},
    "compressed": {"capture": {"jpeg_quality": 25}},
    "polished floor": {"room": {"gloss": 0.25}},
    "thing moved": {"room": {"moved": True}},
    "clothes like the wall": {"room": {"grey_clothes": 1.0}},
}
"""What takes the place of the values that a seed has drawn, by condition."""


@dataclass(frozen=True)
class ForegroundScore:
    """One method on one condition; shares pooled over frames.

    Attributes:
        wrong: share of all pixels that are wrong.
        missed: share of people's pixels that are not foreground.
        false: share of the room's pixels that are.
    """

    view: str
    seed: int
    condition: str
    method: str
    wrong: float
    missed: float
    false: float


def pixel_counts(found: Bool, owner: I32) -> I64:
    """(4,) of a mask (H, W): people's pixels missed, people's pixels, the room's found, the room's, by whose pixels
    (H, W) they are; those of moving things do not count."""
    people, room = owner > 0, owner == 0
    return np.array([(people & ~found).sum(), people.sum(), (room & found).sum(), room.sum()], np.int64)


def score_foreground(
    path: Path, seed: int, condition: str, rendering: Rendering, config: Config, progress: Progress
) -> list[ForegroundScore]:
    """The engine's own foreground (with the ellipse-particle tracker's feedback), MOG2 and KNN on one condition.

    OpenCV's own have their defaults, a median of 3x3 pixels as the engine's has, and shadows removed.
    """
    view, name = drawn_view(path, seed, CONDITIONS[condition]), path.stem
    recording = rendered(view.scene, f"view-{name}-{seed}", rendering, progress)
    progress(f"{name} of seed {seed}, {condition}")
    engine = open_engine(recording, "ellipse-particle", config)
    others = {"MOG2": cv2.createBackgroundSubtractorMOG2(), "KNN": cv2.createBackgroundSubtractorKNN()}
    counts = {method: np.zeros(4, np.int64) for method in ("planview", *others)}
    renderer = SceneRenderer(view.scene)
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
    scores = []
    for method, count in counts.items():
        missed, people, false, room = map(int, count)
        shares = (missed + false) / max(1, people + room), missed / max(1, people), false / max(1, room)
        scores.append(ForegroundScore(name, seed, condition, method, *shares))
    return scores


@Parameter(name="*")
@dataclass(frozen=True)
class ForegroundOptions(BenchOptions):
    """Which views are drawn, and how much of them."""

    scene: Annotated[Sequence[str], Parameter(negative="")] = ("lobby",)
    """Views of data/synthetic/views, by name."""
    seeds: Annotated[Sequence[int], Parameter(negative="")] = (0,)
    """Seeds of the views. Seeds 0 to 9 are worked on, others judge."""
    frames: int = 150
    """Only the first frames of every view."""


def foreground(*, options: ForegroundOptions | None = None) -> None:
    """Share of wrong pixels of one camera's foreground beside OpenCV's MOG2 and KNN, by condition, with exact masks.

    Each view is drawn once per condition (dark, blurred, compressed, a polished floor...); the first three seconds do
    not count.

    Example: python -m benchmarks foreground --scene lobby --seeds 0
    """
    o = options or ForegroundOptions()
    if o.frames < 1:
        raise InputError(f"--frames: expected at least 1, found {o.frames}")
    if not o.seeds or min(o.seeds) < 0:
        raise InputError("--seeds: expected numbers from 0")
    settings, rendering = o.settings(), Rendering(o.cache_folder, frames=o.frames)
    with Console(stderr=True, markup=False).status("...") as status:
        scores = [
            score
            for seed in o.seeds
            for path in scene_files(o.scene, VIEWS)
            for condition in CONDITIONS
            for score in score_foreground(path, seed, condition, rendering, settings, status.update)
        ]
    if o.json_output:
        print(json.dumps([asdict(score) for score in scores], indent=2))
        return
    methods, console, rows = dict.fromkeys(score.method for score in scores), Console(markup=False), []
    for condition in CONDITIONS:
        rows.append({"condition": condition})
        for method in methods:
            mine = [(s.wrong, s.missed, s.false) for s in scores if s.condition == condition and s.method == method]
            wrong, missed, false = 100 * np.mean(mine, axis=0)
            rows[-1][method] = f"{wrong:.2f} ({missed:.0f}, {false:.2f})"
    show(rows, console)
    console.print("wrong pixels %; in brackets people's pixels missed %, and the room's that are foreground %")
