"""A world of drawn people for the human-model tracker: silhouettes of known models on the floor of a known camera."""

import math
from collections.abc import Callable, Iterable

import cv2
import numpy as np

from calib.ground_camera import GroundCamera
from planview.tracking.base import Observation
from planview.tracking.human_model import HumanModelParams, HumanModelTracker
from planview.tracking.human_model.model_map import HumanModelMapParams, build_model_map
from planview.tracking.human_model.params import NewTargetParams
from planview.tracking.human_model.scene import ModelScene
from planview.trajectories.state import TrackState

CAMERA = GroundCamera(160, 120, 120.0, 4.0, math.radians(62))
PARAMS = HumanModelParams(map=HumanModelMapParams(min_height_px=12), spawn=NewTargetParams(min_height_px=12))
MAP = build_model_map(CAMERA, params=PARAMS.map)
FPS = 10
SEATED = PARAMS.posture.sitting
RED, BLUE = (20, 20, 200), (200, 40, 20)

Drawn = tuple[float, float, tuple[int, int, int]]
"""Floor position [m] and colour of a drawn person."""


class World:
    """Draws people as their own models and remembers the last frame for motion."""

    def __init__(self) -> None:
        self._scene = ModelScene(MAP, PARAMS.match)
        self._last: np.ndarray | None = None

    def observe(
        self,
        k: int,
        people: Iterable[Drawn],
        hidden: slice | None = None,
        heights: Iterable[float] | None = None,
        slim: bool = False,
    ) -> Observation:
        image = np.full((120, 160, 3), 128, np.uint8)
        mask = np.zeros((120, 160), np.uint8)
        people = list(people)
        tall = [1.0] * len(people) if heights is None else heights
        for (x, y, colour), height in sorted(zip(people, tall, strict=True), key=lambda p: -p[0][1]):
            one = np.zeros((120, 160), np.uint8)
            self._scene.paint(one, CAMERA.project((x, y, 0.0)), height, 1)
            if slim:
                one = np.asarray(cv2.erode(one, np.ones((1, 5), np.uint8)), np.uint8)
            image[one > 0] = colour
            mask[one > 0] = 255
        if hidden is not None:
            image[:, hidden], mask[:, hidden] = 128, 0
        last = image if self._last is None else self._last
        motion = np.where((image != last).any(axis=2), 255, 0).astype(np.uint8)
        self._last = image
        return Observation(k, k / FPS, image, mask, motion)


def run(
    path: Callable[[float], Iterable[Drawn]],
    seconds: float,
    hidden: slice | None = None,
    params: HumanModelParams = PARAMS,
) -> tuple[HumanModelTracker, list[tuple[TrackState, ...]], list[str]]:
    tracker, world = HumanModelTracker(params, CAMERA, MAP), World()
    states, kinds = [], []
    for k in range(int(seconds * FPS)):
        states.append(tracker.update(world.observe(k, path(k / FPS), hidden)))
        kinds += [d.kind for d in tracker.decisions]
    return tracker, states, kinds


def confirmed(states: tuple[TrackState, ...]) -> list[TrackState]:
    return [s for s in states if s.state == "confirmed"]
