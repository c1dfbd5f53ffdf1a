"""Several rigs laid into one world, that of the first with its clock, from people who walk where two rigs see them.

Unknown are heading, x, y and clock. Pieces of the second rig's paths are laid over the first's at every clock offset
in question; the motion under which most of all people meet (RANSAC) is refined by robust least squares on these.
"""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.errors import InputError, WorkError
from calib.pose import SE3
from calib.types import F32, F64
from calib.world import RigEntry, save_rigs
from planview.engine.config import Config
from planview.engine.open import engine_of
from planview.evaluation.align import AS_COMPLEX, fit_turn, floor_rotation
from planview.evaluation.paths import (
    MEET_M,
    TICK_S,
    Paths,
    RigAlignment,
    WalkedPath,
    apart_m,
    met_s,
    same_height,
    sample_path,
)
from planview.maps.grid import FloorRig
from planview.trajectories.table import Trajectories, TrajectoryCollector
from stereo.depth import back_project, median_image
from stereo.readers import OpenOptions, open_any

log = logging.getLogger(__name__)
PIECE_S = 6.0
"""Length of the pieces of paths that are laid over each other [s]: a walk across a room."""
PIECE_RMS_M = 0.20
"""Pieces that fit worse are of different people [m]: twice the position error of a track."""
SAME_PLACE_M = 0.25
"""The same once the motion is known [m]: farther ones are of people half hidden from one of the rigs."""
NOISE_M = 0.03
"""Differences of positions from which on they count linearly [m]."""
SHARED_S = 8.0
"""Shortest time that people must be seen by both rigs, added up [s]."""
RIVAL_SHARE = 0.8
"""A quite different motion under which so large a share of the best one's people meet makes the result ambiguous:
to and fro on one line is the same line turned by 180 degrees at another clock."""
HEAD_ERROR_STD_PX = 0.05
"""Deviation of that from one camera to another [px]; it is a part of the deviations of x and y."""
DISPARITY_PX = 0.07
"""What is missing in the disparities of people [px]: they are small against the window of the matching, which mixes
them with what is behind, so that they are found 2 to 4 cm too far away on small images, and rigs that face each other
would be found twice that apart. Measured against truth on a rendered recording of 320x240 (0.06 and 0.07)."""
STD_MAX_M = 0.10
STD_MAX_DEG = 2.0
STD_MAX_S = 0.10
"""Largest deviations of position, heading and clock that are accepted."""


def paths_of(tracks: Trajectories, world_SE3_left: SE3, disparity_metre: float) -> list[WalkedPath]:
    """Confirmed people as paths, for the pose of the rectified left camera and f b [px m]; predicted rows are gaps."""
    known = (tracks.state == "confirmed") & np.isfinite(tracks.x_m + tracks.y_m + tracks.timestamp_s)
    rows = tracks.where(known)
    paths = []
    for track_id in np.unique(rows.track_id):
        own = rows.where(rows.track_id == track_id)
        # Over longer gaps a path is not interpolated [s].
        cuts = np.flatnonzero(np.diff(own.timestamp_s) > 0.5) + 1
        for part in np.split(np.arange(len(own)), cuts):
            first, xy = sample_path(own.timestamp_s[part], np.column_stack([own.x_m[part], own.y_m[part]]))
            # Shorter pieces are left out [s].
            if (len(xy) - 1) * TICK_S < 2.0:
                continue
            heights = own.height_m[part][np.isfinite(own.height_m[part])]
            height_m = float(np.median(heights)) if len(heights) else math.nan
            # What an offset of the disparities does: dZ/dd = -Z^2 / (f b), along the ray to a head at 1.6 m.
            out = np.column_stack([xy, np.full(len(xy), 1.6)]) - world_SE3_left.translation
            depth = out @ world_SE3_left.rotation[:, 2]
            per_px_m = -out[:, :2] * depth[:, None] / disparity_metre
            paths.append(WalkedPath(first, xy, height_m, np.asarray(per_px_m)))
    return paths


@dataclass(frozen=True, eq=False)
class RigRecord:
    """One rig, in its own world and on its own clock: its recording, the pose of its rectified left camera, the paths
    of all people, and (N, 3) float32 points that stand still [m]."""

    path: Path
    world_SE3_left: SE3
    paths: list[WalkedPath]
    scene: F32


