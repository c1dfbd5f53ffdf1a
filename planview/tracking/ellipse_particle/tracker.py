"""The tracker: detection, prediction, overlap likelihood, births and deaths."""

from __future__ import annotations

import math

import cv2
import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F32, F64, I64, U8, Bool
from planview import _ellipse_kernels as kernels
from planview.ellipses import SizePrior, fit_ellipses
from planview.foreground import PERSON
from planview.tracking.base import Decision, DecisionKind, Observation, TrackerDebug, TrackState
from planview.tracking.ellipse_particle.drawing import draw, outline
from planview.tracking.ellipse_particle.groups import group, overlaps
from planview.tracking.ellipse_particle.length import length_shown
from planview.tracking.ellipse_particle.life import Life, birth, gone, observe
from planview.tracking.ellipse_particle.newcomers import Newcomers
from planview.tracking.ellipse_particle.outputs import floor_state, image_state, measure_axes
from planview.tracking.ellipse_particle.params import EllipseParticleParams
from planview.tracking.ellipse_particle.particles import VX, VY, ParticleFilter, ellipses_of, normalised, union_prefix
from planview.tracking.ellipse_particle.planes import FloorPlane, ImagePlane, PlaneView, floor_prior, given_prior
from planview.tracking.ellipse_particle.size_learning import SizeLearner

NO_ELLIPSES: F64 = np.zeros((0, 5))
LONGEST_STEP_S = 1.0
"""A gap in the recording longer than this is predicted over as if it were this long [s]."""
REPLAYED = 10
"""Frames before the size was known that are tracked once it is; a bound on the time of that one frame. Our choice."""


