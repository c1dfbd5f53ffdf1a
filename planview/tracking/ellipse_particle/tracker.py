"""The tracker of section III to V: measure, predict, weigh by overlap, judge existence."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from calib.carried import Carried
from calib.ground_camera import GroundCamera
from calib.types import F32, F64, U8, Bool
from planview.foreground.params import WALKER
from planview.maps.view import SHADOW, View
from planview.tracking.base import Decision, Drawing, Existence, LifeCycle, Observation, TrackerDebug
from planview.tracking.ellipse_particle.fit import BACKGROUND_WEIGHT, fit_ellipses, painted, uncovered
from planview.tracking.ellipse_particle.params import EllipseParticleParams
from planview.tracking.ellipse_particle.particles import VX, VY, ParticleFilter, Y, ellipses_of
from planview.tracking.ellipse_particle.size import ASPECT, BREADTH_M, Size, SizeLearner, height_of, size_of_camera
from planview.trajectories.state import TrackState

COLUMNS = 320
"""Columns of foreground that are enough [px]. Our choice; it bounds the time per frame."""
PERSON_CELLS = 28.0
"""Cells of the grid, at least a pixel of foreground each, along a person in the middle row. Our choice: legs are a
cell wide, and an ellipse takes the same time whatever the image."""
LEARN_S = 60.0
"""Time over which the size is learned [s]: the first minute of a recording, before it is tracked."""
MIN_OVERLAP = 0.35
"""Share of an object's ellipse that measurements must cover to count as measured; a measurement of which objects
cover less than this share is uncovered. Our choice."""
REACH_M = 1.5
"""Farthest a lost object is found again from its prediction [m]. Harville 2002 uses 2 m from the last sight."""
FLOODED = 0.5
"""Share of foreground above which a frame measures and teaches nothing (a light was switched, the camera moved)."""
GAMMA_SHAPE = 4.0
"""Of the Gamma distribution of the time after which an object has left: half the mean is its deviation. Our choice."""


@dataclass
class Tracked:
    """The existence of one object (section V).

    Attributes:
        who: its id and state.
        log_odds: of being an object rather than a false alarm, while not confirmed.
        measured: measurements cover its ellipse in this frame.
        own: enough of that is in no older object; else it shares it (occlusion).
        waited_s: time without measured area, half of the time without any of its own; it runs back twice as fast, since
            two ellipses on one person take turns at having some.
    """

    who: Existence
    log_odds: float
    measured: bool = True
    own: bool = True
    waited_s: float = 0.0


class EllipseParticleTracker(Carried):
    """Ellipses fitted to foreground, tracked by a particle filter without explicit association.

    Args:
        params: all parameters.
        camera: gives sizes, floor positions and heights; None leaves positions unknown and learns the size.
        seed: of the only random generator; one seed gives one result.
    """

    foreground_columns: int | None = COLUMNS
    CARRIED = (
        "_cycle", "_filter", "_objects", "_states", "_learner", "_learned", "_studied", "_image_size", "_shape",
        "_mask", "_measured",
    )  # fmt: skip

    def __init__(
        self, params: EllipseParticleParams | None = None, camera: GroundCamera | None = None, seed: int = 0
    ) -> None:
        self._params, self._camera, self._seed = params or EllipseParticleParams(), camera, seed
        height_px = self._params.size.person_height_px
        self._given = size_of_camera(camera) if camera is not None else None
        if height_px is not None:
            self._given = Size(height_px / 2, 0.0, 1.0, ASPECT)
        self._studied: tuple[Size, float] | None = None
        self.reset()

    def reset(self) -> None:
        """Forget people, sizes learned in tracking and the random state; ids start at 1 again."""
        self._cycle = LifeCycle()
        self._filter = ParticleFilter(self._params.filter, np.random.default_rng(self._seed))
        self._objects: list[Tracked] = []
        self._states: F64 = np.zeros((0, 7))
        self._learner = SizeLearner()
        self._learned = self._studied
        self._image_size: tuple[int, int] | None = None
        self._shape: tuple[int, int] | None = None
        self._mask: F32 | None = None
        self._measured: F64 = np.zeros((0, 5))

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""
        return self._cycle.decisions

    @property
    def notes(self) -> tuple[str, ...]:
        """The size of people that was learned, in a sentence."""
        if self._learned is None or self._given is not None or self._image_size is None:
            return ()
        size, share = self._learned
        length_px = 2.0 * float(size.half_lengths(np.array(self._image_size[0] / 2)))
        way = "high" if size.upright else "long"
        learned = f"assumed size of people: {length_px:.0f} px {way} in the middle of the image"
        alike = "" if share >= 0.5 else f", though only {share:.0%} of it has that size"
        other = "parameter ellipse_particle.size.person_height_px sets another"
        return (
            f"{learned}, the size of whatever moves here{alike}: other things of that size count as people ({other})",
        )

    def study(self, observations: Iterable[Observation]) -> None:
        """Learn the size of people from a recording's beginning, before its first frame is tracked; kept by ``reset``.

        The result then does not depend on which person comes first.
        """
        self.reset()
        if self._given is not None:
            return
        for observation in observations:
            if observation.timestamp_s > LEARN_S:
                break
            self._foreground(observation.views[0])
        self._learn()
        self._studied = self._learned

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame. Raises ValueError: the foreground is not (H, W) uint8.

        Returns:
            one state per object, tentative ones included; x, y, velocity and height are NaN without a camera.
        """
        dt_s = self._cycle.begin(observation.timestamp_s)
        if observation.unknown:
            return self._predicted(dt_s)
        view = observation.views[0]
        foreground = self._foreground(view)
        if foreground is None or self._image_size is None:
            return ()
        if self._learner.is_due:
            self._learn()
        size = self._size()
        if size is None:
            return ()
        if self._shape is None:
            self._shape = self._grid(size, foreground)
        size = size.on(self._scale)
        self._mask = np.asarray(_averaged(foreground, self._shape), dtype=np.float32) / np.float32(255)
        flooded = float(self._mask.mean()) > FLOODED
        moving = None if view.motion is None else _averaged(view.motion, self._shape) > 0

        self._predict(dt_s, size)
        self._measured = np.zeros((0, 5)) if flooded else fit_ellipses(self._mask, size)
        measured = painted(self._measured, self._shape)
        self._weigh(np.asarray(measured.any(axis=0), dtype=np.uint8), size)
        self._observe(measured, moving, dt_s, size)
        self._enter(measured, size)
        self._leave(size)
        return self._reported(size)

    def _reported(self, size: Size) -> tuple[TrackState, ...]:
        ellipses = ellipses_of(self._states, size)
        return tuple(self._state(t.who, e, s) for t, e, s in zip(self._objects, ellipses, self._states, strict=True))

    def _predicted(self, dt_s: float) -> tuple[TrackState, ...]:
        """Everybody where they were heading, in a frame that shows nothing."""
        size = self._size()
        if size is None or not self._objects:
            return ()
        size = size.on(self._scale)
        self._predict(dt_s, size)
        for t in self._objects:
            self._cycle.pause(t.who, dt_s)
        return self._reported(size)

    def _predict(self, dt_s: float, size: Size) -> None:
        self._filter.predict(dt_s, size, size.cells_per_m(self._states[:, Y]))
        self._states = np.asarray(self._filter.particles.mean(axis=0))

    def _weigh(self, union: U8, size: Size) -> None:
        """Weigh the objects that were measured in the last frame, one after the other.

        One that had none of its own keeps to its prediction, and is found again in ``_enter``: weighed with others it
        would slip onto their measurements, where it costs no area outside.
        """
        ellipses = ellipses_of(self._states, size)
        inside = painted(ellipses, union.shape)
        active = [n for n, t in enumerate(self._objects) if t.measured and t.own]
        for n in active:
            others = np.asarray(inside[[k for k in active if k != n]].any(axis=0), dtype=np.uint8)
            area = math.pi * ellipses[n, 2] * ellipses[n, 3]
            self._states[n] = self._filter.weigh(n, union, others, size, area)
            inside[n] = painted(ellipses_of(self._states[n : n + 1], size), union.shape)[0]

    def _observe(self, measured: U8, moving: Bool | None, dt_s: float, size: Size) -> None:
        """Which objects are measured in this frame, and the evidence on their existence.

        The number k of n frames in which a new object is measured is binomial, B(n, detection) for an object and
        B(n, repetition) for a false alarm; their ratio updates the odds.
        """
        p, union = self._params.existence, measured.any(axis=0)
        ellipses = ellipses_of(self._states, size)
        older = np.zeros(union.shape, np.bool_)
        for t, ellipse, inside in zip(self._objects, ellipses, painted(ellipses, union.shape) > 0, strict=True):
            area = max(float(inside.sum()), MIN_OVERLAP * math.pi * ellipse[2] * ellipse[3])
            covered, own = float((inside & union).sum()) / area, float((inside & union & ~older).sum()) / area
            older |= inside
            t.measured, t.own = covered >= MIN_OVERLAP, own >= MIN_OVERLAP
            if t.own:
                t.waited_s = max(0.0, t.waited_s - 2 * dt_s)
            else:
                t.waited_s += dt_s / 2 if t.measured else dt_s
            still = moving is not None and float((inside & moving).sum()) < p.moving * area
            if not t.who.confirmed and not (t.own and still):
                hit, miss = p.detection / p.repetition, (1 - p.detection) / (1 - p.repetition)
                t.log_odds += own * math.log(hit) + (1 - own) * math.log(miss)
                if t.own and t.log_odds >= math.log(p.probability / (1 - p.probability)):
                    self._cycle.confirm(t.who, f"log odds {t.log_odds:.2f}", t.log_odds)
            if t.own and t.waited_s == 0.0:
                again = f"measurements cover {covered:.2f} of it where it was predicted"
                self._cycle.observe(t.who, again if t.who.lost else "", covered)
            else:
                few = f"measurements cover {covered:.2f} < {MIN_OVERLAP:.2f} of it"
                self._cycle.miss(t.who, "older objects have what is measured of it" if t.measured else few, covered)

    def _enter(self, measured: U8, size: Size) -> None:
        """Measurements that overlap no object are objects that come back, or new ones.

        Each new one is an object with the same probability, so their number is binomial.
        """
        p = self._params.existence
        ellipses = ellipses_of(self._states, size)
        known = np.array([t.measured for t in self._objects], np.bool_)
        left = uncovered(measured, painted(ellipses[known], measured.shape[1:]), MIN_OVERLAP)
        per_m = size.cells_per_m(self._measured[:, 1])
        if left.any() and len(self._objects):
            away = np.hypot(*(self._measured[None, :, :2] - self._states[:, None, : Y + 1]).transpose(2, 0, 1)) / per_m
            spread = np.hypot(*self._filter.particles[..., : Y + 1].std(axis=0).T)[:, None] / per_m
            near = away <= np.minimum(REACH_M, BREADTH_M + 3.0 * spread)
            for n, m in sorted(np.argwhere(near).tolist(), key=lambda pair: float(away[tuple(pair)])):
                t = self._objects[n]
                if left[m] and not (t.measured and t.own):
                    left[m] = False
                    speed = self._params.filter.speed_mps * float(per_m[m]) / 2
                    self._filter.place(n, self._measured[m], size, self._states[n, VX : VY + 1], speed)
                    self._states[n] = self._filter.particles[:, n].mean(axis=0)
                    reason = f"measured {away[n, m]:.2f} m from its prediction after {t.waited_s:.1f} s"
                    t.measured, t.own, t.waited_s = True, True, 0.0
                    self._cycle.observe(t.who, reason, float(away[n, m]))
        for m in np.flatnonzero(left).tolist():
            self._filter.add(self._measured[m], size, float(per_m[m]))
            x, y = self._px(self._measured[m, :2])
            who = self._cycle.spawn(f"a measurement at ({x:.0f}, {y:.0f}) px overlaps no object")
            self._objects.append(Tracked(who, -math.log(p.false_alarms)))
            self._states = np.concatenate([self._states, self._filter.particles[:, -1].mean(axis=0)[None]])

    def _leave(self, size: Size) -> None:
        """Objects that have left: a Gamma distribution of the time without measurement, or their odds as tentative."""
        from scipy.special import gammainc  # a quarter of a second

        p, (rows, cols) = self._params.existence, self._shape or (0, 0)
        keep = []
        ellipses = ellipses_of(self._states, size)
        inside = painted(ellipses, (rows, cols)).sum(axis=(1, 2), dtype=np.int64) / (
            math.pi * ellipses[:, 2] * ellipses[:, 3]
        )
        for n, t in enumerate(self._objects):
            gone = float(gammainc(GAMMA_SHAPE, GAMMA_SHAPE * t.waited_s / p.patience_s))
            if not t.who.confirmed:
                gone = 1.0 / (1.0 + math.exp(min(t.log_odds, 500.0))) if t.waited_s > 0 else 0.0
            if inside[n] < MIN_OVERLAP:
                self._cycle.prune(t.who, "it has left the view")
            elif gone > p.probability:
                self._cycle.prune(t.who, f"unmeasured for {t.waited_s:.1f} s, left with probability {gone:.2f}", gone)
            else:
                keep.append(n)
        if len(keep) < len(self._objects):
            index = np.array(keep, dtype=np.int64)
            self._filter.keep(index)
            self._states, self._objects = self._states[index], [self._objects[n] for n in keep]

    def feedback(self) -> U8 | None:
        """(H, W) uint8, WALKER in the outlines of confirmed people who are measured; None before the first image."""
        size = self._size()
        if self._image_size is None:
            return None
        mask = np.zeros(self._image_size, dtype=np.uint8)
        if size is not None and self._shape is not None:
            for t, e in zip(self._objects, ellipses_of(self._states, size.on(self._scale)), strict=True):
                if t.who.confirmed and t.measured:
                    cv2.fillPoly(mask, [np.round(self._outline(e)).astype(np.int32)], WALKER)
        return mask

    def debug(self) -> TrackerDebug:
        """Measured ellipses, objects' ellipses with ids, a sample of the particles, the foreground grid as a tile."""
        size = self._size()
        if self._mask is None or size is None:
            return TrackerDebug()
        ids = tuple(str(t.who.track_id) for t in self._objects)
        shown = self._filter.particles[:: max(1, len(self._filter.particles) // 60), :, : Y + 1].reshape(-1, 2)
        objects = tuple(self._outline(e) for e in ellipses_of(self._states, size.on(self._scale)))
        return TrackerDebug(
            drawings=(
                Drawing("measurements", "image", tuple(self._outline(e) for e in self._measured)),
                Drawing("objects", "image", objects, ids),
                Drawing("particles", "image", tuple(p[None] for p in self._px(shown).astype(np.float32))),
            ),
            tiles={"foreground": self._mask},
        )

    def _size(self) -> Size | None:
        """The size known now, given by hand or by the camera or learned [px]."""
        return self._given if self._given is not None or self._learned is None else self._learned[0]

    def _foreground(self, view: View) -> U8 | None:
        """(h, w) uint8 foreground of a frame; what looks like a shadow speaks neither for nor against a person."""
        given, weight = view.foreground, BACKGROUND_WEIGHT
        if given is None:
            return None
        if given.ndim != 2 or given.dtype != np.uint8:
            raise ValueError(f"expected a (H, W) uint8 foreground, got {given.shape} {given.dtype}")
        height, width = given.shape if view.image is None else view.image.shape[:2]
        self._image_size = height, width
        if self._given is None and self._studied is None and given.mean() < 255 * FLOODED:
            self._learner.add(given, view.motion)
        unsure = np.uint8(round(255 * weight / (1 + weight)))
        return np.where(view.kind == SHADOW, unsure, given)

    def _learn(self) -> None:
        """The size by all frames so far."""
        if self._image_size is not None:
            found = self._learner.size()
            if found is not None:
                size, share = found
                self._learned = size.on(self._learner.n_cols / self._image_size[1]), share

    @property
    def _scale(self) -> float:
        """Pixels per cell."""
        assert self._image_size is not None and self._shape is not None  # there has been a frame
        return self._image_size[1] / self._shape[1]

    def _grid(self, size: Size, foreground: U8) -> tuple[int, int]:
        """Rows and columns of the grid on which a person in the middle row has the wanted length in cells."""
        assert self._image_size is not None
        height, width = self._image_size
        cell_px = 2.0 * float(size.half_lengths(np.array(height / 2))) / PERSON_CELLS
        n_cols = max(8, min(foreground.shape[1], round(width / cell_px)))
        return max(1, round(height * n_cols / width)), n_cols

    def _px(self, xy: F64) -> F64:
        """(..., 2) pixels of fractional cells."""
        return np.asarray(xy * self._scale + (self._scale - 1) / 2)

    def _outline(self, ellipse: F64) -> F32:
        """(33, 2) float32 closed outline [px]."""
        x, y, a, b, angle = ellipse
        turn = np.linspace(0, 2 * math.pi, 33)
        u, v, s, c = a * np.cos(turn), b * np.sin(turn), math.sin(angle), math.cos(angle)
        return self._px(np.column_stack([x + u * s + v * c, y + u * c - v * s])).astype(np.float32)

    def _state(self, who: Existence, ellipse: F64, state: F64) -> TrackState:
        """Box around the whole ellipse, parts hidden and outside the image included; with a camera also a place."""
        _, _, a, b, angle = ellipse
        s, c = math.sin(angle), math.cos(angle)
        half_width, half_height = self._scale * math.hypot(a * s, b * c), self._scale * math.hypot(a * c, b * s)
        x, y = self._px(ellipse[:2])
        box = float(x - half_width), float(y - half_height), 2 * half_width, 2 * half_height
        if self._camera is None:
            return TrackState(who.track_id, who.state, box_px=box)
        foot = np.array([x, y + half_height])
        here = self._camera.back_project(foot)
        vx, vy = self._camera.back_project(foot + state[VX : VY + 1] * self._scale) - here
        height = height_of(self._camera, here, float(y - half_height))
        return TrackState(who.track_id, who.state, float(here[0]), float(here[1]), float(vx), float(vy), height, box)


def _averaged(image: U8, shape: tuple[int, int]) -> U8:
    """(R, C) uint8 means of an image (h, w) over cells."""
    return np.asarray(cv2.resize(image, shape[::-1], interpolation=cv2.INTER_AREA), dtype=np.uint8)
