"""Newcomers: where one more person would explain what the people known leave unexplained."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from calib.carried import Carried
from calib.types import F32, F64, I64
from planview.maps.view import CODES, View
from planview.tracking import body
from planview.tracking.explain.explanation import STEPS_M, Explanation, Owned, People, about, upright
from planview.tracking.explain.params import PeopleParams
from planview.tracking.explain.person import BORN_LOG_ODDS, Person, colour_counts, side_by_side
from planview.tracking.explain.samples import PARTS, TINY, map_lacking
from planview.tracking.explain.samples import fresh_points as find_fresh
from planview.tracking.kalman import FloorKalman

EVIDENCE_MAX = 6.0
"""Largest evidence of one observation for or against a person, as a log-odds."""
BIRTH_CELL_M = 0.05
"""Side of a cell of the floor over which unexplained pixels are summed [m]."""
BODY_CELLS = 9
"""Side of the box that is summed: a body's breadth [cells]."""
PLACES_MAX = 6
"""Places that are tried in a frame."""
MAP_CELLS_MAX = 4_000_000
CHANGED = 3.0
"""Deviations of its range from which a surface is another one."""
SEARCH_PRIOR = about(body.TORSO.torso_radius_m, 1.0)
"""Prior of a search: the place within a body's radius, and the height within a metre."""


class Births(Carried):
    """Tries one more person wherever enough pixels lack an explanation."""

    CARRIED = ("_tried_m",)

    def __init__(self, params: PeopleParams) -> None:
        self._params = params
        self._tried_m: list[F32] = []

    def prepare(self, views: Sequence[View]) -> None:
        """Make room for the pixels of every head. Raises ValueError: other heads than in the frames before."""
        shapes = [view.kind.shape for view in views]
        self._tried_m = self._tried_m or [np.zeros(shape, np.float32) for shape in shapes]
        if (before := [tried.shape for tried in self._tried_m]) != shapes:
            raise ValueError(f"expected views of {before} as in the frames before, got {shapes}")

    def find(self, frame: Explanation, known: Sequence[Person], owned: Sequence[Owned], now_s: float) -> list[Person]:
        """New people of this frame, without ids; ``owned`` is of each view.

        Pixels that have been tried count again when they have changed.
        """
        p = self._params
        found = [self._fresh(k, frame, o) for k, o in enumerate(owned)]
        starts = np.cumsum([0, *(len(o.pixels) for o in owned)])
        fresh = np.concatenate([which + first for (which, _), first in zip(found, starts, strict=False)])
        fresh_points = np.concatenate([points for _, points in found], axis=1)
        cameras = np.repeat(np.arange(len(found)), [len(which) for which, _ in found])
        if float(np.maximum(fresh_points[3], 0.0).sum()) < p.birth_evidence:
            return []
        low, high = (edge(fresh_points[:2], axis=1).astype(np.float64) for edge in (np.min, np.max))
        low -= BODY_CELLS * BIRTH_CELL_M
        shape = tuple(int(cells) + 2 * BODY_CELLS for cells in (high - low) / BIRTH_CELL_M)
        if shape[0] * shape[1] > MAP_CELLS_MAX:
            return []
        lack = np.zeros(shape, np.float32)
        map_lacking(fresh_points, low, BIRTH_CELL_M, lack)
        box = np.asarray(cv2.boxFilter(lack, -1, (BODY_CELLS, BODY_CELLS), normalize=False))
        born: list[Person] = []
        people: People | None = None
        tried = np.zeros(starts[-1], np.bool_)
        for _ in range(PLACES_MAX):
            row, col = divmod(int(np.argmax(box)), box.shape[1])
            if box[row, col] < p.birth_evidence:
                break
            place = low + (np.array([row, col]) + 0.5) * BIRTH_CELL_M
            reach = BODY_CELLS * 2 // 3
            box[max(0, row - reach) : row + reach + 1, max(0, col - reach) : col + reach + 1] = 0
            people = people or side_by_side(known)
            near = np.abs(fresh_points[:2] - place[:, None]).max(axis=0) < reach * BIRTH_CELL_M
            lacks = near & (fresh_points[3] > 0)
            lacking = fresh_points[:, lacks].T.astype(np.float64)
            person = _tried(frame, p.birth_evidence, people, lacking, cameras[lacks], now_s)
            tried[fresh[near]] = True
            if person is None:
                continue
            born.append(person)
            people = people.with_one(person.pose)
        for v, tried_m, o, mine in zip(frame.views, self._tried_m, owned, np.split(tried, starts[1:-1]), strict=True):
            tried_m.reshape(-1)[o.pixels[mine]] = v.range_m.reshape(-1)[o.pixels[mine]]
        return born

    def _fresh(self, k: int, frame: Explanation, o: Owned) -> tuple[I64, F32]:
        """Which pixels of view k have not been tried at the range that they have now, and their points."""
        n, std_m = len(o.pixels), (body.SURFACE_STD_M, CHANGED)
        which, points = np.empty(n, np.int64), np.empty((5, n), np.float32)
        n = find_fresh(o.pixels, o.lacking, o.colours, frame.seen[k], self._tried_m[k], std_m, which, points)
        return which[:n], points[:, :n]


