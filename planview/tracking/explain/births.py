"""Newcomers: where one more person would explain what the people followed leave unexplained."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from calib.carried import Carried
from calib.types import F32, F64, I64
from planview.maps.grid import MAX_CELLS
from planview.maps.view import View
from planview.tracking import body
from planview.tracking.explain.clothes import colour_counts
from planview.tracking.explain.explanation import (
    NO_COLOURS,
    STEPS_M,
    Explanation,
    Owners,
    People,
    loose_prior,
    upright_pose,
)
from planview.tracking.explain.params import PeopleParams
from planview.tracking.explain.person import Glimpse, Person, side_by_side
from planview.tracking.explain.samples import TINY, find_fresh, map_lacking
from planview.tracking.kalman import FloorKalman

BIRTH_CELL_M = 0.05
"""Side of a cell of the floor over which unexplained pixels are summed [m]."""
BODY_CELLS = 9
"""Side of the box that is summed: a body's breadth [cells]."""
PLACES_MAX = 6
"""Places that are tried in a frame."""
CHANGED = 3.0
"""Deviations of its range from which a surface is another one."""
SEARCH_PRIOR = loose_prior(body.TORSO.torso_radius_m, 1.0)
"""Prior of a search: the place within a body's radius, and the height within a metre."""


*_, LACKING, CODE = range(5)
"""Rows of points: their place [m], what they lack of an explanation, and their colour."""


class FreshPoints(NamedTuple):
    """Points of surface that have not been tried at the range that they have now.

    Attributes:
        points: (5, M) float32, see LACKING.
        cameras: (M,) index of the view that shows each.
        pixels: (M,) its pixel there, row * width + column.
    """

    points: F32
    cameras: I64
    pixels: I64


class Births(Carried):
    """Tries one more person wherever enough pixels lack an explanation."""

    CARRIED = ("_tried_m",)

    def __init__(self, params: PeopleParams) -> None:
        self._params = params
        self._tried_m: list[F32] = []

    def prepare(self, views: Sequence[View]) -> None:
        """Make room for the pixels of every sensor. Raises ValueError: other sensors than in the frames before."""
        shapes = [view.kind.shape for view in views]
        if not self._tried_m:
            self._tried_m = [np.zeros(shape, np.float32) for shape in shapes]
        before = [tried_m.shape for tried_m in self._tried_m]
        if before != shapes:
            raise ValueError(f"expected views of {before} as in the frames before, got {shapes}")

    def find(
        self, frame: Explanation, followed: Sequence[Person], owners: Sequence[Owners], now_s: float
    ) -> list[Person]:
        """Find the newcomers of a frame, without ids.

        Pixels that have been tried count again when they have changed.

        Args:
            owners: of each view.
        """
        least = self._params.birth_evidence
        fresh = self._fresh_points(frame, owners)
        points = fresh.points
        if float(np.maximum(points[LACKING], 0.0).sum()) < least:
            return []
        low_m = points[:2].min(axis=1).astype(np.float64) - BODY_CELLS * BIRTH_CELL_M
        gains = _map_gains(points, low_m)
        if gains is None or gains.max() < least:
            return []
        born: list[Person] = []
        people = side_by_side(followed)
        tried = np.zeros(points.shape[1], np.bool_)
        reach = BODY_CELLS * 2 // 3
        for _ in range(PLACES_MAX):
            row, col = divmod(int(np.argmax(gains)), gains.shape[1])
            if gains[row, col] < least:
                break
            gains[max(0, row - reach) : row + reach + 1, max(0, col - reach) : col + reach + 1] = 0
            place = low_m + (np.array([row, col]) + 0.5) * BIRTH_CELL_M
            near = np.abs(points[:2] - place[:, None]).max(axis=0) < reach * BIRTH_CELL_M
            tried |= near
            lacks = near & (points[LACKING] > 0)
            unexplained = points[:, lacks].astype(np.float64)
            person = _try_person(frame, least, people, unexplained, fresh.cameras[lacks], now_s)
            if person is not None:
                born.append(person)
                people = people.with_one(person.pose)
        for k, view in enumerate(frame.views):
            pixels = fresh.pixels[tried & (fresh.cameras == k)]
            self._tried_m[k].reshape(-1)[pixels] = view.range_m.reshape(-1)[pixels]
        return born

    def _fresh_points(self, frame: Explanation, owners: Sequence[Owners]) -> FreshPoints:
        """The pixels of all views that have not been tried at the range that they have now."""
        points = []
        cameras = []
        pixels = []
        changed = body.SURFACE_STD_M, CHANGED
        for k, in_view in enumerate(owners):
            n = len(in_view.pixels)
            which = np.empty(n, np.int64)
            out = np.empty((5, n), np.float32)
            view = frame.arrays[k]
            n = find_fresh(
                in_view.pixels, in_view.lacking, in_view.colours, view, self._tried_m[k], changed, which, out
            )
            points.append(out[:, :n])
            cameras.append(np.full(n, k))
            pixels.append(in_view.pixels[which[:n]])
        return FreshPoints(np.hstack(points), np.hstack(cameras), np.hstack(pixels))


