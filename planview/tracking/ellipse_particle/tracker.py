"""The tracker of section III to V: measure, predict, weigh by overlap, judge existence."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from pydantic import Field

from calib.carried import Carried
from calib.ground_camera import GroundCamera
from calib.params import Params
from calib.types import F32, F64, U8, Bool
from planview.foreground.params import WALKER
from planview.maps.view import SHADED, View
from planview.tracking import odds
from planview.tracking.base import Decision, Drawing, Existence, LifeCycle, Needs, Observation, TrackerDebug
from planview.tracking.ellipse_particle.fit import BACKGROUND_WEIGHT, find_uncovered, fit_ellipses, paint
from planview.tracking.ellipse_particle.particles import VX, VY, ParticleFilter, Y, ellipses_of
from planview.tracking.ellipse_particle.size import ASPECT, BREADTH_M, Size, SizeLearner, height_of, size_of_camera
from planview.trajectories.state import TrackState

FOREGROUND_COLUMNS = 320
"""Columns of foreground that are enough [px]. Our choice; it bounds the time per frame."""
PERSON_CELLS = 28.0
"""Cells of the grid, at least a pixel of foreground each, along a person in the middle row. Our choice: legs are a
cell wide, and an ellipse takes the same time whatever the image."""
LEARN_S = 60.0
"""Time over which the size is learned [s]: the first minute of a recording, before it is tracked."""
MIN_OVERLAP = 0.35
"""Share of an object's ellipse that measurements must cover to count as measured; a measurement of which objects
cover less than this share is uncovered. Our choice."""
FOUND_AGAIN_M = 1.5
"""Farthest a lost object is found again from its prediction [m]. Harville 2002 uses 2 m from the last sight."""
FLOODED = 0.5
"""Share of foreground above which a frame measures and teaches nothing (a light was switched, the camera moved)."""
GAMMA_SHAPE = 4.0
"""Shape of the Gamma distribution of the time after which an object has left: half the mean is its deviation. Our
choice."""


class EllipseSizeParams(Params):
    """Size of people in the image."""

    person_height_px: float | None = Field(None, ge=4, le=20_000)
    """Height of a person in the image [px], the same in all rows; None learns it, row by row."""


class ParticleFilterParams(Params):
    """The particle filter of sections III and IV."""

    particles: int = Field(1000, ge=10, le=20_000)
    """Hypotheses N_s of equation (9). Our choice."""
    speed_mps: float = Field(1.2, gt=0, le=20)
    """Deviation of each velocity component of a new object [m/s]: walking speed."""


class ExistenceParams(Params):
    """When an object exists and when it has left (section V)."""

    false_alarms: float = Field(2.0, gt=0, le=1000)
    """Expected false measurements for each object that enters, the parameter of the binomial. Our choice."""
    detection: float = Field(0.85, gt=0, lt=1)
    """Probability of measuring a present object. Our choice."""
    repetition: float = Field(0.4, gt=0, lt=1)
    """Probability that a false measurement repeats in the same place. Our choice: legs that come into view before the
    body repeat for some frames; a person counted twice is worse than 0.2 s of delay."""
    probability: float = Field(0.8, gt=0.5, lt=1)
    """Probability of being an object, above which a new one is confirmed, and of having left, above which it is
    pruned."""
    moving: float = Field(0.05, ge=0, lt=1)
    """Share of an object's ellipse that must move in a frame which speaks for a new object: limbs and edges of a walker
    do; where a person of the first frames has left, nothing does. Our choice."""
    patience_s: float = Field(2.0, gt=0, le=600)
    """Mean N_t of the Gamma distribution: time without measurement after which an object has left [s]; twice as long
    where it shares its measurement with an older one (occlusion). Our choice."""


class EllipseParticleParams(Params):
    """All parameters of ``EllipseParticleTracker``."""

    size: EllipseSizeParams = EllipseSizeParams()
    """Sizes."""
    filter: ParticleFilterParams = ParticleFilterParams()
    """Particles."""
    existence: ExistenceParams = ExistenceParams()
    """When objects exist."""


@dataclass
class TrackedEllipse:
    """The existence of one object (section V).

    Attributes:
        existence: its id and state.
        log_odds: of being an object rather than a false alarm, while not confirmed.
        measured: measurements cover its ellipse in this frame.
        own: enough of that is in no older object; else it shares it (occlusion).
        waited_s: time without measured area, half of the time without any of its own; it runs back twice as fast, since
            two ellipses on one person take turns at having some.
    """

    existence: Existence
    log_odds: float
    measured: bool = True
    own: bool = True
    waited_s: float = 0.0

    def wait(self, dt_s: float) -> None:
        """Let time pass in which it was measured, shared its measurement, or was not measured."""
        if self.own:
            self.waited_s = max(0.0, self.waited_s - 2 * dt_s)
        else:
            self.waited_s += dt_s / 2 if self.measured else dt_s


class EllipseParticleTracker(Carried):
    """Ellipses fitted to foreground, tracked by a particle filter without explicit association.

    Args:
        params: all parameters.
        camera: gives sizes, floor positions and heights; None leaves positions unknown and learns the size.
        seed: of the only random generator; one seed gives one result.
    """

    needs: Needs = "image"
    foreground_columns: int | None = FOREGROUND_COLUMNS
    CARRIED = (
        "_life", "_filter", "_objects", "_states", "_learner", "_size_px", "_studied", "_image_size", "_shape",
        "_mask", "_measured",
    )  # fmt: skip
    RECORDS = TrackedEllipse, Existence, Size

    def __init__(
        self, params: EllipseParticleParams | None = None, camera: GroundCamera | None = None, seed: int = 0
    ) -> None:
        self._params = params or EllipseParticleParams()
        self._camera = camera
        self._seed = seed
        size = None
        if self._params.size.person_height_px is not None:
            size = Size(self._params.size.person_height_px / 2, 0.0, 1.0, ASPECT)
        elif camera is not None:
            size = size_of_camera(camera)
        self._size_is_given = size is not None
        self._studied: tuple[Size, float] | None = None if size is None else (size, 1.0)
        self.reset()

    def reset(self) -> None:
        """Forget people, sizes learned in tracking and the random state; ids start at 1 again."""
        p = self._params.filter
        self._life = LifeCycle()
        self._filter = ParticleFilter(p.particles, p.speed_mps, np.random.default_rng(self._seed))
        self._objects: list[TrackedEllipse] = []
        self._states: F64 = np.zeros((0, 7))
        self._learner = SizeLearner()
        self._size_px = self._studied
        self._image_size = (0, 0)
        self._shape = (0, 0)
        self._mask: F32 | None = None
        self._measured: F64 = np.zeros((0, 5))

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""
        return self._life.decisions

    @property
    def notes(self) -> tuple[str, ...]:
        """The size of people that was learned, in a sentence."""
        if self._size_is_given or self._size_px is None or self._image_size == (0, 0):
            return ()
        size, share = self._size_px
        length_px = 2.0 * float(size.half_lengths(np.array(self._image_size[0] / 2)))
        along = "high" if size.upright else "long"
        alike = "" if share >= 0.5 else f", though only {share:.0%} of it has that size"
        return (
            f"assumed size of people: {length_px:.0f} px {along} in the middle of the "
            f"image, the size of whatever moves here{alike}: other things of that size count as people (parameter "
            "ellipse_particle.size.person_height_px sets another)",
        )

    def study(self, observations: Iterable[Observation]) -> None:
        """Learn the size of people from a recording's beginning, before its first frame is tracked; kept by ``reset``.

        The result then does not depend on which person comes first.
        """
        self.reset()
        if self._size_is_given:
            return
        for observation in observations:
            if observation.timestamp_s > LEARN_S:
                break
            self._foreground(observation.views[0])
        self._learn()
        self._studied = self._size_px

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame. Raises ValueError: the foreground is not (H, W) uint8.

        Returns:
            one state per object, tentative ones included; x, y, velocity and height are NaN without a camera.
        """
        dt_s = self._life.begin(observation.timestamp_s)
        if observation.unknown:
            return self._pause(dt_s)
        view = observation.views[0]
        foreground = self._foreground(view)
        if foreground is None:
            return ()
        if self._learner.is_due:
            self._learn()
        if self._size_px is None:
            return ()
        if self._shape == (0, 0):
            self._shape = self._choose_grid(self._size_px[0], foreground)
        size = self._size_px[0].on(self._scale)
        self._mask = np.asarray(_shrink(foreground, self._shape), dtype=np.float32) / np.float32(255)
        flooded = float(self._mask.mean()) > FLOODED
        moving = None if view.motion is None else _shrink(view.motion, self._shape) > 0

        self._predict(dt_s, size)
        self._measured = np.zeros((0, 5)) if flooded else fit_ellipses(self._mask, size)
        measured = paint(self._measured, self._shape)
        self._weigh(np.asarray(measured.any(axis=0), dtype=np.uint8), size)
        self._observe(measured, moving, dt_s, size)
        self._enter(measured, size)
        self._leave(size)
        return self._report()

    def _pause(self, dt_s: float) -> tuple[TrackState, ...]:
        """Everybody where they were heading, in a frame that shows nothing."""
        if self._size_px is not None and self._objects:
            self._predict(dt_s, self._size_px[0].on(self._scale))
        for tracked in self._objects:
            self._life.pause(tracked.existence, dt_s)
        return self._report()

    def _predict(self, dt_s: float, size: Size) -> None:
        self._filter.predict(dt_s, size, size.cells_per_m(self._states[:, Y]))
        self._states = np.asarray(self._filter.particles.mean(axis=0))

    def _report(self) -> tuple[TrackState, ...]:
        existences = [tracked.existence for tracked in self._objects]
        return tuple(map(self._state, existences, self._ellipses(), self._states))

    def _ellipses(self) -> F64:
        """(N, 5) of all objects [cells]."""
        if self._size_px is None or not self._objects:
            return np.zeros((0, 5))
        return ellipses_of(self._states, self._size_px[0].on(self._scale))

    def _weigh(self, union: U8, size: Size) -> None:
        """Weigh the objects that were measured in the last frame, one after the other.

        One that had none of its own keeps to its prediction, and is found again in ``_enter``: weighed with others it
        would slip onto their measurements, where it costs no area outside.
        """
        ellipses = ellipses_of(self._states, size)
        inside = paint(ellipses, union.shape)
        active = [n for n, tracked in enumerate(self._objects) if tracked.measured and tracked.own]
        for n in active:
            rest = [k for k in active if k != n]
            others = np.asarray(inside[rest].any(axis=0), dtype=np.uint8)
            area = math.pi * ellipses[n, 2] * ellipses[n, 3]
            state = self._filter.weigh(n, union, others, size, area)
            self._states[n] = state
            inside[n] = paint(ellipses_of(state[None], size), union.shape)[0]

    def _observe(self, measured: U8, moving: Bool | None, dt_s: float, size: Size) -> None:
        """Find the objects that are measured in this frame, and add the evidence on their existence."""
        union = measured.any(axis=0)
        ellipses = ellipses_of(self._states, size)
        masks = paint(ellipses, union.shape) > 0
        older = np.zeros(union.shape, np.bool_)
        for tracked, ellipse, inside in zip(self._objects, ellipses, masks, strict=True):
            area = max(float(inside.sum()), MIN_OVERLAP * math.pi * ellipse[2] * ellipse[3])
            covered = float((inside & union).sum()) / area
            own = float((inside & union & ~older).sum()) / area
            older |= inside
            tracked.measured = covered >= MIN_OVERLAP
            tracked.own = own >= MIN_OVERLAP
            tracked.wait(dt_s)
            still = moving is not None and float((inside & moving).sum()) < self._params.existence.moving * area
            if not tracked.existence.confirmed and not (tracked.own and still):
                self._count_evidence(tracked, own)
            self._note_measurement(tracked, covered)

    def _count_evidence(self, tracked: TrackedEllipse, own: float) -> None:
        """Add the evidence of a frame in which a new object's ellipse has a share of measured area of its ``own``.

        The number k of n frames in which a new object is measured is binomial, B(n, detection) for an object and
        B(n, repetition) for a false alarm; their ratio updates the odds.
        """
        p = self._params.existence
        hit = p.detection / p.repetition
        miss = (1 - p.detection) / (1 - p.repetition)
        tracked.log_odds += own * math.log(hit) + (1 - own) * math.log(miss)
        if tracked.own and tracked.log_odds >= odds.log_odds(p.probability):
            self._life.confirm(tracked.existence, f"log odds {tracked.log_odds:.2f}", tracked.log_odds)

    def _note_measurement(self, tracked: TrackedEllipse, covered: float) -> None:
        """Write down that an object is observed, or missed."""
        if tracked.own and tracked.waited_s == 0.0:
            reason = f"measurements cover {covered:.2f} of it where it was predicted"
            self._life.observe(tracked.existence, reason if tracked.existence.lost else "", covered)
            return
        reason = f"measurements cover {covered:.2f} < {MIN_OVERLAP:.2f} of it"
        if tracked.measured:
            reason = "older objects have what is measured of it"
        self._life.miss(tracked.existence, reason, covered)

    def _enter(self, measured: U8, size: Size) -> None:
        """Take measurements that overlap no object for objects that come back, or new ones.

        Each new one is an object with the same probability, so their number is binomial.
        """
        observed = np.array([tracked.measured for tracked in self._objects], np.bool_)
        objects = paint(ellipses_of(self._states, size)[observed], measured.shape[1:])
        left = find_uncovered(measured, objects, MIN_OVERLAP)
        if left.any() and self._objects:
            self._find_again(left, size)
        for m in np.flatnonzero(left).tolist():
            self._filter.add(self._measured[m], size)
            x, y = self._px(self._measured[m, :2])
            existence = self._life.spawn(f"a measurement at ({x:.0f}, {y:.0f}) px overlaps no object")
            log_odds = -math.log(self._params.existence.false_alarms)
            self._objects.append(TrackedEllipse(existence, log_odds))
            state = self._filter.particles[:, -1].mean(axis=0)
            self._states = np.vstack([self._states, state])

    def _find_again(self, left: Bool, size: Size) -> None:
        """Continue objects at the nearest measurements that are ``left``, which are then no longer."""
        per_m = size.cells_per_m(self._measured[:, 1])
        steps = self._measured[None, :, :2] - self._states[:, None, : Y + 1]
        away = np.hypot(steps[..., 0], steps[..., 1]) / per_m
        deviation = self._filter.particles[..., : Y + 1].std(axis=0)
        spread = np.hypot(deviation[:, 0], deviation[:, 1])[:, None] / per_m
        near = np.argwhere(away <= np.minimum(FOUND_AGAIN_M, BREADTH_M + 3.0 * spread))
        for n, m in sorted(near.tolist(), key=lambda pair: float(away[tuple(pair)])):
            tracked = self._objects[n]
            if not left[m] or (tracked.measured and tracked.own):
                continue
            left[m] = False
            self._filter.find_again(n, self._measured[m], size, self._states[n, VX : VY + 1])
            self._states[n] = self._filter.particles[:, n].mean(axis=0)
            reason = f"measured {away[n, m]:.2f} m from its prediction after {tracked.waited_s:.1f} s"
            tracked.measured = True
            tracked.own = True
            tracked.waited_s = 0.0
            self._life.observe(tracked.existence, reason, float(away[n, m]))

    def _leave(self, size: Size) -> None:
        """End objects that have left: a Gamma distribution of the time without measurement, or their odds as
        tentative."""
        ellipses = ellipses_of(self._states, size)
        cells = paint(ellipses, self._shape).sum(axis=(1, 2), dtype=np.int64)
        inside = cells / (math.pi * ellipses[:, 2] * ellipses[:, 3])
        kept = []
        for n, tracked in enumerate(self._objects):
            gone = self._gone(tracked)
            if inside[n] < MIN_OVERLAP:
                self._life.prune(tracked.existence, "it has left the view")
            elif gone > self._params.existence.probability:
                reason = f"unmeasured for {tracked.waited_s:.1f} s, left with probability {gone:.2f}"
                self._life.prune(tracked.existence, reason, gone)
            else:
                kept.append(n)
        if len(kept) < len(self._objects):
            index = np.array(kept, dtype=np.int64)
            self._filter.keep(index)
            self._states = self._states[index]
            self._objects = [self._objects[n] for n in kept]

    def _gone(self, tracked: TrackedEllipse) -> float:
        """Probability that an object has left, or has never been one."""
        from scipy.special import gammainc  # a quarter of a second

        if tracked.existence.confirmed:
            patience_s = self._params.existence.patience_s
            return float(gammainc(GAMMA_SHAPE, GAMMA_SHAPE * tracked.waited_s / patience_s))
        if tracked.waited_s <= 0:
            return 0.0
        return odds.probability(-min(tracked.log_odds, 500.0))

    def feedback(self) -> U8 | None:
        """(H, W) uint8, WALKER in the outlines of confirmed people who are measured; None before the first image."""
        if self._image_size == (0, 0):
            return None
        mask = np.zeros(self._image_size, dtype=np.uint8)
        for tracked, ellipse in zip(self._objects, self._ellipses(), strict=True):
            if tracked.existence.confirmed and tracked.measured:
                cv2.fillPoly(mask, [np.round(self._outline(ellipse)).astype(np.int32)], WALKER)
        return mask

    def debug(self) -> TrackerDebug:
        """Measured ellipses, objects' ellipses with ids, a sample of the particles, the foreground grid as a tile."""
        if self._mask is None:
            return TrackerDebug()
        ids = tuple(str(tracked.existence.track_id) for tracked in self._objects)
        every = max(1, len(self._filter.particles) // 60)
        particles = self._px(self._filter.particles[::every, :, : Y + 1].reshape(-1, 2)).astype(np.float32)
        drawings = (
            Drawing("measurements", "image", tuple(map(self._outline, self._measured))),
            Drawing("objects", "image", tuple(map(self._outline, self._ellipses())), ids),
            Drawing("particles", "image", tuple(particle[None] for particle in particles)),
        )
        return TrackerDebug(drawings, {"foreground": self._mask})

    def _foreground(self, view: View) -> U8 | None:
        """(h, w) uint8 foreground of a frame; what looks like a shadow speaks neither for nor against a person."""
        foreground = view.foreground
        if foreground is None:
            return None
        height, width = foreground.shape if view.image is None else view.image.shape[:2]
        self._image_size = height, width
        if self._studied is None and foreground.mean() < 255 * FLOODED:
            self._learner.add(foreground, view.motion)
        unsure = np.uint8(round(255 * BACKGROUND_WEIGHT / (1 + BACKGROUND_WEIGHT)))
        return np.where(view.kind == SHADED, unsure, foreground)

    def _learn(self) -> None:
        """Learn the size from all frames so far."""
        self._size_px = self._learner.size(self._image_size[1]) or self._size_px

    @property
    def _scale(self) -> float:
        """Pixels per cell, once there has been a frame."""
        return self._image_size[1] / self._shape[1]

    def _choose_grid(self, size: Size, foreground: U8) -> tuple[int, int]:
        """Rows and columns of the grid on which a person in the middle row has the required length in cells."""
        height, width = self._image_size
        cell_px = 2.0 * float(size.half_lengths(np.array(height / 2))) / PERSON_CELLS
        n_cols = max(8, min(foreground.shape[1], round(width / cell_px)))
        return max(1, round(height * n_cols / width)), n_cols

    def _px(self, xy: F64) -> F64:
        """(..., 2) pixels of fractional cells."""
        return xy * self._scale + (self._scale - 1) / 2

    def _outline(self, ellipse: F64) -> F32:
        """(33, 2) float32 closed outline [px]."""
        x, y, a, b, angle = ellipse
        turn = np.linspace(0, 2 * math.pi, 33)
        u = a * np.cos(turn)
        v = b * np.sin(turn)
        s = math.sin(angle)
        c = math.cos(angle)
        return self._px(np.column_stack([x + u * s + v * c, y + u * c - v * s])).astype(np.float32)

    def _state(self, existence: Existence, ellipse: F64, state: F64) -> TrackState:
        """Report an object: a box around the whole ellipse, parts hidden and outside the image included; with a camera
        also a place."""
        _, _, a, b, angle = ellipse
        s = math.sin(angle)
        c = math.cos(angle)
        half_width = self._scale * math.hypot(a * s, b * c)
        half_height = self._scale * math.hypot(a * c, b * s)
        x, y = self._px(ellipse[:2])
        top = float(y - half_height)
        box = float(x - half_width), top, 2 * half_width, 2 * half_height
        if self._camera is None:
            return TrackState(existence.track_id, existence.state, box_px=box)
        foot = np.array([x, y + half_height])
        here = self._camera.back_project(foot)
        ahead = self._camera.back_project(foot + state[VX : VY + 1] * self._scale)
        x_m, y_m = here.tolist()
        vx_mps, vy_mps = (ahead - here).tolist()
        height_m = height_of(self._camera, here, top)
        std_m = self._camera.std_m(x_m, y_m)
        motion = x_m, y_m, vx_mps, vy_mps
        return TrackState(existence.track_id, existence.state, *motion, height_m, box, std_m=std_m)


def _shrink(image: U8, shape: tuple[int, int]) -> U8:
    """(R, C) uint8 means of an image (h, w) over cells."""
    return np.asarray(cv2.resize(image, shape[::-1], interpolation=cv2.INTER_AREA), dtype=np.uint8)