def _tried(
    frame: Explanation, birth_evidence: float, people: People, points: F64, cameras: I64, now_s: float
) -> Person | None:
    """A newcomer at some (N, 5) points, each seen by one of the ``cameras`` (N,), if the evidence for one is strong
    enough."""
    if len(points) == 0:
        return None
    radius = body.TORSO.torso_radius_m
    place = _behind(points, cameras, frame)
    top = float(np.clip(np.quantile(points[:, 2], 0.97), 0.9, body.HEIGHT_MAX_M))
    n = len(people.poses)
    start = upright((*place, body.HEIGHT_MEAN_M))
    trial = people.with_one(start)
    others = np.flatnonzero(frame.touching(trial.poses)[n, :n])
    samples = frame.around(start, radius + 0.15)
    samples.layer(trial, others)
    tall, ratios = trial.tall[n], trial.ratios[n]
    starts = [upright((*place, height)) for height in (body.HEIGHT_MEAN_M, top)]
    poses = [start.copy() for start in starts]
    found = [
        samples.ascend(pose, start, SEARCH_PRIOR, tall, ratios, STEPS_M[:1])[0]
        for pose, start in zip(poses, starts, strict=True)
    ]
    best = int(np.argmax(found))
    if found[best] < 0.5 * birth_evidence:  # a finer step gains less
        return None
    pose = poses[best]
    evidence, curvature = samples.ascend(pose, starts[best], SEARCH_PRIOR, tall, ratios, STEPS_M[1:])
    # Evidence is a mean over all directions of facing, of which two opposite ones explain like the best one.
    evidence += min(0.0, 0.5 * math.log(2.0 / (math.pi * max(float(curvature[3]), TINY))))
    mine, known, _ = samples.visible(pose, tall, ratios).tolist()
    if evidence < birth_evidence or mine < 0.25 * known:
        return None
    log_odds = BORN_LOG_ODDS + 0.25 * min(evidence, EVIDENCE_MAX)
    person = Person.born(pose, *samples.noise(pose, curvature), log_odds, now_s)
    person.evidence, person.share = evidence, mine / max(known, 1e-6)
    if not frame.shows_height(pose, *trial.tall[n]):
        person.height_m = body.HEIGHT_MEAN_M
    if frame.coloured:
        owner = np.zeros(len(points), np.int64)
        person.learn_colours(colour_counts(1, owner, points[:, 2] / person.height_m, points[:, 4].astype(np.uint8))[0])
    return person


def _behind(points: F64, cameras: I64, frame: Explanation) -> F64:
    """(2,) where the axis of a body is with some points on its surface: half a torso's radius behind their mean, away
    from each camera by its share of them. Between two that see front and back it is the mean."""
    radius, weights = body.TORSO.torso_radius_m, points[:, 3]
    place = np.average(points[:, :2], axis=0, weights=weights)
    share = np.bincount(cameras, weights, minlength=len(frame.views))
    out = place - np.array([v.rays.centre_m[:2] for v in frame.views])
    away = out / np.maximum(np.hypot(*out.T), radius)[:, None]
    return np.asarray(place + share / share.sum() @ away * 0.5 * radius)


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
    everybody, nobody = side_by_side([*people, *born]), np.ones((PARTS, CODES), np.float32)
    poses, touch = everybody.poses, frame.touching(everybody.poses)
    odds = np.full((len(people), len(born)), -math.inf)
    reach_m = body.TORSO.torso_radius_m + 0.1
    for i, (person, before) in enumerate(zip(people, predicted, strict=True)):
        prior = np.array([before.log_prior(place) for place in poses[:, :2]])
        likely = np.flatnonzero(prior[len(people) :] + p.birth_evidence >= 0.0)
        if len(likely) == 0 or not person.confirmed or person.share < p.visible_min:
            continue
        tall, ratios = everybody.tall[i], everybody.ratios[i]
        own = frame.around(poses[i], reach_m)
        own.layer(everybody, np.flatnonzero(touch[i]))
        both = prior[i] + own.evidence(poses[i], tall, ratios) - p.birth_evidence
        for k in likely:
            n = len(people) + k
            there = frame.around(poses[n], reach_m)
            there.layer(everybody, np.setdiff1d(np.flatnonzero(touch[n]), [i]))
            moved = prior[n] + there.evidence(poses[n], tall, ratios)
            odds[i, k] = moved - both - there.evidence(poses[n], everybody.tall[n], nobody)
    return odds