def _map_gains(points: F32, low_m: F64) -> F32 | None:
    """Gain of one more person at each cell of the floor from ``low_m`` on: the sum over a body's breadth; None for a
    floor that is too large."""
    high_m = points[:2].max(axis=1).astype(np.float64)
    rows, cols = [int(cells) + 2 * BODY_CELLS for cells in (high_m - low_m) / BIRTH_CELL_M]
    if rows * cols > MAX_CELLS:
        return None
    lacking = np.zeros((rows, cols), np.float32)
    map_lacking(points, low_m, BIRTH_CELL_M, lacking)
    return np.asarray(cv2.boxFilter(lacking, -1, (BODY_CELLS, BODY_CELLS), normalize=False), np.float32)


def _try_person(
    frame: Explanation, least: float, people: People, points: F64, cameras: I64, now_s: float
) -> Person | None:
    """A newcomer where points lack an explanation; None unless the evidence is strong enough.

    Args:
        least: evidence of a newcomer.
        points: (5, N) see LACKING.
        cameras: (N,) index of the view that shows each.
    """
    if not len(cameras):
        return None
    place = _place_behind(points, cameras, frame)
    top_m = float(np.clip(np.quantile(points[2], 0.97), 0.9, body.HEIGHT_MAX_M))
    n = len(people.poses)
    trial = people.with_one(upright_pose((*place, body.HEIGHT_MEAN_M)))
    start, stature, ratios = trial.person(n)
    samples = frame.samples_around(start, body.TORSO.torso_radius_m + 0.15)
    samples.lay_others(trial, np.flatnonzero(frame.share_rays(trial.poses)[n, :n]))
    fits = []
    for height_m in (body.HEIGHT_MEAN_M, top_m):
        start = upright_pose((*place, height_m))
        pose = start.copy()
        evidence, _ = samples.ascend(pose, start, SEARCH_PRIOR, stature, ratios, STEPS_M[:1])
        fits.append((evidence, start, pose))
    evidence, start, pose = max(fits, key=lambda fit: fit[0])
    if evidence < 0.5 * least:  # a finer step gains less
        return None
    evidence, curvature = samples.ascend(pose, start, SEARCH_PRIOR, stature, ratios, STEPS_M[1:])
    # Evidence is a mean over all directions of facing, of which two opposite ones explain like the best one.
    evidence += min(0.0, 0.5 * math.log(2.0 / (math.pi * max(float(curvature[3]), TINY))))
    own, shown, _ = samples.visible_patches(pose, stature, ratios).tolist()
    if evidence < least or own < 0.25 * shown:
        return None
    glimpse = Glimpse(evidence, own / max(shown, 1e-6))
    person = Person.newcomer(pose, *samples.precision(pose, curvature), glimpse, now_s)
    if not frame.shows_height(pose, *stature):
        person.height_m = body.HEIGHT_MEAN_M
    if frame.coloured:
        one = np.zeros(len(cameras), np.int64)
        counts = colour_counts(1, one, points[2] / person.height_m, points[CODE].astype(np.uint8))
        person.identity.clothes.learn(counts[0])
    return person


def _place_behind(points: F64, cameras: I64, frame: Explanation) -> F64:
    """(2,) where the axis of a body is with some points on its surface: half a torso's radius behind their mean, away
    from each camera by its share of them. Between two that see front and back it is the mean."""
    radius_m = body.TORSO.torso_radius_m
    weights = points[LACKING]
    place = np.average(points[:2], 1, weights)
    share = np.bincount(cameras, weights, minlength=len(frame.views))
    out = place - np.array([view.rays.centre_m[:2] for view in frame.views])
    away = out / np.maximum(np.hypot(*out.T), radius_m)[:, None]
    return np.asarray(place + share / share.sum() @ away * 0.5 * radius_m)


def odds_of_moving(
    frame: Explanation,
    people: Sequence[Person],
    predicted: Sequence[FloorKalman],
    born: Sequence[Person],
    p: PeopleParams,
) -> F64:
    """(people, newcomers) log-odds of somebody followed being a newcomer, rather than both being there.

    Where somebody was predicted badly, an ascent from there ends on whatever is near and misses the person.

    Args:
        predicted: where each of the people was.
    """
    everybody = side_by_side([*people, *born])
    shared = frame.share_rays(everybody.poses)
    odds = np.full((len(people), len(born)), -math.inf)
    reach_m = body.TORSO.torso_radius_m + 0.1
    for i, person in enumerate(people):
        prior = np.array([predicted[i].log_prior(place) for place in everybody.poses[:, :2]])
        likely = np.flatnonzero(prior[len(people) :] + p.birth_evidence >= 0.0)
        visible = person.glimpse.visible_share >= p.visible_min
        if len(likely) == 0 or not person.confirmed or not visible:
            continue
        pose, stature, ratios = everybody.person(i)
        samples = frame.samples_around(pose, reach_m)
        samples.lay_others(everybody, np.flatnonzero(shared[i]))
        both = prior[i] + samples.evidence(pose, stature, ratios) - p.birth_evidence
        for k in likely:
            n = len(people) + k
            there = everybody.poses[n]
            samples = frame.samples_around(there, reach_m)
            samples.lay_others(everybody, np.setdiff1d(np.flatnonzero(shared[n]), [i]))
            moved = prior[n] + samples.evidence(there, stature, ratios)
            stranger = samples.evidence(there, everybody.statures[n], NO_COLOURS)
            odds[i, k] = moved - both - stranger
    return odds
