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
"""Bias of the disparities of people [px]: they are small against the window of the matching, which mixes
them with what is behind, so that they are found 2 to 4 cm too far away on small images, and rigs that face each other
would be found twice that apart. Measured against truth on a rendered recording of 320x240 (0.06 and 0.07)."""
STD_MAX_M = 0.10
STD_MAX_DEG = 2.0
STD_MAX_S = 0.10
"""Largest deviations of position, heading and clock that are accepted."""


def paths_of(tracks: Trajectories, world_SE3_left: SE3, disparity_metre: float) -> list[WalkedPath]:
    """Confirmed people as paths, for the pose of the rectified left camera and f b [px m]; predicted rows are gaps."""
    is_placed = (tracks.state == "confirmed") & np.isfinite(tracks.x_m + tracks.y_m + tracks.timestamp_s)
    rows = tracks.where(is_placed)
    paths = []
    for track_id in np.unique(rows.track_id):
        track = rows.where(rows.track_id == track_id)
        # Over longer gaps a path is not interpolated [s].
        cuts = np.flatnonzero(np.diff(track.timestamp_s) > 0.5) + 1
        for part in np.split(np.arange(len(track)), cuts):
            xy = np.column_stack([track.x_m[part], track.y_m[part]])
            first, xy = sample_path(track.timestamp_s[part], xy)
            # Shorter pieces are left out [s].
            if (len(xy) - 1) * TICK_S < 2.0:
                continue
            heights = track.height_m[part]
            heights = heights[np.isfinite(heights)]
            height_m = float(np.median(heights)) if len(heights) else math.nan
            # What an offset of the disparities does: dZ/dd = -Z^2 / (f b), along the ray to a head at 1.6 m.
            ray = np.column_stack([xy, np.full(len(xy), 1.6)]) - world_SE3_left.translation
            depth = ray @ world_SE3_left.rotation[:, 2]
            per_px_m = -ray[:, :2] * depth[:, None] / disparity_metre
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
    """Points of the median disparity whose depth is certain enough."""
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
    hypotheses = _hypotheses(first, second, clock_s)
    if not hypotheses:
        raise WorkError(
            f"expected people who walk for {PIECE_S:g} s where both sensors see them, found no path that fits "
            f"another within {clock_s:g} s of clock: the sensors see different places, or people stood"
        )
    scores_s = [met_s(hypothesis, first, second) for hypothesis in hypotheses]
    best = hypotheses[int(np.argmax(scores_s))]
    for meet_m in [MEET_M] * 4 + [SAME_PLACE_M] * 4:
        best = _refine(best, first, second, meet_m, disparity_px)
    best_s = met_s(best, first, second)
    rival_s = 0.0
    for other, score_s in zip(hypotheses, scores_s, strict=True):
        if _differ(best, other):
            rival_s = max(rival_s, score_s)
    if rival_s > RIVAL_SHARE * max(best_s, *scores_s):
        raise WorkError(
            "expected people who walk so that one position of the sensors fits best, found another that fits "
            f"{rival_s:.0f} s of their paths where the best fits {best_s:.0f} s: "
            "let people walk around instead of to and fro on a line"
        )
    if best.shared_s < SHARED_S:
        raise WorkError(
            f"expected people in both sensors' views for at least {SHARED_S:g} s, found {best.shared_s:.1f} s"
        )
    _refuse_above("position", 100 * best.position_std_m, 100 * STD_MAX_M, "cm")
    _refuse_above("heading", math.degrees(best.heading_std_rad), STD_MAX_DEG, "degrees")
    _refuse_above("clock", 1000 * best.clock_std_s, 1000 * STD_MAX_S, "ms")
    return best


def _refuse_above(name: str, std: float, limit: float, unit: str) -> None:
    """Refuse an alignment of which a value has too large a deviation."""
    if not std <= limit:
        raise WorkError(
            f"expected the {name} within {limit:g} {unit}, found a deviation of {std:.1f} {unit}: people walked "
            "too little, or straight at one speed, where both sensors see them"
        )


