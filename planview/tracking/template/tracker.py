"""People explained jointly: every pixel of surface and of seen background by the nearest person in front of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.types import F32, F64, I64
from planview.maps.colour import CODES
from planview.maps.pixels import SeenPixels
from planview.tracking import body
from planview.tracking.base import Decision, Observation, TrackerDebug
from planview.tracking.kalman import FloorKalman, PositionNoise
from planview.tracking.template import _kernels as kernels
from planview.tracking.template.params import TemplateParams
from planview.tracking.template.person import Person, colour_ratios, learn_colours
from planview.trajectories.state import TrackState

STEPS = np.array([0.12, 0.06, 0.03])
MAX_SAMPLES = 4000
SPACING_M = 0.05
"""Between samples on a body [m]: half a patch."""


class Samples:
    """The samples around one person, from all cameras, and the layers of other people on their rays."""

    def __init__(self) -> None:
        k = kernels.LAYERS
        self.values = np.zeros((MAX_SAMPLES, kernels.SAMPLE_FIELDS), np.float32)
        self.kinds = np.zeros(MAX_SAMPLES, np.uint8)
        self.codes = np.zeros(MAX_SAMPLES, np.uint8)
        self.angles = np.zeros(MAX_SAMPLES, np.int64)
        self.n = 0
        self.layers = (
            np.zeros((MAX_SAMPLES, k), np.float32),
            np.zeros((MAX_SAMPLES, k + 1), np.float32),
            np.zeros((MAX_SAMPLES, k + 1), np.float32),
            np.zeros((MAX_SAMPLES, k + 1), np.float32),
            np.zeros(MAX_SAMPLES, np.int64),
        )


class TemplateTracker:
    """Follows people by the joint likelihood of all pixels (see ``docs/method.md``)."""

    def __init__(self, params: TemplateParams | None = None) -> None:
        self.params = p = params or TemplateParams()
        table = body.body_table()
        self._cover, self._front = table.cover, table.front
        self._beliefs = kernels.Beliefs(
            p.outliers, p.seen_on_body, p.seen_on_background, p.seen_near_people, p.no_depth, p.range_m, p.unknown,
            p.surface_std_m**2, p.colour_weight, body.TORSO.height_m, body.REACH_M,
            0.95 * body.APART_M, p.low_share, table.angle_min_rad,
            table.angle_step_rad, table.cell_m, table.w_min_m,
        )  # fmt: skip
        self._pool: list[Samples] = []
        self.reset()

    def reset(self) -> None:
        self._people: list[Person] = []
        self._departed: list[Person] = []
        self._next = 1
        self._now_s = math.nan
        self._exchange: dict[tuple[int, int], float] = {}
        self.decisions: tuple[Decision, ...] = ()
        self._log: list[Decision] = []
        self.owners: list[I64] = []

    def debug(self) -> TrackerDebug:
        return TrackerDebug()

    # -- one frame -----------------------------------------------------------------------------------------------
    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        views = observation.views
        dt = 0.0 if math.isnan(self._now_s) else max(observation.timestamp_s - self._now_s, 0.0)
        self._now_s = observation.timestamp_s
        self._log = []
        self._coloured = all(v.colour is not None for v in views) and self.params.colour_weight > 0
        for person in self._people:
            self._predict(person, dt)
        if self._people:
            self._explain(views, dt)
        self._share_out(views, dt)
        self._remove()
        self._births(views, dt)
        self._confirm()
        self.decisions = tuple(self._log)
        return tuple(self._state(p) for p in self._people)

    def _predict(self, person: Person, dt: float) -> None:
        p = self.params
        if person.share < 0.15:
            person.kalman = person.kalman.slowed(dt, p.slow_down_s)
        person.kalman = person.kalman.predicted(dt, p.acceleration_mps2)
        person.height_var += p.height_change_mps**2 * dt * min(dt, p.errors_s) + 1e-6

    def _poses(self) -> F64:
        return np.array([(*p.at_m, p.height_m) for p in self._people]).reshape(-1, 3)

    def _explain(self, views: Sequence[SeenPixels], dt: float) -> None:
        """Coordinate ascent of all people, then what each look says of its place and existence."""
        people, p = self._people, self.params
        predicted = self._poses()
        poses = predicted.copy()
        ratios = self._ratios()
        touch = self._touching(views, poses)
        camera = views[0].rays.centre_m
        order = np.argsort(np.hypot(poses[:, 0] - camera[0], poses[:, 1] - camera[1]))
        while len(self._pool) < len(people):
            self._pool.append(Samples())
        for i in range(len(people)):
            self._gather(self._pool[i], views, poses[i], 0.3)
        infos = [self._information(q) for q in people]
        for sweep in range(2):
            for i in order:
                others = np.flatnonzero(touch[i])
                if sweep and len(others) <= 1:
                    continue
                self._ascend(i, poses, predicted, infos[i], ratios, others)
        flooded = all((v.kind > 0).mean() > 0.5 for v in views)
        for i, person in enumerate(people):
            self._measure(i, person, poses, predicted, ratios, np.flatnonzero(touch[i]), dt, flooded, views)

    def _sure(self, n: int) -> F64:
        """(n,) probabilities of existence; newcomers beyond the known people are taken as sure."""
        sure = np.ones(n)
        sure[: len(self._people)] = [q.existence for q in self._people][:n]
        return sure

    def _apart(self, poses: F64, others: I64, skip: int) -> F64:
        """(K, 3) places of others and how surely they exist."""
        chosen = [k for k in others if k != skip]
        return np.column_stack([poses[chosen, :2], self._sure(len(poses))[chosen]]).reshape(-1, 3)

    def _ratios(self) -> F32:
        if not self._coloured:
            return np.ones((max(len(self._people), 1), kernels.PARTS, CODES), np.float32)
        return colour_ratios(self._people)

    def _gather(self, samples: Samples, views: Sequence[SeenPixels], pose: F64, reach_m: float) -> None:
        p, n = self.params, 0
        for v in views:
            r = v.rays
            colour = v.colour if v.colour is not None else v.kind
            std = p.disparity_std_px / r.disparity_metre
            n = kernels.gather(
                pose, reach_m, SPACING_M, p.patch_m, r.centre_m, r.direction, r.stretch, r.projection, r.pixel_sr,
                v.kind, v.range_m, colour, std, samples.values, samples.kinds, samples.codes, samples.angles, n,
                self._beliefs,
            )  # fmt: skip
        samples.n = n

    def _information(self, person: Person) -> F64:
        k = person.kalman
        xx, xy, yy = k.c_xx + 1e-4, k.c_xy, k.c_yy + 1e-4
        det = xx * yy - xy * xy
        return np.array([yy / det, -xy / det, xx / det])

    def _layer(self, samples: Samples, poses: F64, ratios: F32, others: I64, skip: int) -> None:
        kernels.layer(
            samples.values, samples.kinds, samples.codes, samples.angles, samples.n, poses, self._sure(len(poses)), ratios, others, skip,
            self._cover, self._front, self._beliefs, *samples.layers,
        )  # fmt: skip

    def _ascend(self, i: int, poses: F64, predicted: F64, info: F64, ratios: F32, others: I64) -> tuple[float, float]:
        s = self._pool[i] if i < len(self._pool) else Samples()
        self._layer(s, poses, ratios, others, i)
        apart = self._apart(poses, others, i)
        return kernels.ascend(
            poses[i], predicted[i], info, 1.0 / self._people[i].height_var, *self._people[i].upright, apart, STEPS, np.array([body.HEIGHT_MIN_M, body.HEIGHT_MAX_M]), s.values, s.kinds, s.codes,
            s.angles, s.n, ratios[i], self._cover, self._front, self._beliefs, *s.layers,
        )  # fmt: skip

    def _lam(self, s: Samples, x: float, y: float, h: float, ratio: F32) -> float:
        return kernels.evaluate(
            x, y, h, s.values, s.kinds, s.codes, s.angles, s.n, ratio, self._cover, self._front, self._beliefs,
            *s.layers,
        )  # fmt: skip

    def _visible(self, s: Samples, pose: F64, ratio: F32) -> tuple[float, float]:
        mine, total = kernels.visible(
            pose, s.values, s.kinds, s.codes, s.angles, s.n, ratio, self._cover, self._front, self._beliefs, *s.layers
        )
        return mine, total

    def _measure(
        self, i: int, person: Person, poses: F64, predicted: F64, ratios: F32, others: I64, dt: float, flooded: bool,
        views: Sequence[SeenPixels],
    ) -> None:  # fmt: skip
        p, s = self.params, self._pool[i]
        self._layer(s, poses, ratios, others, i)
        x, y, h = poses[i]
        lam = self._lam(s, x, y, h, ratios[i])
        apart = self._apart(poses, others, i)
        evidence = lam + kernels.believed(x, y, h, *person.upright, apart, self._beliefs)
        rival = self._rival(i, poses)
        if rival >= 0:
            evidence = min(evidence, self._beside(i, rival, poses, ratios, others))
        mine, total = self._visible(s, poses[i], ratios[i])
        full = self._full_patches(views, poses[i])
        person.inside = min(1.0, total / full) if full > 0 else 0.0
        person.share = (mine / total if total > 0 else 0.0) * min(1.0, 1.25 * person.inside)
        person.patches, person.evidence = mine, evidence
        if not flooded:
            step = min(1.0, dt / p.errors_s) * float(np.clip(evidence, -p.evidence_max, p.evidence_max))
            person.log_odds = float(np.clip(person.log_odds + step, -8.0, 8.0))
            away = dt / (p.leave_s if person.inside < 0.3 else p.stay_s)
            if person.share < 0.1:
                r = person.existence * math.exp(-away)
                person.log_odds = math.log(max(r, 1e-6) / max(1 - r, 1e-6))
        if person.share >= p.visible_min:
            noise = self._noise(s, poses[i], ratios[i], lam)
            xp, yp = predicted[i, :2]
            ix, ixy, iy = self._information(person)
            ox, oy = x - xp, y - yp
            gx, gy = ix * ox + ixy * oy, ixy * ox + iy * oy
            zx, zy = x + noise.xx * gx + noise.xy * gy, y + noise.xy * gx + noise.yy * gy
            kalman = person.kalman.corrected(zx, zy, noise)
            speed = math.hypot(kalman.vx_mps, kalman.vy_mps)
            if speed > body.SPEED_MAX_MPS:
                f = body.SPEED_MAX_MPS / speed
                kalman = kalman._replace(vx_mps=f * kalman.vx_mps, vy_mps=f * kalman.vy_mps)
            person.kalman = kalman
            d = 0.06
            bent = 2 * lam - self._lam(s, x, y, h + d, ratios[i]) - self._lam(s, x, y, h - d, ratios[i])
            person.height_var = 1.0 / (1.0 / person.height_var + max(bent, 0.0) / (d * d) + 1e-3)
            person.height_m = float(h)
            person.learn_height(min(1.0, dt / p.errors_s), p.low_share)
            person.seen_s = self._now_s
            self._moves_itself(person, dt)
            person.walked_m = max(person.walked_m, math.dist(person.origin_m, person.at_m))

    def _rival(self, i: int, poses: F64) -> int:
        """The person of better standing in whose place this one is; -1 for none."""
        gaps = np.hypot(poses[:, 0] - poses[i, 0], poses[:, 1] - poses[i, 1])
        gaps[i] = np.inf
        j = int(np.argmin(gaps))
        if gaps[j] >= body.APART_M:
            return -1
        a, b = self._people[i], self._people[j]
        return j if (b.confirmed, b.log_odds, -b.track_id) > (a.confirmed, a.log_odds, -a.track_id) else -1

    def _beside(self, i: int, j: int, poses: F64, ratios: F32, others: I64) -> float:
        """Evidence for a person in another's place: both against the other alone, who may then stand anywhere near."""
        s, people = self._pool[j], self._people
        rest = np.array([k for k in range(len(people)) if k not in (i, j)], dtype=np.int64)
        self._layer(s, poses, ratios, rest, -1)
        first = self._lam(s, *poses[i], ratios[i])
        best = -math.inf
        for start in (poses[j], np.array([*poses[i, :2], people[j].tall_m])):
            lam, prior = kernels.ascend(
                start.copy(), poses[j].copy(), np.array([1 / 0.2**2, 0.0, 1 / 0.2**2]), 1.0, *people[j].upright,
                self._apart(poses, rest, -1), STEPS, np.array([body.HEIGHT_MIN_M, body.HEIGHT_MAX_M]), s.values,
                s.kinds, s.codes, s.angles, s.n, ratios[j], self._cover, self._front, self._beliefs, *s.layers,
            )  # fmt: skip
            best = max(best, lam + prior)
        self._layer(s, poses, ratios, np.append(rest, i), j)
        both = first + self._lam(s, *poses[j], ratios[j])
        believed = kernels.believed(*poses[i], *people[i].upright, self._apart(poses, np.array([j]), -1), self._beliefs)
        believed += kernels.believed(*poses[j], *people[j].upright, self._apart(poses, rest, -1), self._beliefs)
        self._layer(s, poses, ratios, others, j)
        return both + believed - best

    def _full_patches(self, views: Sequence[SeenPixels], pose: F64) -> float:
        """Patches of a whole body in the view that shows it best."""
        best = 0.0
        for v in views:
            c = v.rays.centre_m
            away = math.hypot(pose[0] - c[0], pose[1] - c[1])
            depression = math.atan2(c[2] - 0.5 * pose[2], away)
            angle = round((depression - self._beliefs.angle_min) / self._beliefs.angle_step)
            cover = self._cover[min(max(angle, 0), len(self._cover) - 1)]
            scale = (pose[2] / body.TORSO.height_m) ** 2
            best += 2.0 * float(cover.sum()) * self._beliefs.cell_m**2 * scale / self.params.patch_m**2
        return best / max(len(views), 1)

    def _noise(self, s: Samples, pose: F64, ratio: F32, lam: float) -> PositionNoise:
        """Covariance of the place from the second differences of Lam, along and across the ray."""
        x, y, h = pose
        ax, ay = x - float(s.values[0, kernels.CX]), y - float(s.values[0, kernels.CY])
        norm = max(math.hypot(ax, ay), 1e-6)
        ax, ay = ax / norm, ay / norm
        d = 0.06
        along = self._lam(s, x + d * ax, y + d * ay, h, ratio) + self._lam(s, x - d * ax, y - d * ay, h, ratio)
        across = self._lam(s, x - d * ay, y + d * ax, h, ratio) + self._lam(s, x + d * ay, y - d * ax, h, ratio)
        va, vc = (d * d / max(2 * lam - both, 0.02) for both in (along, across))
        va, vc = max(va, 0.02**2), max(vc, 0.02**2)
        return PositionNoise(va * ax * ax + vc * ay * ay, (va - vc) * ax * ay, va * ay * ay + vc * ax * ax)

    def _boxes(self, view: SeenPixels, poses: F64) -> I64:
        """(N, 4) left, top, right, bottom of bodies in a view [px]."""
        n = len(poses)
        corners = np.array([(dx, dy, z) for dx in (-0.4, 0.4) for dy in (-0.4, 0.4) for z in (0.0, 1.05)])
        points = np.repeat(poses[:, None, :2], 8, axis=1) + corners[None, :, :2]
        z = corners[None, :, 2] * poses[:, 2:3]
        hom = np.concatenate([points, z[..., None], np.ones((n, 8, 1))], axis=-1) @ view.rays.projection.T
        depth = np.maximum(hom[..., 2], 0.15)
        u, v = hom[..., 0] / depth, hom[..., 1] / depth
        boxes = np.stack([u.min(1), v.min(1), u.max(1), v.max(1)], axis=1)
        return np.asarray(np.clip(boxes, -10_000, 10_000), dtype=np.int64)

    def _touching(self, views: Sequence[SeenPixels], poses: F64) -> np.ndarray:
        touch = np.zeros((len(poses), len(poses)), np.bool_)
        for v in views:
            touch |= kernels.touching(self._boxes(v, poses), 6)
        return touch

    # -- what is owned, learned and left over ---------------------------------------------------------------------
    def _share_out(self, views: Sequence[SeenPixels], dt: float) -> None:
        poses, ratios = self._poses(), self._ratios()
        self.owners = []
        self._left: list[F32] = []
        owned: list[tuple[I64, F32, F32, SeenPixels]] = []
        for v in views:
            owner = np.empty(v.kind.shape, np.int64)
            share, height = np.zeros(v.kind.shape, np.float32), np.zeros(v.kind.shape, np.float32)
            std = np.float32(self.params.disparity_std_px / v.rays.disparity_metre) / v.rays.stretch
            kernels.share_out(
                poses, self._sure(len(poses)), ratios, self._boxes(v, poses), v.rays.centre_m, v.rays.direction, v.kind, v.range_m,
                v.colour if v.colour is not None else v.kind, std, self._cover, self._front, self._beliefs,
                owner, share, height,
            )  # fmt: skip
            self.owners.append(owner)
            owned.append((owner, share, height, v))
        if self._coloured:
            self._learn(owned)
            self._identify(owned, dt)

    def _learn(self, owned: Sequence[tuple[I64, F32, F32, SeenPixels]]) -> None:
        for i, person in enumerate(self._people):
            near = min((math.dist(person.at_m, q.at_m) for q in self._people if q is not person), default=9.0)
            if person.share < 0.5 or near < 0.7:
                continue
            for owner, share, height, v in owned:
                mine = (owner == i) & (share > 0.8)
                assert v.colour is not None
                learn_colours(person, height[mine], v.colour[mine])

    def _identify(self, owned: Sequence[tuple[I64, F32, F32, SeenPixels]], dt: float) -> None:
        """Evidence that two people who were in contact have each other's place, from the colours of what they own."""
        p, people = self.params, self._people
        alive = {q.track_id for q in people}
        self._exchange = {k: v for k, v in self._exchange.items() if k[0] in alive and k[1] in alive}
        logs: dict[int, tuple[F64, float]] = {}
        ratios = np.log(colour_ratios(people))
        for i, a in enumerate(people):
            for j in range(i + 1, len(people)):
                b = people[j]
                key = (min(a.track_id, b.track_id), max(a.track_id, b.track_id))
                if math.dist(a.at_m, b.at_m) < 0.7:
                    self._exchange.setdefault(key, 0.0)
                if key not in self._exchange or a.looks < 5 or b.looks < 5 or not (a.confirmed and b.confirmed):
                    continue
                for k in (i, j):
                    if k not in logs:
                        logs[k] = self._owned_colours(k, owned)
                gain = 0.0
                for k, other in ((i, j), (j, i)):
                    counts, n = logs[k]
                    if n > 0:
                        mean = float((counts * (ratios[other] - ratios[k])).sum())
                        gain += float(np.clip(mean, -2.0, 2.0)) * min(3.0, n / 20.0)
                value = self._exchange[key] * math.exp(-dt / p.lag_s) + gain * min(1.0, dt / p.errors_s)
                self._exchange[key] = value
                if value > 6.0:
                    self._swap(a, b, value)
                    self._exchange[key] = 0.0
                    logs.clear()
                    ratios = np.log(colour_ratios(people))

    def _owned_colours(self, k: int, owned: Sequence[tuple[I64, F32, F32, SeenPixels]]) -> tuple[F64, float]:
        """(PARTS, CODES) shares of the owned pixels, and how many patches they are."""
        total = np.zeros((kernels.PARTS, CODES))
        patches = 0.0
        for owner, share, height, v in owned:
            mine = (owner == k) & (share > 0.3)
            assert v.colour is not None
            part = np.where(height[mine] < 0.45, 0, np.where(height[mine] < 0.85, 1, 2))
            np.add.at(total, (part, v.colour[mine]), 1.0)
            r = v.range_m[mine]
            patches += float((r * r).sum()) * v.rays.pixel_sr / self.params.patch_m**2
        n = total.sum()
        return total / max(n, 1.0), patches if n > 0 else 0.0

    def _swap(self, a: Person, b: Person, odds: float) -> None:
        for name in ("track_id", "colours", "looks", "born_s", "tall_m", "tall_var", "origin_m", "walked_m"):
            va, vb = getattr(a, name), getattr(b, name)
            setattr(a, name, vb)
            setattr(b, name, va)
        self._log.append(
            Decision(a.track_id, "identity", f"exchanged with {b.track_id}: colours, odds e^{odds:.1f}", odds)
        )

    # -- who comes and goes ---------------------------------------------------------------------------------------
    def _remove(self) -> None:
        keep = []
        for q in self._people:
            gone = q.existence < 0.05 or (
                q.inside < 0.15 and q.share < 0.1 and self._now_s - q.seen_s > self.params.leave_s
            )
            if not gone:
                keep.append(q)
                continue
            self._log.append(Decision(q.track_id, "pruned", f"existence {q.existence:.2f}, evidence {q.evidence:.1f}"))
            if q.confirmed:
                self._departed.append(q)
        self._people = keep
        self._departed = [q for q in self._departed if self._now_s - q.seen_s <= self.params.remember_s]

    def _births(self, views: Sequence[SeenPixels], dt: float) -> None:
        points = []
        for v, owner in zip(views, self.owners, strict=True):
            r, c = np.nonzero(owner == -1)
            far = v.range_m[r, c][:, None]
            xyz = v.rays.centre_m.astype(np.float32) + far * v.rays.direction[r, c]
            area = (far[:, 0] / v.rays.stretch[r, c]) ** 2 * v.rays.pixel_sr
            codes = v.colour[r, c] if v.colour is not None else np.zeros(len(r))
            points.append(np.column_stack([xyz, area, codes]))
        left = np.concatenate(points) if points else np.zeros((0, 5))
        if left[:, 3].sum() < 0.04:
            return
        cell = 0.05
        low = left[:, :2].min(axis=0) - 0.5
        at = ((left[:, :2] - low) / cell).astype(int)
        occupancy = np.zeros(at.max(axis=0) + 12, np.float32)
        if occupancy.size > 4_000_000:
            return
        np.add.at(occupancy, (at[:, 0], at[:, 1]), left[:, 3])
        box = cv2.boxFilter(occupancy, -1, (9, 9), normalize=False, borderType=cv2.BORDER_CONSTANT)
        born: list[Person] = []
        for _ in range(6):
            r, c = np.unravel_index(int(np.argmax(box)), box.shape)
            if box[r, c] < 0.05:
                break
            place = low + (np.array([r, c]) + 0.5) * cell
            box[max(0, r - 6) : r + 7, max(0, c - 6) : c + 7] = 0
            near = np.abs(left[:, :2] - place).max(axis=1) < 0.3
            if near.sum() < 8:
                continue
            person = self._try(views, left[near])
            if person is not None:
                born.append(person)
        if born:
            self._name(born)

    def _try(self, views: Sequence[SeenPixels], points: F64) -> Person | None:
        """A newcomer at points that nobody explains, if the evidence for one is strong enough."""
        p = self.params
        x, y = np.average(points[:, :2], axis=0, weights=points[:, 3])
        camera = views[0].rays.centre_m
        away = max(math.hypot(x - camera[0], y - camera[1]), 1e-3)
        out = 0.1 * min(1.0, away)
        x, y = x + out * (x - camera[0]) / away, y + out * (y - camera[1]) / away
        top = float(np.quantile(points[:, 2], 0.97))
        known = self._poses()
        if len(known) and np.hypot(known[:, 0] - x, known[:, 1] - y).min() < 0.15:
            return None
        poses = np.concatenate([known, [[x, y, body.HEIGHT_MEAN_M]]])
        n = len(poses) - 1
        self._people.append(
            Person(0, FloorKalman.at(x, y, 0.2, 1.0), body.HEIGHT_MEAN_M, 0.0, self._now_s, self._now_s)
        )
        ratios = self._ratios()
        self._people.pop()
        others = np.flatnonzero(self._touching(views, poses)[n])
        while len(self._pool) <= n:
            self._pool.append(Samples())
        s = self._pool[n]
        self._gather(s, views, poses[n], 0.35)
        self._layer(s, poses, ratios, others, n)
        apart = self._apart(poses, others, n)
        info = np.array([1 / 0.2**2, 0.0, 1 / 0.2**2])
        best: tuple[float, F64, float] | None = None
        for height in (body.HEIGHT_MEAN_M, min(max(top, 0.9), 1.95)):
            pose = np.array([x, y, height])
            lam, prior = kernels.ascend(
                pose, pose.copy(), info, 1.0, body.HEIGHT_MEAN_M, body.HEIGHT_STD_M, apart, STEPS, np.array([0.8, body.HEIGHT_MAX_M]), s.values, s.kinds,
                s.codes, s.angles, s.n, ratios[n], self._cover, self._front, self._beliefs, *s.layers,
            )  # fmt: skip
            if best is None or lam + prior > best[0]:
                best = lam + prior, pose, lam
        assert best is not None
        evidence, poses[n], lam = best
        mine, total = self._visible(s, poses[n], ratios[n])
        if evidence < p.birth_evidence or mine < 0.25 * total:
            return None
        noise = self._noise(s, poses[n], ratios[n], lam)
        kalman = FloorKalman.measured(poses[n, 0], poses[n, 1], noise, 1.0)
        person = Person(0, kalman, float(poses[n, 2]), -3.9, self._now_s, self._now_s)
        person.log_odds += min(1.0, 0.067 / p.errors_s) * min(evidence, p.evidence_max)
        person.origin_m, person.evidence = person.at_m, evidence
        person.patches, person.share = mine, mine / max(total, 1e-6)
        if self._coloured:
            learn_colours(person, points[:, 2] / person.height_m, points[:, 4].astype(np.uint8))
        return person

    def _name(self, born: list[Person]) -> None:
        """Newcomers are the lost or departed whom they continue best, or strangers."""
        lost = [q for q in self._people if q.confirmed and q.share < self.params.visible_min] + self._departed
        cost = np.zeros((len(born), len(lost)))
        for i, b in enumerate(born):
            for j, q in enumerate(lost):
                cost[i, j] = -self._continues(q, b)
        taken: dict[int, Person] = {}
        if cost.size:
            for i, j in zip(*linear_sum_assignment(np.minimum(cost, 0.0)), strict=True):
                if cost[i, j] < 0:
                    taken[int(i)] = lost[int(j)]
        for i, b in enumerate(born):
            q = taken.get(i)
            if q is None:
                b.track_id = self._next
                self._next += 1
                reason = f"evidence {b.evidence:.1f}, {b.height_m:.2f} m tall"
                self._log.append(Decision(b.track_id, "spawned", reason, b.evidence))
                self._people.append(b)
                continue
            gone = self._now_s - q.seen_s
            self._log.append(
                Decision(q.track_id, "reacquired", f"odds e^{-cost[i, lost.index(q)]:.1f} after {gone:.1f} s")
            )
            q.kalman, q.height_m, q.seen_s, q.share, q.patches = b.kalman, b.height_m, self._now_s, b.share, b.patches
            q.log_odds = max(q.log_odds, b.log_odds)
            if q in self._departed:
                self._departed.remove(q)
                self._people.append(q)

    def _continues(self, q: Person, b: Person) -> float:
        """Log-odds that a newcomer is a lost person rather than a stranger."""
        gone = self._now_s - q.seen_s
        away = math.dist(q.at_m, b.at_m)
        reach = 0.3 + body.SPEED_MAX_MPS * gone
        if away > reach or gone <= 0.0:
            return -1.0
        spread = min(0.3 + 1.0 * gone, 3.0)
        place = math.log(20.0 / (2 * math.pi * spread**2)) - 0.5 * (away / spread) ** 2
        off, std = b.height_m - q.height_m, 0.07
        height = math.log(body.HEIGHT_STD_M / std) - 0.5 * (off / std) ** 2
        height += 0.5 * ((b.height_m - body.HEIGHT_MEAN_M) / body.HEIGHT_STD_M) ** 2
        return place + max(height, -6.0) + self._alike(q, b)

    def _alike(self, q: Person, b: Person) -> float:
        """Log-odds of a newcomer's colours being those of a person rather than of anybody."""
        if not self._coloured or q.looks < 5:
            return 0.0
        people = [*self._people, *self._departed]
        if q not in people:
            people.append(q)
        ratio = np.log(colour_ratios(people)[people.index(q)])
        seen = b.colours / np.maximum(b.colours.sum(axis=1, keepdims=True), 1e-6)
        return float(np.clip((seen * ratio).sum(axis=1), -2.0, 2.0).sum())

    def _confirm(self) -> None:
        for q in self._people:
            person_like = q.moved + self._stature(q.height_m) > 0.0
            if (
                not q.confirmed
                and q.existence > self.params.report
                and q.share > self.params.visible_min
                and person_like
            ):
                q.confirmed = True
                self._log.append(Decision(q.track_id, "confirmed", f"existence {q.existence:.2f}", q.existence))

    def _stature(self, height_m: float) -> float:
        """Log-odds that something of a height is a person and no thing, which may have any."""
        low = self.params.low_share
        upright = (1 - low) * math.exp(-0.5 * ((height_m - body.HEIGHT_MEAN_M) / body.HEIGHT_STD_M) ** 2)
        upright /= math.sqrt(2 * math.pi) * body.HEIGHT_STD_M
        return math.log((upright + low / body.HEIGHT_MEAN_M) * (body.HEIGHT_MAX_M - body.HEIGHT_MIN_M))

    def _moves_itself(self, q: Person, dt: float) -> None:
        """Evidence for a person: it moves, and nobody near pushes it."""
        speed = math.hypot(q.kalman.vx_mps, q.kalman.vy_mps)
        near = min((math.dist(q.at_m, o.at_m) for o in self._people if o is not q), default=9.0)
        if speed > 0.4 and near > body.REACH_M and q.walked_m > 0.3:
            q.moved = min(q.moved + dt / self.params.errors_s, self.params.evidence_max)

    def _state(self, q: Person) -> TrackState:
        k = q.kalman
        state = "tentative" if not q.confirmed else ("confirmed" if q.share >= self.params.visible_min else "lost")
        return TrackState(q.track_id, state, k.x_m, k.y_m, k.vx_mps, k.vy_mps, q.height_m)
