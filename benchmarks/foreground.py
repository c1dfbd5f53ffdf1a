"""Foreground of one camera beside OpenCV's MOG2 and KNN, on drawn views with exact masks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np

from benchmarks.accuracy import RenderOptions, Tell, rendered
from benchmarks.views import drawn_view
from calib.types import I32, Bool
from planview.engine.config import Config
from planview.engine.factory import open_engine
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
SETTLED_S = 3.0
"""Time in which backgrounds are learned, before anything counts [s]."""


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

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


class Tally:
    """Pixels of one method: add frame by frame."""

    def __init__(self) -> None:
        self._missed = self._people = self._false = self._room = 0

    def add(self, found: Bool, owner: I32) -> None:
        """Compare a mask (H, W) with whose pixels they are (H, W); those of moving things do not count."""
        people, room = owner > 0, owner == 0
        self._people += int(people.sum())
        self._room += int(room.sum())
        self._missed += int((people & ~found).sum())
        self._false += int((room & found).sum())

    def score(self, view: str, seed: int, condition: str, method: str) -> ForegroundScore:
        """The shares of all frames so far."""
        wrong = (self._missed + self._false) / max(1, self._people + self._room)
        missed, false = self._missed / max(1, self._people), self._false / max(1, self._room)
        return ForegroundScore(view, seed, condition, method, wrong, missed, false)


def score_foreground(
    name: str, seed: int, condition: str, options: RenderOptions, config: Config, tell: Tell
) -> list[ForegroundScore]:
    """The engine's own foreground (with the ellipse-particle tracker's feedback), MOG2 and KNN on one condition.

    OpenCV's own have their defaults, a median of 3x3 pixels as the engine's has, and shadows removed.
    """
    view = drawn_view(name, seed, CONDITIONS[condition])
    recording = rendered(view.scene, f"view-{name}-{seed}", options, tell)
    tell(f"{name} of seed {seed}, {condition}")
    engine = open_engine(recording, "ellipse-particle", config)
    others = {"MOG2": cv2.createBackgroundSubtractorMOG2(), "KNN": cv2.createBackgroundSubtractorKNN()}
    tallies = {method: Tally() for method in ("planview", *others)}
    renderer = SceneRenderer(view.scene)
    for result in engine:
        image, own = result.observation.image, result.observation.foreground
        assert image is not None and own is not None  # a single camera gives both
        found = {method: cv2.medianBlur(other.apply(image), 3) for method, other in others.items()}
        found["planview"] = cv2.resize(own, image.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        if result.timestamp_s >= SETTLED_S:
            owner = renderer.owner(result.frame)
            for method, mask in found.items():
                tallies[method].add(np.asarray(mask == 255), owner)
    return [tally.score(name, seed, condition, method) for method, tally in tallies.items()]


def pooled(scores: Sequence[ForegroundScore], condition: str, method: str) -> tuple[float, float, float]:
    """Means of wrong, missed and false over views and seeds."""
    mine = [(s.wrong, s.missed, s.false) for s in scores if s.condition == condition and s.method == method]
    wrong, missed, false = np.mean(mine, axis=0)
    return float(wrong), float(missed), float(false)