def record_rig(path: Path, config: Config, fps: float | None = None) -> RigRecord:
    """Track a rig's recording and gather the scene behind the people; ``fps`` in place of its own times."""
    log.debug("tracking %s", path.name)
    engine = engine_of(open_any(path, OpenOptions(fps=fps)), config=config)
    (view,) = engine.rigs.values()
    collector = TrajectoryCollector()
    disparities = []
    # Frames, spread over the recording, whose median is the scene without people.
    every = max(1, engine.recording.n_frames // 24)
    for result in engine:
        collector.add(result.frame, result.timestamp_s, result.tracks)
        if result.frame % every == 0 and result.depth is not None:
            disparities.append(result.depth.disparity)
    pose = view.floor.world_SE3_left
    paths = paths_of(collector.trajectories(), pose, view.geometry.disparity_metre)
    return RigRecord(path, pose, paths, _scene(view, disparities))


def _scene(view: FloorRig, disparities: list[F32]) -> F32:
    """Points of the median disparity that are known well enough."""
    geometry = view.geometry
    disparity = median_image(disparities)
    # Points of the scene with a larger predicted depth deviation are left out [m].
    farthest = (0.30 / geometry.depth_std_m(1.0)) ** 0.5
    points = back_project(geometry.depth(disparity, farthest), geometry, view.reduction).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    return np.asarray(view.floor.world_SE3_left @ points, dtype=np.float32)


def align_rigs(first: Paths, second: Paths, clock_s: float = 10.0, disparity_px: float = DISPARITY_PX) -> RigAlignment:
    """Lay the second rig's people over the first's; ``clock_s``: how much later or earlier one recording may begin.
    Raises WorkError: people do not determine it: too few, too short, standing, or walking so that several motions fit.
    """
    if not first or not second:
        raise WorkError("expected people who walk in both sensors' views, found none in one of them")
    found = _hypotheses(first, second, clock_s)
    if not found:
        raise WorkError(
            f"expected people who walk for {PIECE_S:g} s where both sensors see them, found no path that fits "
            f"another within {clock_s:g} s of clock: the sensors see different places, or people stood"
        )
    scores = np.array([met_s(hypothesis, first, second) for hypothesis in found])
    best = found[int(np.argmax(scores))]
    for meet_m in [MEET_M] * 4 + [SAME_PLACE_M] * 4:
        best = _refined(best, first, second, meet_m, disparity_px)
    top = met_s(best, first, second)
    rival = max((score for other, score in zip(found, scores, strict=True) if _apart(best, other)), default=0.0)
    if rival > RIVAL_SHARE * max(top, float(scores.max())):
        raise WorkError(
            "expected people who walk so that one position of the sensors fits best, found another that fits "
            f"{rival:.0f} s of their paths where the best fits {top:.0f} s: "
            "let people walk around instead of to and fro on a line"
        )
    if best.shared_s < SHARED_S:
        raise WorkError(
            f"expected people in both sensors' views for at least {SHARED_S:g} s, found {best.shared_s:.1f} s"
        )
    for name, std, limit, unit in (
        ("position", 100 * best.position_std_m, 100 * STD_MAX_M, "cm"),
        ("heading", math.degrees(best.heading_std_rad), STD_MAX_DEG, "degrees"),
        ("clock", 1000 * best.clock_std_s, 1000 * STD_MAX_S, "ms"),
    ):
        if not std <= limit:
            raise WorkError(
                f"expected the {name} within {limit:g} {unit}, found a deviation of {std:.1f} {unit}: people walked "
                "too little, or straight at one speed, where both sensors see them"
            )
    return best


def _apart(one: RigAlignment, other: RigAlignment) -> bool:
    """Whether two motions are different ones."""
    turn = math.remainder(one.heading_rad - other.heading_rad, 2 * math.pi)
    middle = np.array(one.pivot_m)
    shift = float(np.hypot(*(one.apply(middle) - other.apply(middle))))
    return abs(math.degrees(turn)) > 15.0 or shift > 0.75 or abs(one.clock_s - other.clock_s) > 1.0


def _hypotheses(first: Paths, second: Paths, clock_s: float) -> list[RigAlignment]:
    """Motions that lay a piece of one path over another at some clock, the best of each pair of paths first."""
    length = max(4, round(PIECE_S / TICK_S))
    widest = math.ceil(clock_s / TICK_S)
    found: list[tuple[float, RigAlignment]] = []
    for path in first:
        for start in range(0, len(path.xy_m) - length + 1, length // 2):
            piece = path.xy_m[start : start + length]
            # The largest deviation of a piece from its middle: a person who stands gives no heading [m].
            if np.sqrt(np.linalg.eigvalsh(np.cov(piece.T))[-1]) < 0.5:
                continue
            for other in second:
                if same_height(path, other):
                    found += _fits(piece, path.first + start, other, widest)
    found.sort(key=lambda pair: pair[0])
    # Motions that are judged by all people.
    return [motion for _, motion in found[:400]]


def _fits(piece: F64, tick: int, other: WalkedPath, widest: int) -> list[tuple[float, RigAlignment]]:
    """Rigid fits of all windows of another path to a piece; residual over extent, and motion, of the good ones."""
    n = len(piece)
    if len(other.xy_m) < n:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(other.xy_m, n, axis=0).transpose(0, 2, 1)
    lags = tick - (other.first + np.arange(len(windows)))
    near = np.abs(lags) <= widest
    windows = windows[near]
    lags = lags[near]
    if not len(windows):
        return []
    centres = windows.mean(axis=1)
    centre = piece.mean(axis=0)
    spread = ((windows - centres[:, None]) ** 2).sum(axis=(1, 2))
    with np.errstate(invalid="ignore"):  # who stands all the time fits nothing
        turns = fit_turn(windows @ AS_COMPLEX, piece @ AS_COMPLEX)
    # Of a turn without its scale: |a|^2 + |b|^2 - 2 |turn| |b|^2.
    square = ((piece - centre) ** 2).sum() + spread - 2.0 * np.abs(turns) * spread
    rms = np.sqrt(np.maximum(square, 0.0) / n)
    angle = np.angle(turns)
    # Of neighbouring clocks only the best fit counts.
    around = np.concatenate([[np.inf], rms, [np.inf]])
    best = np.flatnonzero((rms <= PIECE_RMS_M) & (rms <= around[:-2]) & (rms <= around[2:]))
    motions = []
    for k in best:
        x, y = centre - floor_rotation(float(angle[k])) @ centres[k]
        motions.append((float(rms[k]), RigAlignment(float(angle[k]), float(x), float(y), float(lags[k]) * TICK_S)))
    return motions


def _refined(motion: RigAlignment, first: Paths, second: Paths, meet_m: float, disparity_px: float) -> RigAlignment:
    """The motion and clock that fit all people best who meet under a motion."""
    meetings = [m for m in _meetings(motion, first, second, meet_m) if len(m.ticks) >= 5]
    if not meetings:
        return motion
    met = np.concatenate([m.second.at(m.ticks - motion.clock_s / TICK_S) for m in meetings])
    pivot = np.nanmean(met, axis=0)

    def residual_m(v: F64, first_px: float = disparity_px, second_px: float = disparity_px) -> F64:
        return np.concatenate([m.residual(v, (first_px, second_px), pivot) for m in meetings])

    from scipy.optimize import least_squares  # half a second

    start = np.array([motion.heading_rad, *motion.apply(pivot), motion.clock_s])
    result = least_squares(
        lambda v: residual_m(v) / NOISE_M, start, loss="soft_l1", x_scale=[0.05, 0.1, 0.1, 0.1], diff_step=1e-4
    )
    left = residual_m(result.x)
    # (4, 4) of the values: of correlated noise, and of systematic errors of one deviation each (N, 2) that are
    # not solved for (consider covariance).
    jacobian = result.jac * NOISE_M
    worse_px = disparity_px + HEAD_ERROR_STD_PX
    off = [residual_m(result.x, first_px=worse_px), residual_m(result.x, second_px=worse_px)]
    systematic_m = np.column_stack(off) - left[:, None]
    sigma = max(float(np.median(np.abs(left)) / 0.6745), 1e-3)
    normal = jacobian.T @ jacobian + 1e-9 * np.eye(4)
    effect = np.linalg.solve(normal, jacobian.T @ systematic_m)
    # Errors of a track's positions last about so long [s]: a sample counts as the share of it that a tick is.
    covariance = np.linalg.inv(normal) * sigma**2 * (1.0 / TICK_S) + effect @ effect.T
    heading, x, y, clock_s = result.x.tolist()
    shift = np.array([x, y]) - floor_rotation(heading) @ pivot
    return RigAlignment(
        math.remainder(heading, 2 * math.pi), float(shift[0]), float(shift[1]), clock_s,
        float(np.sqrt((left**2).mean())), len(left) / 2 * TICK_S,
        tuple(np.sqrt(np.diag(covariance)).tolist()), tuple(pivot.tolist()),
    )  # fmt: skip


class _Meeting(NamedTuple):
    """A path of each rig that are one person's, and the (N,) ticks of the first one that meet the second one."""

    first: WalkedPath
    second: WalkedPath
    ticks: F64

    def residual(self, v: F64, disparities_px: tuple[float, float], pivot: F64) -> F64:
        """(2 N,) differences [m] under (heading, x and y of the pivot, clock), with disparities corrected."""
        then = self.ticks - v[3] / TICK_S
        ours = self.first.at(self.ticks, disparities_px[0])
        theirs = self.second.at(then, disparities_px[1])
        return np.nan_to_num(((theirs - pivot) @ floor_rotation(v[0]).T + v[1:3] - ours).ravel(), nan=0.0)


def _meetings(motion: RigAlignment, first: Paths, second: Paths, meet_m: float) -> list[_Meeting]:
    """Where people of both rigs meet under a motion."""
    pairs = []
    for path, other in product(first, second):
        near = np.nan_to_num(apart_m(motion, path, other), nan=np.inf) <= meet_m
        # Two paths that meet for a shorter time are of people who pass each other [s].
        if near.sum() * TICK_S >= 1.0 and same_height(path, other):
            pairs.append(_Meeting(path, other, path.first + np.flatnonzero(near).astype(np.float64)))
    return pairs


def after(before: RigAlignment, nearer: RigAlignment) -> RigAlignment:
    """The alignment of a third rig to the first, from that of the second to the first and of the third to the second;
    deviations are those of the nearer one."""
    x, y = before.apply(np.array([nearer.x_m, nearer.y_m]))
    heading = math.remainder(before.heading_rad + nearer.heading_rad, 2 * math.pi)
    return replace(nearer, heading_rad=heading, x_m=float(x), y_m=float(y), clock_s=before.clock_s + nearer.clock_s)


def align_records(records: Sequence[RigRecord], clock_s: float = 10.0) -> list[RigAlignment]:
    """Alignments of all rigs but the first to the first: a rig is laid over every rig that has its place already, and
    takes the most certain result. Raises WorkError: people do not determine where a rig is; it is named."""
    placed = {0: RigAlignment(0.0, 0.0, 0.0, 0.0)}
    while waiting := [k for k in range(len(records)) if k not in placed]:
        reasons: dict[int, WorkError] = {}
        for k in waiting:
            found = []
            for j, before in placed.items():
                try:
                    nearer = align_rigs(records[j].paths, records[k].paths, clock_s)
                except WorkError as error:
                    reasons[k] = error
                    continue
                found.append(after(before, nearer))
            if found:
                placed[k] = min(found, key=lambda a: a.position_std_m)
        if not set(waiting) & placed.keys():
            k = waiting[0]
            raise WorkError(f"{records[k].path}: {reasons[k]}") from reasons[k]
    return [placed[k] for k in range(1, len(records))]


def rig_entries(records: Sequence[RigRecord], alignments: Sequence[RigAlignment], folder: Path) -> list[RigEntry]:
    """The rigs as ``rigs.toml`` in a folder lists them. Raises InputError: a rig that is not inside the folder."""
    entries = []
    for record, a in zip(records, [RigAlignment(0.0, 0.0, 0.0, 0.0), *alignments], strict=True):
        common_SE3_own = SE3.from_rotvec([0.0, 0.0, a.heading_rad], [a.x_m, a.y_m, 0.0])
        entries.append(RigEntry(relative_to(record.path, folder), common_SE3_own @ record.world_SE3_left, a.clock_s))
    return entries


def relative_to(sensor: Path, folder: Path) -> str:
    """The path of a rig in the folder of ``rigs.toml``. Raises InputError: not in it."""
    relative = os.path.relpath(sensor.resolve(), folder.resolve())
    if relative.startswith("..") or relative == ".":
        raise InputError(f"expected rigs.toml in a folder above all sensors, found {folder} for {sensor}")
    return relative


def align_recordings(
    paths: Sequence[Path], file: Path | None, config: Config, fps: float | None = None, clock_s: float = 10.0
) -> list[RigAlignment]:
    """Track recordings of several sensors, align them (``align_records``) and write the result as ``rigs.toml``. Raises
    InputError: fewer than two, one that cannot be read, or a file that is not in a folder above all."""
    if len(paths) < 2:
        raise InputError(f"expected the recordings of two sensors or more, found {len(paths)}")
    if len({path.resolve() for path in paths}) < len(paths):
        raise InputError(f"expected every sensor once, found {', '.join(map(str, paths))}")
    if file is not None:
        for path in paths:
            relative_to(path, file.parent)
    records = [record_rig(path, config, fps) for path in paths]
    alignments = align_records(records, clock_s)
    if file is not None:
        save_rigs(rig_entries(records, alignments, file.parent), file, "found from people who walked")
    return alignments
