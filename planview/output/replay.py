"""A recording tracked again up to a frame, and how the tracks differ."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np

from calib.errors import InputError, WorkError
from calib.ground_camera import GroundCamera
from calib.types import U8
from planview.engine.config import Config
from planview.engine.engine import FrameResult
from planview.engine.open import FIXED_TABLES, TrackerName, open_engine
from planview.evaluation.metrics import build_sequence, clear_scores, floor_similarity
from planview.maps.recording import is_maps
from planview.output.render import SceneComposer, SceneFrames
from planview.output.run_folder import RunFolder
from planview.output.tables import reading_decisions
from planview.tracking.base import Decision
from planview.trajectories.table import Trajectories, TrajectoryCollector

DECISIONS_MAX = 20
TITLE_PX = 30


def difference_text(results: RunFolder, replayed: ReplayedRun, frame: int) -> list[str]:
    """Lines: when tracks begin to differ, people at the frame in both, and decisions that only one of them made."""
    before = _people_until(frame, results.as_tracked.tracks)
    after = _people_until(frame, replayed.results.tracks)
    differing = sorted({frame for frame, *_ in _rows(before) ^ _rows(after)})
    lines = [f"tracks differ from frame {differing[0]} on" if differing else "tracks are the same up to this frame"]
    lines += _people(before.where(before.frame == frame), after.where(after.frame == frame))
    return lines + _decisions(results.path / "decisions.csv", replayed, frame)


def difference_picture(
    results: RunFolder, replayed: ReplayedRun, frames: SceneFrames | None, frame: int, title: str
) -> U8:
    """(H, W, 3) uint8 BGR: the frame as it was tracked on top, as it is tracked now below."""
    image = next((image for _, image in frames.at([frame])), None) if frames is not None else None
    runs = results.as_tracked, replayed.results
    shown = [SceneComposer(run, bounds=results.bounds())(frame, image) for run in runs]
    width = max(picture.shape[1] for picture in shown)
    rows = []
    for picture, text in zip(shown, ("as it was run", title), strict=True):
        strip: U8 = np.full((TITLE_PX, width, 3), 235, dtype=np.uint8)
        cv2.putText(strip, text, (8, TITLE_PX - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (40, 40, 40), 1, cv2.LINE_AA)
        rows += [strip, np.pad(picture, ((0, 0), (0, width - picture.shape[1]), (0, 0)), constant_values=255)]
    return np.vstack(rows)


def _people_until(frame: int, tracks: Trajectories) -> Trajectories:
    return tracks.where((tracks.frame <= frame) & (tracks.state != "tentative"))


def _rows(table: Trajectories) -> set[tuple[Any, ...]]:
    # Positions that differ by less count as the same [m].
    x, y = (np.round(np.nan_to_num(values, nan=-1e6) / 0.02).astype(int) for values in (table.x_m, table.y_m))
    columns = (table.frame, table.track_id, table.state, x, y)
    return set(zip(*(column.tolist() for column in columns), strict=True))


def _people(*tables: Trajectories) -> list[str]:
    """A line per person at the frame; the same person in both by place, within 0.5 m, since ids may differ."""
    before, after = (table.where(np.isfinite(table.x_m)) for table in tables)
    matches = clear_scores(build_sequence(before, after, floor_similarity(0.5))).matches.tolist()
    lines = []
    for a, b in matches:
        apart = math.hypot(before.x_m[a] - after.x_m[b], before.y_m[a] - after.y_m[b])
        lines.append(f"{_described(before, a)} -> {_described(after, b)}, {100 * apart:.0f} cm apart")
    for n, (which, known) in enumerate((("only before", before), ("only now", after))):
        alone = set(range(len(known))) - {pair[n] for pair in matches}
        lines += [f"{which}: {_described(known, row)}" for row in sorted(alone)]
    return lines


def _described(table: Trajectories, row: int) -> str:
    return f"{table.track_id[row]} ({table.state[row]}, {table.x_m[row]:.2f}, {table.y_m[row]:.2f} m)"


def _decisions(path: Path, replayed: ReplayedRun, last: int) -> list[str]:
    """Decisions that only one of the runs made, the latest ones; none where the run kept no decisions."""
    if not path.is_file():
        return ["no decisions.csv to compare decisions with"]
    with reading_decisions(path) as read:
        rows = [
            (int(row["frame"]), f"{row['id']} {row['kind']}: {row['reason']}")
            for row in read
            if row["kind"] != "matched" and int(row["frame"]) <= last
        ]
    now = [(frame, f"{d.track_id} {d.kind}: {d.reason}") for frame, d in replayed.decisions]
    only = [(frame, f"only before, frame {frame}: {text}") for frame, text in rows if (frame, text) not in set(now)]
    only += [(frame, f"only now, frame {frame}: {text}") for frame, text in now if (frame, text) not in set(rows)]
    only.sort(key=lambda item: item[0])
    more = len(only) - DECISIONS_MAX
    left_out = [f"{more} earlier decisions that differ are left out"] if more > 0 else []
    return left_out + [text for _, text in only[-DECISIONS_MAX:]]


@dataclass(frozen=True, eq=False)
class ReplayedRun:
    """The run's folder with the tracks of the frames tracked again, their (frame, decision) without matches, and the
    recording that they were read from."""

    results: RunFolder
    decisions: list[tuple[int, Decision]]
    source: Path


def replay_run(
    results: RunFolder, config: Config, frame: int, watch: Callable[[FrameResult], None] | None = None
) -> ReplayedRun:
    """Track up to a frame with other parameters: the plan-view recording of the run where they leave it valid, else the
    recording. Raises InputError: no recording any more, or parameters that its maps exclude. WorkError: the recording
    ends before the frame."""
    path = _source(results, config)
    _refuse_own_parts(results, path)
    options = None if is_maps(path) else results.options
    camera = results.camera if isinstance(results.camera, GroundCamera) else None
    engine = open_engine(path, cast(TrackerName, results.info.tracker), config, camera, options)
    collector, decisions, reached = TrajectoryCollector(), [], -1
    engine.reset()
    for result in engine.after(results.info.first_frame - 1):
        if result.frame <= frame:
            collector.add(result.frame, result.timestamp_s, result.tracks)
            decisions += [(result.frame, decision) for decision in result.decisions if decision.kind != "matched"]
            if watch:
                watch(result)
        reached = result.frame
        if reached >= frame:
            break
    if reached < frame:
        raise WorkError(f"{path}: expected frame {frame}, found the end of the recording after frame {reached}")
    return ReplayedRun(replace(results, other_tracks=collector.trajectories()), decisions, path)


def _refuse_own_parts(results: RunFolder, path: Path) -> None:
    """Raise InputError for parts that the user made: a folder does not keep them. Its maps hold what its matcher and
    its heads measured."""
    names = results.info.own_parts
    needed = names.keys() & {"tracker"} if is_maps(path) else names.keys()
    if needed:
        parts = " and ".join(f"{role} {names[role]}" for role in sorted(needed))
        kept = "" if "tracker" in needed else "; a run that also writes maps.h5 can be replayed"
        raise InputError(f"{results.path}: tracked with your own {parts}, which the folder does not keep{kept}")


def _source(results: RunFolder, config: Config) -> Path:
    """The run's maps.h5 where the changed parameters leave it valid, else its recording."""
    maps = results.path / "maps.h5"
    fixed = all(getattr(results.config, table) == getattr(config, table) for table in (*FIXED_TABLES, "maps"))
    if maps.is_file() and fixed:
        return maps
    path = results.tracked if results.tracked is not None and is_maps(results.tracked) else results.recording
    if path is None or not path.exists():
        raise InputError(f"{path}: expected the recording of the run, found nothing there")
    return path