class EllipseParticleTracker:
    """Ellipses fitted to foreground, tracked by a particle filter without explicit association.

    Works in the image plane, where it needs no calibration, or on the plan-view occupancy map.

    Args:
        params: all parameters; one seed gives one result.
        camera: image plane only: gives floor positions and heights; None leaves them unknown.
    """

    def __init__(self, params: EllipseParticleParams | None = None, camera: GroundCamera | None = None) -> None:
        self._params = params or EllipseParticleParams()
        self._camera = camera
        p = self._params
        self._fit = p.fit
        self._filter_params = p.filter
        if p.plane == "floor":
            apart = p.size.floor_separation_m / p.size.floor_half_length_m
            # Seen from above a body may point anywhere.
            self._fit = p.fit.model_copy(
                update={"angle_spread_deg": 45.0, "angle_limit_deg": 90.0, "separation": apart, "proposed_share": 1.0}
            )
            # Who is hidden leaves no occupancy, and is not to be drawn to those in front: equation (8) as it is.
            self._filter_params = p.filter.model_copy(update={"angle_spread_deg": 30.0, "outside_weight": 0.0})
        self._newcomers = Newcomers(p.newcomers, p.size.floor_separation_m)
        self._plane = FloorPlane(p.detection, p.size) if p.plane == "floor" else ImagePlane(p.detection)
        self.reset()

    def reset(self) -> None:
        """Forget people, background, sizes and the random state; ids start at 1 again."""
        self._rng = np.random.default_rng(self._params.seed)
        self._filter = ParticleFilter(self._filter_params, self._rng)
        self._learner = SizeLearner(self._params.size)
        self._plane.reset()
        self._lives: list[Life] = []
        self._states: F64 = np.zeros((0, 7))
        self._next_id = 1
        self._time: float | None = None
        self._view: PlaneView | None = None
        self._prior: SizePrior | None = None
        self._measured = NO_ELLIPSES
        self._unsized: list[tuple[float, PlaneView]] = []
        self._outlines: list[F32] = []
        self._shape: tuple[int, int] | None = None
        self._decisions: list[Decision] = []

    @property
    def decisions(self) -> tuple[Decision, ...]:
        return tuple(self._decisions)

    @property
    def prior(self) -> SizePrior | None:
        """Size expected of objects [cells], None while it is being learned."""
        return self._prior

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame.

        Returns:
            one state per object, tentative ones included; x, y, velocity and height are NaN in the image plane
            without a camera, the box is NaN on the floor.
        Raises:
            ValueError: the observation's arrays are not what they should be.
        """
        self._decisions = []
        dt = self._step(observation.timestamp_s)
        view = self._plane(observation)
        if observation.image is not None:
            self._shape = (observation.image.shape[0], observation.image.shape[1])
        self._resize(view)
        self._view = view
        if view is None:
            return ()
        unknown = self._prior is None
        self._measured = self._measure(view, observation)
        if self._prior is None:
            self._unsized = [*self._unsized, (dt, view)][-REPLAYED:]
            return ()
        if unknown:
            self._replay(self._prior, observation)
        self._follow(dt, view, self._prior, observation)
        self._outlines = self._people(view, self._prior)
        self._plane.protect(self._outlines)
        return tuple(self._output(view, observation))

    @property
    def needs_foreground(self) -> bool:
        """Only when the project's own foreground was asked for; else the tracker subtracts the background itself."""
        return self._params.plane == "image" and self._params.detection.source == "given"

    def feedback(self) -> U8 | None:
        """(H, W) uint8 for ``Foreground``: PERSON where somebody is who has been seen to move; None at first."""
        if self._shape is None:
            return None
        mask = np.zeros(self._shape, dtype=np.uint8)
        for shape in self._outlines:
            cv2.fillPoly(mask, [np.round(shape).astype(np.int32)], PERSON)
        return mask

    def debug(self) -> TrackerDebug:
        """Measured ellipses, object ellipses, particles, and the foreground grid as a tile."""
        if self._view is None or self._prior is None:
            return TrackerDebug()
        ids = [life.track_id for life in self._lives]
        plane = self._params.plane
        return draw(plane, self._view, self._prior, self._measured, self._states, ids, self._filter.particles)

    def _follow(self, dt: float, view: PlaneView, prior: SizePrior, observation: Observation) -> None:
        self._predict(dt, view, prior)
        self._filter_all(view, prior)
        self._judge(dt, view, prior, observation)

    def _replay(self, prior: SizePrior, observation: Observation) -> None:
        """Catch up with the frames that taught the size, so that who was there is believed as soon as it is known."""
        measured = self._measured
        for dt, view in self._unsized:
            flooded = float(view.mask.mean()) > self._params.detection.flooded
            self._measured = NO_ELLIPSES if flooded else fit_ellipses(view.mask, prior, self._fit)
            self._follow(dt, view, prior, observation)
        self._unsized, self._measured = [], measured

    def _step(self, time_s: float) -> float:
        dt = 0.0 if self._time is None else min(max(time_s - self._time, 0.0), LONGEST_STEP_S)
        self._time = time_s
        return dt

    def _resize(self, view: PlaneView | None) -> None:
        """A picture of another size is another scene: its objects cannot be carried over."""
        if view is None or self._view is None or view.mask.shape == self._view.mask.shape:
            return
        for life in self._lives:
            self._say(life.track_id, "removed", f"the frame size changed to {view.mask.shape} cells")
        self._keep(np.zeros(len(self._lives), dtype=np.bool_))
        self._learner = SizeLearner(self._params.size)
        self._prior = None
        self._unsized = []

    def _measure(self, view: PlaneView | None, observation: Observation) -> F64:
        if view is None or float(view.mask.mean()) > self._params.detection.flooded:
            return NO_ELLIPSES
        if self._params.plane == "floor":
            self._prior = floor_prior(self._params.size, view)
        else:
            given = given_prior(self._params.size, view)
            self._prior = given or self._learner.update(view.mask, observation.timestamp_s)
        if self._prior is None:
            return NO_ELLIPSES
        return fit_ellipses(view.mask, self._prior, self._fit)

    def _cells_per_m(self, view: PlaneView, prior: SizePrior, rows: F64) -> F64:
        if self._params.plane == "floor":
            return np.full(len(rows), 1.0 / view.scale)
        return np.asarray(2.0 * prior.half_lengths(rows) / self._params.size.object_length_m)

    def _predict(self, dt: float, view: PlaneView, prior: SizePrior) -> None:
        rows = self._states[:, 1]
        self._filter.predict(dt, self._cells_per_m(view, prior, rows))
        self._states = self._filter.means()

    def _filter_all(self, view: PlaneView, prior: SizePrior) -> None:
        """Weigh and resample the objects that were seen in the last frame.

        An object that was not seen keeps to its prediction here and is found again in ``_found``: weighed with others
        it would slip onto their measurements, where it costs no area outside. On the floor a newcomer, who may be a
        piece of somebody, has no say in where those stand who are believed.
        """
        seen = np.array([life.seen for life in self._lives], dtype=np.bool_)
        new = np.array([not life.confirmed for life in self._lives], dtype=np.bool_)
        if self._params.plane == "floor":
            self._filter_groups(np.flatnonzero(seen & ~new), view, prior)
            self._filter_groups(np.flatnonzero(seen & new), view, prior)
        else:
            self._filter_groups(np.flatnonzero(seen), view, prior)

    def _filter_groups(self, active: I64, view: PlaneView, prior: SizePrior) -> None:
        """Weigh and resample each group of these objects with the measurements within its reach."""
        if not len(active) or not len(self._measured):
            return
        ellipses = ellipses_of(self._states, prior)[active]
        margin = 1.5 * self._filter.deviations()[active]
        near = overlaps(ellipses, ellipses, margin)
        reached = overlaps(ellipses, self._measured, margin)
        for members, measured in group(near, reached, self._params.filter.joint):
            if not len(measured):
                continue
            chosen = active[members]
            prefix = union_prefix(self._measured[measured], view.mask.shape)
            area = float(np.mean(np.pi * ellipses[members, 2] * ellipses[members, 3]))
            favour: F64 = np.zeros(self._params.filter.particles)
            if len(chosen) > 1 and not self._params.filter.joint:
                shape, states = view.mask.shape, self._states[chosen]
                favour = self._filter.partition(chosen, self._measured[measured], states, shape, prior, area)
            log_likelihood = self._filter.weigh(chosen, prefix, prior, area)
            if self._params.plane == "floor":
                log_likelihood += self._filter.apart(chosen, self._params.size.floor_separation_m / view.scale)
            weights = normalised(log_likelihood - favour)
            self._states[chosen] = self._filter.estimate(chosen, log_likelihood, 0.5 * ellipses[members, 3], weights)
            self._filter.resample(chosen, log_likelihood - favour)

    def _judge(self, dt: float, view: PlaneView, prior: SizePrior, observation: Observation) -> None:
        """Seen or not, births, deaths."""
        shares = self._shares(view, prior)
        p = self._params.life
        long = self._long(view, prior)
        for n, (life, (covered, own)) in enumerate(zip(self._lives, shares, strict=True)):
            was = life.state
            self._watch_move(n, view, prior)
            life.age_s += dt
            seen, alone = bool(covered >= p.seen_overlap), bool(own >= p.seen_overlap and long[n])
            observe(life, seen, alone, dt, p, believable=life.confirmed or self._plausible(n, view, observation))
            if was != life.state:
                self._tell_state(life, covered)
        unexplained = self._unexplained(view, prior)
        for m in np.flatnonzero(unexplained):
            unexplained[m] = self._whole(view.to_plane(self._measured[m, :2]), view, observation)
        unexplained = self._found(unexplained, view, prior)
        unexplained &= self._long_enough(view, prior, unexplained)
        for ellipse in self._measured[unexplained]:
            if self._separate(view.to_plane(ellipse[:2]), view, observation):
                self._bear(ellipse, int(unexplained.sum()), view, prior)
        self._bury(view)

    def _long(self, view: PlaneView, prior: SizePrior) -> Bool:
        """(N,) whether so much of each object's length shows as a person does, in the image.

        Of those believed what they share with others counts as theirs; of the others it does not.
        """
        if self._params.plane == "floor":
            return np.ones(len(self._lives), dtype=np.bool_)
        ellipses, p = ellipses_of(self._states, prior), self._params.life
        new = length_shown(view.mask, ellipses, np.arange(len(ellipses)), prior) >= p.newcomer_length
        known = length_shown(view.mask, ellipses, None, prior) >= p.least_length
        return np.where([life.confirmed for life in self._lives], known, new)

    def _long_enough(self, view: PlaneView, prior: SizePrior, unexplained: Bool) -> Bool:
        """(M,) the same of the measurements, of which the unexplained are left what the others do not cover."""
        if self._params.plane == "floor":
            return np.ones(len(self._measured), dtype=np.bool_)
        order = np.argsort(unexplained, kind="stable")
        return length_shown(view.mask, self._measured, order, prior) >= self._params.life.newcomer_length

    def _whole(self, place: F64, view: PlaneView, observation: Observation) -> bool:
        """On the floor, whether a person stands at a place [m], no piece of one who is seen; in the image always."""
        maps = observation.maps if self._params.plane == "floor" else None
        return maps is None or self._newcomers.whole(maps, place, self._seen_at(view))

    def _separate(self, place: F64, view: PlaneView, observation: Observation) -> bool:
        """On the floor, whether a place [m] can be told apart from all who are seen; in the image always."""
        maps = observation.maps if self._params.plane == "floor" else None
        return maps is None or not self._newcomers.split_off(maps, place, self._seen_at(view))

    def _seen_at(self, view: PlaneView) -> F64:
        """(N, 2) where the believed people are who are seen [m]."""
        seen = [life.confirmed and life.seen for life in self._lives]
        return view.to_plane(self._states[:, :2])[seen]

    def _watch_move(self, n: int, view: PlaneView, prior: SizePrior) -> None:
        """An object has moved when its centre is half a length or a width from its birthplace."""
        life = self._lives[n]
        offset = self._states[n, :2] - life.birthplace
        a = prior.half_length(float(self._states[n, 1]))
        life.moved = life.moved or bool(np.hypot(offset[0] / (2 * a * prior.aspect), offset[1] / a) > 1.0)

    def _plausible(self, n: int, view: PlaneView, observation: Observation) -> bool:
        """Whether nothing but time speaks against believing an object."""
        place, life = view.to_plane(self._states[n, :2]), self._lives[n]
        if self._params.plane == "floor" and life.age_s < self._params.newcomers.confirm_s - 1e-9:
            return False
        return self._whole(place, view, observation) and self._separate(place, view, observation)

    def _tell_state(self, life: Life, covered: float) -> None:
        if life.state == "confirmed" and life.unseen_s == 0.0:
            self._say(life.track_id, "confirmed", f"probability {life.probability:.2f}", life.probability)
        elif life.state == "lost":
            limit = self._params.life.seen_overlap
            unseen = f"measurements cover {covered:.2f} < {limit:.2f} of it"
            self._say(life.track_id, "lost", "an older object covers it" if life.hidden else unseen, covered)

    def _shares(self, view: PlaneView, prior: SizePrior) -> F64:
        """(N, 2) share of each object's ellipse that is measured, and that is measured and in no older object."""
        ellipses = ellipses_of(self._states, prior)
        out = np.zeros((len(ellipses), 4))
        kernels.claim(union_prefix(self._measured, view.mask.shape), ellipses, np.arange(len(ellipses)), out)
        area = np.maximum(np.pi * ellipses[:, 2] * ellipses[:, 3], 1.0)
        return out[:, 1:3] / area[:, None]

    def _unexplained(self, view: PlaneView, prior: SizePrior) -> Bool:
        """(M,) measurements that the objects' ellipses leave uncovered."""
        seen = np.array([life.seen for life in self._lives], dtype=np.bool_)
        objects = union_prefix(ellipses_of(self._states, prior)[seen], view.mask.shape)
        out = np.zeros((len(self._measured), 4))
        kernels.claim(objects, self._measured, np.arange(len(self._measured)), out)
        return np.asarray(out[:, 1] < self._params.life.seen_overlap * np.maximum(out[:, 0], 1.0))

    def _found(self, unexplained: Bool, view: PlaneView, prior: SizePrior) -> Bool:
        """Give unexplained measurements to objects unseen so far, nearest first; returns what is left."""
        lost = [n for n, life in enumerate(self._lives) if not life.seen or life.hidden]
        left = unexplained.copy()
        deviations = self._filter.deviations()
        pairs = []
        for n in lost:
            for m in np.flatnonzero(unexplained).tolist():
                offset = self._measured[m, :2] - self._states[n, :2]
                per_m = float(self._cells_per_m(view, prior, self._measured[m : m + 1, 1])[0])
                away = float(np.hypot(*offset)) / per_m
                spread = float(np.hypot(*deviations[n])) / per_m
                if away <= min(self._params.life.reattach_m, 0.4 + 2.5 * spread):
                    pairs.append((away, n, m))
        for away, n, m in sorted(pairs):
            life = self._lives[n]
            if left[m] and (not life.seen or life.hidden):
                left[m] = False
                per_m = float(self._cells_per_m(view, prior, self._measured[m : m + 1, 1])[0])
                self._filter.place(n, self._measured[m], prior, per_m, self._states[n, [VX, VY]])
                self._states[n] = self._filter.particles[:, n].mean(axis=0)
                unseen = max(life.unseen_s, life.shared_s)
                life.seen, life.hidden, life.unseen_s, life.shared_s = True, False, 0.0, 0.0
                self._say(
                    life.track_id, "reattached", f"found {away:.2f} m from its prediction after {unseen:.1f} s", away
                )
        return left

    def _bear(self, ellipse: F64, unexplained: int, view: PlaneView, prior: SizePrior) -> None:
        per_m = float(self._cells_per_m(view, prior, ellipse[1:2])[0])
        self._filter.add(ellipse, prior, per_m)
        full, area = kernels.ellipse_sum(kernels.row_prefix(view.mask), *ellipse)
        place = (float(ellipse[0]), float(ellipse[1]))
        life = birth(self._next_id, place, full / max(area, 1.0), unexplained, self._params.life)
        self._next_id += 1
        self._lives.append(life)
        self._states = np.concatenate([self._states, self._filter.particles[:, -1].mean(axis=0)[None]])
        x, y = view.to_plane(ellipse[:2])
        self._say(life.track_id, "born", f"a measurement at ({x:.1f}, {y:.1f}) overlaps no object", life.probability)

    def _bury(self, view: PlaneView) -> None:
        """Remove objects that have left; outside the view at once, since nothing can be measured there."""
        rows, cols = view.mask.shape
        keep = np.ones(len(self._lives), dtype=np.bool_)
        for n, life in enumerate(self._lives):
            x, y = self._states[n, :2]
            probability = gone(life, self._params.life)
            limit = self._params.life.leave if life.confirmed else self._params.life.believe
            if not (-0.5 <= x <= cols - 0.5 and -0.5 <= y <= rows - 0.5) or not math.isfinite(x + y):
                keep[n] = False
                self._say(life.track_id, "removed", "its centre has left the view")
            elif probability > limit:
                keep[n] = False
                waited = max(life.unseen_s, life.shared_s)
                why = f"unseen or shared for {waited:.1f} s, left with probability {probability:.2f}"
                self._say(life.track_id, "removed", why, probability)
        self._keep(keep)

    def _keep(self, keep: Bool) -> None:
        if keep.all():
            return
        index = np.flatnonzero(keep)
        self._filter.remove(index.tolist())
        self._states = self._states[index]
        self._lives = [self._lives[i] for i in index]

    def _people(self, view: PlaneView, prior: SizePrior) -> list[F32]:
        """Outlines of objects that have proved to move; a ghost of the background never does, and is to be absorbed."""
        sure = [life.confirmed and life.seen and life.moved for life in self._lives]
        grown = ellipses_of(self._states, prior)[sure]
        grown[:, 2:4] *= 1.3
        return [outline(e, view) for e in grown]

    def _output(self, view: PlaneView, observation: Observation) -> list[TrackState]:
        assert self._prior is not None
        ellipses = ellipses_of(self._states, self._prior)
        if observation.maps is not None and self._params.plane == "floor":
            measure_axes(self._lives, view, ellipses, observation.maps, self._params.size.floor_reach_m)
        rows = []
        for life, state, ellipse in zip(self._lives, self._states, ellipses, strict=True):
            velocity = state[[VX, VY]] * view.scale
            if self._params.plane == "floor":
                rows.append(floor_state(life, view, ellipse, velocity))
            else:
                rows.append(image_state(life, view, ellipse, velocity, self._camera))
        return rows

    def _say(self, track_id: int, kind: DecisionKind, reason: str, value: float = math.nan) -> None:
        self._decisions.append(Decision(track_id, kind, reason, value))
