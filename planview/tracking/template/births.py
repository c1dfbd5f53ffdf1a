"""Newcomers: where the surface that nobody explains would be explained by one more person."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from calib.types import F64, I64
from planview.tracking import body
from planview.tracking.kalman import FloorKalman
from planview.tracking.template.explanation import Explanation, People
from planview.tracking.template.person import Person

CELL_M = 0.05
BODY_CELLS = 9
"""Side of the box whose surface is summed: a body's breadth [cells]."""
MOST = 6
"""Places that are tried in a frame."""
SURFACE_MIN_M2 = 0.05
"""Least surface that is a try: five patches [m^2]."""
MAP_CELLS_MAX = 4_000_000
BORN_LOG_ODDS = -3.9
"""Of a newcomer before its first look: one in fifty."""


class Births:
    """Tries one more person wherever enough surface is left over."""

    def __init__(self, frame: Explanation, people: People) -> None:
        self._frame, self._people = frame, people

    def find(self, owners: Sequence[I64], now_s: float) -> list[Person]:
        """People who are born in this frame, without ids.

        Args:
            owners: per view, who owns each pixel; -1 is what is left over.
        """
        left = self._unexplained(owners)
        if left[:, 3].sum() < SURFACE_MIN_M2:
            return []
        low = left[:, :2].min(axis=0) - BODY_CELLS * CELL_M
        at = ((left[:, :2] - low) / CELL_M).astype(int)
        shape = at.max(axis=0) + 2 * BODY_CELLS
        if int(shape[0]) * int(shape[1]) > MAP_CELLS_MAX:
            return []
        occupancy = np.zeros(shape, np.float32)
        np.add.at(occupancy, (at[:, 0], at[:, 1]), left[:, 3])
        box = np.asarray(cv2.boxFilter(occupancy, -1, (BODY_CELLS, BODY_CELLS), normalize=False))
        born = []
        for _ in range(MOST):
            row, col = divmod(int(np.argmax(box)), box.shape[1])
            if box[row, col] < SURFACE_MIN_M2:
                break
            place = low + (np.array([row, col]) + 0.5) * CELL_M
            reach = BODY_CELLS * 2 // 3
            box[max(0, row - reach) : row + reach + 1, max(0, col - reach) : col + reach + 1] = 0
            near = np.abs(left[:, :2] - place).max(axis=1) < reach * CELL_M
            person = self._try(left[near], now_s) if near.sum() >= 8 else None
            if person is not None:
                born.append(person)
                self._people = self._people.with_one(np.array([*person.at_m, person.height_m]))
        return born

    def _unexplained(self, owners: Sequence[I64]) -> F64:
        """(N, 5) x, y, z, surface and colour code of the points that nobody explains."""
        points = []
        for v, owner in zip(self._frame.views, owners, strict=True):
            row, col = np.nonzero(owner == -1)
            far = v.range_m[row, col]
            xyz = v.rays.centre_m + far[:, None] * v.rays.direction[row, col]
            area = (far / v.rays.stretch[row, col]) ** 2 * v.rays.pixel_sr
            code = v.colour[row, col] if v.colour is not None else np.zeros(len(row))
            points.append(np.column_stack([xyz, area, code]))
        return np.asarray(np.concatenate(points), dtype=np.float64)

    def _try(self, points: F64, now_s: float) -> Person | None:
        """A newcomer at some points, if the evidence for one is strong enough."""
        frame, p, known = self._frame, self._frame.params, self._people
        place = np.average(points[:, :2], axis=0, weights=points[:, 3])
        out = place - frame.views[0].rays.centre_m[:2]
        place = place + out / max(float(np.hypot(*out)), body.TORSO.torso_radius_m) * 0.5 * body.TORSO.torso_radius_m
        top = float(np.clip(np.quantile(points[:, 2], 0.97), 0.9, body.HEIGHT_MAX_M))
        start = np.array([*place, body.HEIGHT_MEAN_M])
        if len(known.poses) and np.hypot(*(known.poses[:, :2] - place).T).min() < body.TORSO.torso_radius_m / 2:
            return None
        people = known.with_one(start)
        n = len(known.poses)
        others = np.flatnonzero(frame.touching(people.poses)[n, :n])
        samples = frame.around(start, body.TORSO.torso_radius_m + 0.15)
        samples.layer(people, others)
        near = 1 / body.TORSO.torso_radius_m**2
        information, best, pose = np.array([near, 0.0, near, 1.0]), -np.inf, start
        for height in (body.HEIGHT_MEAN_M, top):
            moved = np.array([*place, height])
            value = samples.ascend(
                moved, moved.copy(), information, people.tall[n], people.apart(others), people.ratios[n]
            )
            if value > best:
                best, pose = value, moved
        mine, total = samples.visible(pose)
        if best < p.birth_evidence or mine < 0.25 * total:
            return None
        noise, up = samples.noise(pose, people.ratios[n])
        kalman = FloorKalman.measured(float(pose[0]), float(pose[1]), noise, 1.0)
        person = Person(0, kalman, float(pose[2]), BORN_LOG_ODDS, now_s)
        person.height_var = 1.0 / (1.0 / person.height_var + up)
        person.log_odds += min(best, p.evidence_max) * 0.25
        person.origin_m, person.evidence, person.share = person.at_m, best, mine / max(total, 1e-6)
        if all(v.colour is not None for v in frame.views):
            person.learn_colours(points[:, 2] / person.height_m, points[:, 4].astype(np.uint8))
        return person