def _differ(one: RigAlignment, other: RigAlignment) -> bool:
    """True for two motions that are different ones."""
    turn = math.remainder(one.heading_rad - other.heading_rad, 2 * math.pi)
    middle = np.array(one.pivot_m)
    shift = float(np.hypot(*(one.apply(middle) - other.apply(middle))))
    return abs(math.degrees(turn)) > 15.0 or shift > 0.75 or abs(one.clock_s - other.clock_s) > 1.0


def _hypotheses(first: Paths, second: Paths, clock_s: float) -> list[RigAlignment]:
    """Motions that lay a piece of one path over another at some clock, the best of each pair of paths first."""
    length = max(4, round(PIECE_S / TICK_S))
    widest = math.ceil(clock_s / TICK_S)
    fits: list[tuple[float, RigAlignment]] = []
    for path in first:
        for start in range(0, len(path.xy_m) - length + 1, length // 2):
            piece = path.xy_m[start : start + length]
            largest_std_m = np.sqrt(np.linalg.eigvalsh(np.cov(piece.T))[-1])
            # A person who stands gives no heading.
            if largest_std_m < 0.5:
                continue
            for other in second:
                if same_height(path, other):
                    fits += _fit_piece(piece, path.first + start, other, widest)
    fits.sort(key=lambda fit: fit[0])
    # Motions that are judged by all people.
    return [motion for _, motion in fits[:400]]


def _fit_piece(piece: F64, tick: int, other: WalkedPath, widest: int) -> list[tuple[float, RigAlignment]]:
    """Rms difference [m] and motion of the good ones of the rigid fits of all windows of another path to a piece."""
    n = len(piece)
    if len(other.xy_m) < n:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(other.xy_m, n, axis=0).transpose(0, 2, 1)
    lags = tick - (other.first + np.arange(len(windows)))
    is_near = np.abs(lags) <= widest
    windows = windows[is_near]
    lags = lags[is_near]
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
    is_least = (rms <= around[:-2]) & (rms <= around[2:])
    fits = []
    for k in np.flatnonzero((rms <= PIECE_RMS_M) & is_least):
        heading = float(angle[k])
        x, y = (centre - floor_rotation(heading) @ centres[k]).tolist()
        fits.append((float(rms[k]), RigAlignment(heading, x, y, float(lags[k]) * TICK_S)))
    return fits


def _refine(motion: RigAlignment, first: Paths, second: Paths, meet_m: float, disparity_px: float) -> RigAlignment:
    """The motion and clock that fit all people best who meet under a motion."""
    meetings = [meeting for meeting in _meetings(motion, first, second, meet_m) if len(meeting.ticks) >= 5]
    if not meetings:
        return motion
    places = [meeting.second.at(meeting.ticks - motion.clock_s / TICK_S) for meeting in meetings]
    pivot = np.nanmean(np.concatenate(places), axis=0)

    def residual_m(values: F64, first_px: float = disparity_px, second_px: float = disparity_px) -> F64:
        return np.concatenate([meeting.residual(values, (first_px, second_px), pivot) for meeting in meetings])

    from scipy.optimize import least_squares  # half a second

    start = np.array([motion.heading_rad, *motion.apply(pivot), motion.clock_s])
    scale = [0.05, 0.1, 0.1, 0.1]
    result = least_squares(
        lambda values: residual_m(values) / NOISE_M, start, loss="soft_l1", x_scale=scale, diff_step=1e-4
    )
    left = residual_m(result.x)
    # (4, 4) of the values: of correlated noise, and of systematic errors of one deviation each (N, 2) that are
    # not solved for (consider covariance).
    jacobian = result.jac * NOISE_M
    worse_px = disparity_px + HEAD_ERROR_STD_PX
    first_worse = residual_m(result.x, first_px=worse_px)
    second_worse = residual_m(result.x, second_px=worse_px)
    systematic_m = np.column_stack([first_worse, second_worse]) - left[:, None]
    sigma = max(float(np.median(np.abs(left)) / 0.6745), 1e-3)
    normal = jacobian.T @ jacobian + 1e-9 * np.eye(4)
    effect = np.linalg.solve(normal, jacobian.T @ systematic_m)
    # How long errors of a track's positions last [s]: a sample counts as the share of it that a tick is.
    covariance = np.linalg.inv(normal) * sigma**2 * (1.0 / TICK_S) + effect @ effect.T
    heading, x, y, clock_s = result.x.tolist()
    shift = np.array([x, y]) - floor_rotation(heading) @ pivot
    return RigAlignment(
        heading_rad=math.remainder(heading, 2 * math.pi),
        x_m=float(shift[0]),
        y_m=float(shift[1]),
        clock_s=clock_s,
        residual_m=float(np.sqrt((left**2).mean())),
        shared_s=len(left) / 2 * TICK_S,
        std=tuple(np.sqrt(np.diag(covariance)).tolist()),
        pivot_m=tuple(pivot.tolist()),
    )


class _Meeting(NamedTuple):
    """A path of each rig that are one person's, and the (N,) ticks of the first one that meet the second one."""

    first: WalkedPath
    second: WalkedPath
    ticks: F64

    def residual(self, values: F64, disparities_px: tuple[float, float], pivot: F64) -> F64:
        """(2 N,) differences [m] under (heading, x and y of the pivot, clock), with disparities corrected."""
        then = self.ticks - values[3] / TICK_S
        ours = self.first.at(self.ticks, disparities_px[0])
        theirs = self.second.at(then, disparities_px[1])
        moved = (theirs - pivot) @ floor_rotation(values[0]).T + values[1:3]
        return np.nan_to_num((moved - ours).ravel(), nan=0.0)


def _meetings(motion: RigAlignment, first: Paths, second: Paths, meet_m: float) -> list[_Meeting]:
    """The pairs of paths of both rigs that meet under a motion."""
    meetings = []
    for path, other in product(first, second):
        is_near = np.nan_to_num(apart_m(motion, path, other), nan=np.inf) <= meet_m
        # Two paths that meet for a shorter time are of people who pass each other [s].
        if is_near.sum() * TICK_S >= 1.0 and same_height(path, other):
            ticks = path.first + np.flatnonzero(is_near).astype(np.float64)
            meetings.append(_Meeting(path, other, ticks))
    return meetings


def after(before: RigAlignment, nearer: RigAlignment) -> RigAlignment:
    """The alignment of a third rig to the first, from that of the second to the first and of the third to the second;
    deviations are those of the nearer one."""
    x, y = before.apply(np.array([nearer.x_m, nearer.y_m]))
    heading = math.remainder(before.heading_rad + nearer.heading_rad, 2 * math.pi)
    return replace(nearer, heading_rad=heading, x_m=float(x), y_m=float(y), clock_s=before.clock_s + nearer.clock_s)


def align_records(records: Sequence[RigRecord], clock_s: float = 10.0) -> list[RigAlignment]:
    """Alignments of all rigs but the first to the first: a rig is laid over every rig that has its place already, and
    takes the most certain result. Raises WorkError: people do not determine where a rig is; it is named."""
    alignments = {0: RigAlignment(0.0, 0.0, 0.0, 0.0)}
    while len(alignments) < len(records):
        waiting = [k for k in range(len(records)) if k not in alignments]
        reasons: dict[int, WorkError] = {}
        for k in waiting:
            candidates = []
            for j, before in alignments.items():
                try:
                    nearer = align_rigs(records[j].paths, records[k].paths, clock_s)
                except WorkError as error:
                    reasons[k] = error
                    continue
                candidates.append(after(before, nearer))
            if candidates:
                alignments[k] = min(candidates, key=lambda alignment: alignment.position_std_m)
        if alignments.keys().isdisjoint(waiting):
            k = waiting[0]
            raise WorkError(f"{records[k].path}: {reasons[k]}") from reasons[k]
    return [alignments[k] for k in range(1, len(records))]


def rig_entries(records: Sequence[RigRecord], alignments: Sequence[RigAlignment], folder: Path) -> list[RigEntry]:
    """The rigs as ``rigs.toml`` in a folder lists them. Raises InputError: a rig that is not inside the folder."""
    entries = []
    first = RigAlignment(0.0, 0.0, 0.0, 0.0)
    for record, alignment in zip(records, [first, *alignments], strict=True):
        shift = [alignment.x_m, alignment.y_m, 0.0]
        common_SE3_world = SE3.from_rotvec([0.0, 0.0, alignment.heading_rad], shift)
        pose = common_SE3_world @ record.world_SE3_left
        entries.append(RigEntry(relative_to(record.path, folder), pose, alignment.clock_s))
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
