"""A world of painted people for the human-model tracker: silhouettes of known models on the floor of a known camera."""

import math
from collections.abc import Callable, Iterable

import cv2
import numpy as np

from calib.ground_camera import GroundCamera
from calib.people.model import HumanModel
from calib.types import F64, U8
from planview.maps.view import View
from planview.tracking.base import Observation
from planview.tracking.human_model import HumanModelParams, HumanModelTracker
from planview.tracking.human_model.model_map import HumanModelMapParams, build_model_map
from planview.trajectories.state import TrackState

CAMERA = GroundCamera(160, 120, 120.0, 4.0, math.radians(62))
PARAMS = HumanModelParams(map=HumanModelMapParams(min_height_px=12))
MAP = build_model_map(CAMERA, params=PARAMS.map)
FPS = 10
RED, BLUE = (20, 20, 200), (200, 40, 20)

Drawn = tuple[float, float, tuple[int, int, int]]
"""Floor position [m] and colour of a painted person."""


def outline(x_m: float, y_m: float, height_m: float = 1.76) -> list[F64]:
    """(K, 2) hulls [px] of head, torso and legs of a person."""
    model = HumanModel().scaled(height_m)
    circles = model.circles().reshape(4, -1, 3) + np.array([x_m, y_m, 0.0])
    legs, hip, shoulder, top = (CAMERA.project(c) for c in circles)
    return [np.concatenate(pair) for pair in ((legs, hip), (hip, shoulder), (0.5 * (shoulder + top), top))]


def paint(mask: U8, x_m: float, y_m: float, height_m: float = 1.76) -> None:
    """Fill a person's pixels with 255."""
    for part in outline(x_m, y_m, height_m):
        cv2.fillConvexPoly(mask, cv2.convexHull(np.rint(part).astype(np.int32)), 255)


class World:
    """Draws people and remembers the last frame for motion."""

    def __init__(self) -> None:
        self._last = None

    def observe(
        self, k: int, people: Iterable[Drawn], hidden: slice | None = None, heights: Iterable[float] | None = None
    ) -> Observation:
        """Frame k: farther people first, columns ``hidden`` as empty as the wall, heights 1.76 m unless given."""
        image = np.full((120, 160, 3), 128, np.uint8)
        mask = np.zeros((120, 160), np.uint8)
        people = list(people)
        tall = [1.76] * len(people) if heights is None else heights
        for (x, y, colour), height in sorted(zip(people, tall, strict=True), key=lambda p: -p[0][1]):
            one = np.zeros((120, 160), np.uint8)
            paint(one, x, y, height)
            image[one > 0] = colour
            mask |= one
        if hidden is not None:
            image[:, hidden], mask[:, hidden] = 128, 0
        last = image if self._last is None else self._last
        motion = np.where((image != last).any(axis=2), 255, 0).astype(np.uint8)
        self._last = image
        return Observation(k, k / FPS, (View.of_mask(mask, motion, image),))


def run(
    path: Callable[[float], Iterable[Drawn]],
    seconds: float,
    hidden: slice | None = None,
    params: HumanModelParams = PARAMS,
    heights: Callable[[float], Iterable[float]] | None = None,
) -> tuple[HumanModelTracker, list[tuple[TrackState, ...]], list[str]]:
    """A tracker after some seconds, its states of every frame and the kinds of all its decisions."""
    tracker, world = HumanModelTracker(params, CAMERA, MAP), World()
    states, kinds = [], []
    for k in range(int(seconds * FPS)):
        tall = None if heights is None else heights(k / FPS)
        states.append(tracker.update(world.observe(k, path(k / FPS), hidden, tall)))
        kinds += [d.kind for d in tracker.decisions]
    return tracker, states, kinds
