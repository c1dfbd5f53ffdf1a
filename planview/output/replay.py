"""A recording tracked again up to a frame, and how the tracks differ."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from calib.errors import InputError, WorkError
from calib.ground_camera import GroundCamera
from calib.images import write_image
from calib.types import U8
from planview.engine.config import Config
from planview.engine.open import FIXED_TABLES, TrackerName, open_engine
from planview.evaluation.metrics import build_sequence, clear_scores, floor_similarity
from planview.output.render import SceneComposer, blank, frames_or_none, write_text
from planview.output.resume import part_name
from planview.output.run_folder import RunFolder
from planview.output.tables import reading_decisions
from planview.progress import Progress, unseen
from planview.tracking.base import Decision
from planview.trajectories.table import Trajectories, TrajectoryCollector
from stereo.matcher import Matcher
from stereo.readers import OpenOptions

DECISIONS_MAX = 20
TITLE_PX = 30


def difference_text(results: RunFolder, replayed: ReplayedRun, frame: int) -> list[str]:
    """Lines: when tracks begin to differ, people at the frame in both, and decisions that only one of them made."""
    before = _people_until(frame, results.as_tracked.tracks)
    after = _people_until(frame, replayed.results.tracks)
    differing = [row[0] for row in _rows(before) ^ _rows(after)]
    lines = ["tracks are the same up to this frame"]
    if differing:
        lines = [f"tracks differ from frame {min(differing)} on"]
    lines += _pairs_of_people(before.where(before.frame == frame), after.where(after.frame == frame))
    return lines + _different_decisions(results.path / "decisions.csv", replayed, frame)


def write_difference(results: RunFolder, replayed: ReplayedRun, frame: int, path: Path) -> None:
    """Write a picture: the frame as it was tracked on top, as it is tracked now below."""
    frames = frames_or_none(results, warnings.warn)
    image = None if frames is None else frames.image(frame)
    bounds = results.bounds()
    before = SceneComposer(results.as_tracked, bounds=bounds)(frame, image)
    after = SceneComposer(replayed.results, bounds=bounds)(frame, image)
    width = max(before.shape[1], after.shape[1])
    pictures = _with_title(before, "as it was run", width), _with_title(after, "tracked again", width)
    write_image(path, np.vstack(pictures))


def _with_title(picture: U8, title: str, width: int) -> U8:
    """A picture of at least this width, with a title above it."""
    strip = blank(TITLE_PX, width)
    write_text(strip, title, TITLE_PX - 10, 0.55)
    padded = np.pad(picture, ((0, 0), (0, width - picture.shape[1]), (0, 0)), constant_values=255)
    return np.vstack([strip, padded])


def _people_until(frame: int, tracks: Trajectories) -> Trajectories:
    return tracks.where((tracks.frame <= frame) & (tracks.state != "tentative"))


SAME_PLACE_M = 0.02
"""Positions that differ by less count as the same."""


def _rows(table: Trajectories) -> set[tuple[Any, ...]]:
    """Frame, id, state and rounded place of every row."""
    xy = np.column_stack([table.x_m, table.y_m])
    steps = np.round(np.nan_to_num(xy, nan=-1e6) / SAME_PLACE_M).astype(int)
    columns = (table.frame, table.track_id, table.state, steps[:, 0], steps[:, 1])
    return set(zip(*(column.tolist() for column in columns), strict=True))


def _pairs_of_people(before: Trajectories, after: Trajectories) -> list[str]:
    """A line per person at the frame; the same person in both by place, within 0.5 m, since ids may differ."""
    before = before.where(np.isfinite(before.x_m))
    after = after.where(np.isfinite(after.x_m))
    alone_before = set(range(len(before)))
    alone_after = set(range(len(after)))
    lines = []
    for a, b in clear_scores(build_sequence(before, after, floor_similarity(0.5))).matches.tolist():
        alone_before.discard(a)
        alone_after.discard(b)
        apart_m = math.hypot(before.x_m[a] - after.x_m[b], before.y_m[a] - after.y_m[b])
        lines.append(f"{_person_text(before, a)} -> {_person_text(after, b)}, {100 * apart_m:.0f} cm apart")
    lines += [f"only before: {_person_text(before, row)}" for row in sorted(alone_before)]
    lines += [f"only now: {_person_text(after, row)}" for row in sorted(alone_after)]
    return lines


def _person_text(table: Trajectories, row: int) -> str:
    return f"{table.track_id[row]} ({table.state[row]}, {table.x_m[row]:.2f}, {table.y_m[row]:.2f} m)"


FrameText = tuple[int, str]
"""Frame and words of a decision."""


def _different_decisions(path: Path, replayed: ReplayedRun, last: int) -> list[str]:
    """Decisions up to the last frame that only one of the runs made, the latest ones."""
    if not path.is_file():
        return ["no decisions.csv to compare decisions with"]
    before = _decisions_of(path, last)
    now = {(frame, f"{d.track_id} {d.kind}: {d.reason}") for frame, d in replayed.decisions}
    different = [(frame, "before", text) for frame, text in before - now]
    different += [(frame, "now", text) for frame, text in now - before]
    different.sort()
    lines = [f"only {run}, frame {frame}: {text}" for frame, run, text in different[-DECISIONS_MAX:]]
    n_left_out = len(different) - len(lines)
    if n_left_out:
        lines.insert(0, f"{n_left_out} earlier decisions that differ are left out")
    return lines


def _decisions_of(path: Path, last: int) -> set[FrameText]:
    """Decisions of a table up to the last frame, without matches."""
    decisions = set()
    with reading_decisions(path) as rows:
        for row in rows:
            frame = int(row["frame"])
            if row["kind"] != "matched" and frame <= last:
                decisions.add((frame, f"{row['id']} {row['kind']}: {row['reason']}"))
    return decisions


@dataclass(frozen=True, eq=False)
class ReplayedRun:
    """The run's folder with the tracks of the frames tracked again, their (frame, decision) without matches, and the
    recording that they were read from."""

    results: RunFolder
    decisions: list[tuple[int, Decision]]
    source: Path


def replay_run(
    results: RunFolder,
    config: Config,
    frame: int,
    progress: Progress = unseen,
    matcher: Matcher | None = None,
) -> ReplayedRun:
    """Track up to a frame with other parameters: the plan-view recording of the run where they leave it valid, else the
    recording, with the run's own matcher. Raises InputError: no recording any more, parameters that its maps exclude,
    or another matcher. WorkError: the recording ends before the frame."""
    path = _source(results, config)
    options: OpenOptions | None = results.info.opened
    missing = dict(results.info.own_parts)
    if matcher is not None:
        used = missing.pop("matcher", "SGBM")
        if part_name(matcher) != used:
            expected = f"expected {used}, with which the run was tracked, found {part_name(matcher)}"
            raise InputError(expected, argument="matcher")
    if path == results.path / "maps.h5":  # these hold what a matcher and sensors of the user's own measured
        matcher = options = None
        missing = {role: name for role, name in missing.items() if role == "tracker"}
    remedy = "replay it from Python and give the same matcher" if [*missing] == ["matcher"] else "run it again"
    results.refuse_own_parts(missing, remedy)
    camera = cast(GroundCamera | None, results.camera)  # of a rig it is not used
    engine = open_engine(path, cast(TrackerName, results.info.tracker), config, camera, options, matcher)
    collector = TrajectoryCollector()
    decisions = []
    reached = -1
    first = results.info.first_frame
    engine.reset()
    for result in engine.after(first - 1, frame):
        reached = result.frame
        collector.add(result.frame, result.timestamp_s, result.tracks)
        decisions += [(result.frame, decision) for decision in result.decisions if decision.kind != "matched"]
        progress(result.frame + 1 - first, frame + 1 - first)
    could_be_read = all(skipped.index != frame for skipped in engine.recording.skipped)
    if reached < frame and could_be_read:
        raise WorkError(f"{path}: expected frame {frame}, found the end of the recording after frame {reached}")
    return ReplayedRun(replace(results, other_tracks=collector.trajectories()), decisions, path)


def _source(results: RunFolder, config: Config) -> Path:
    """The run's maps.h5 where the changed parameters leave it valid, else its recording."""
    maps = results.path / "maps.h5"
    fixed = all(getattr(results.config, table) == getattr(config, table) for table in (*FIXED_TABLES, "maps"))
    if maps.is_file() and fixed:
        return maps
    path = results.tracked
    if path is None or not path.exists():
        raise InputError(f"{path}: expected the recording of the run, found nothing there")
    return path
