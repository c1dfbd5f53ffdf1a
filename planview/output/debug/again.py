"""Track a run's recording again up to a frame, with other parameters, from its nearest checkpoint."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from calib.errors import InputError, WorkError
from calib.ground_camera import save_ground_camera
from calib.params import Params
from planview.engine.config import Config, config_of
from planview.engine.engine import Engine, FrameResult
from planview.engine.factory import TrackerName, open_engine
from planview.engine.maps_pipeline import FIXED_TABLES
from planview.maps.recording import is_maps
from planview.output.checkpoint import classes
from planview.output.checkpoint.decode import decode
from planview.output.checkpoint.encode import Encoded
from planview.output.checkpoint.file import checkpoints_in, read_checkpoint
from planview.output.info import RunInfo
from planview.output.scene.frames import ground_camera_of
from planview.output.scene.results import RunResults
from planview.output.scene.source import source_of
from planview.output.totals import RunTotals
from planview.tracking.base import Decision
from planview.trajectories.table import TrajectoryCollector


@dataclass(frozen=True, eq=False)
class TrackedAgain:
    """The same frames tracked again.

    Attributes:
        results: the run's, with the tracks of the frames tracked again.
        decisions: (frame, decision) of those frames, matches left out.
        first: first frame tracked again.
        begun_from: what it was begun from, in words.
    """

    results: RunResults
    decisions: list[tuple[int, Decision]]
    first: int
    begun_from: str


def track_again(
    results: RunResults, config: Config, frame: int, watch: Callable[[FrameResult], None] | None = None
) -> TrackedAgain:
    """Track up to a frame with other parameters.

    The frames begin after the nearest checkpoint (which an interrupted run keeps); without one at the first frame, of
    the plan-view recording where the run left one and the parameters do not concern what comes before it.

    Args:
        frame: the last one.
        watch: called after every frame.
    Raises:
        InputError: no recording any more, or parameters that its maps exclude.
        WorkError: the recording ends before the frame.
    """
    base = config_of(results.info.config, str(results.folder / "run.json"))
    path = _source(results, base, config)
    engine = _engine(path, results.info, config)
    last, begun_from = (-1, f"the first frame of {path}")
    if not is_maps(path):
        last, begun_from = _restored(results.folder, engine, base, config, frame) or (last, begun_from)
    collector, decisions = TrajectoryCollector(), []
    reached = last
    for result in _up_to(engine, last, frame):
        collector.add(result.frame, result.timestamp_s, result.tracks)
        decisions += [(result.frame, decision) for decision in result.decisions if decision.kind != "matched"]
        reached = result.frame
        if watch:
            watch(result)
    if reached < frame:
        raise WorkError(f"{path}: expected frame {frame}, found the end of the recording after frame {reached}")
    return TrackedAgain(replace(results, tracks=collector.trajectories()), decisions, last + 1, begun_from)


def _up_to(engine: Engine, last: int, frame: int) -> Iterator[FrameResult]:
    if last < 0:
        engine.reset()
    for result in engine.after(last):
        if result.frame <= frame:
            yield result
        if result.frame >= frame:
            return


def _source(results: RunResults, base: Config, config: Config) -> Path:
    """The run's maps.h5 where the changed parameters leave it valid, else its recording."""
    maps = results.folder / "maps.h5"
    fixed = all(getattr(base, table) == getattr(config, table) for table in (*FIXED_TABLES, "maps"))
    if maps.is_file() and fixed:
        return maps
    path = Path(results.info.input) if is_maps(Path(results.info.input)) else source_of(results.info)
    if not path.exists():
        raise InputError(f"{path}: expected the recording of the run, found nothing there")
    return path


def _engine(path: Path, info: RunInfo, config: Config) -> Engine:
    tracker = cast(TrackerName, info.tracker)
    camera = ground_camera_of(info) if info.floor is not None and info.floor.world_SE3_left is None else None
    if camera is None:
        return open_engine(path, tracker, config)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "camera.toml"
        save_ground_camera(camera, file)
        return open_engine(path, tracker, config, file)


def _restored(folder: Path, engine: Engine, base: Config, config: Config, frame: int) -> tuple[int, str] | None:
    """The engine at the nearest checkpoint before a frame: the checkpoint's last frame, and words for it."""
    for path in checkpoints_in(folder):
        totals = RunTotals()
        try:
            memory = changed_memory(read_checkpoint(path).memory, base, config)
            decode(memory, {"totals": totals, **engine.memory()})
        except (ValueError, KeyError):
            engine.reset()
            continue
        if totals.last_frame < frame:
            return totals.last_frame, f"the checkpoint after frame {totals.last_frame}"
        engine.reset()
    return None


def changed_memory(memory: Encoded, base: Config, config: Config) -> Encoded:
    """The memory of a checkpoint in which parameters have their changed values."""
    changes = dict(_changes(base, config))
    nodes = []
    for node in memory.nodes:
        if node[0] == "params" and node[1] in changes:
            values = {k: changes[node[1]].get(k, v) for k, v in node[2].items()}
            nodes.append([node[0], node[1], values])
        else:
            nodes.append(node)
    return Encoded(memory.roots, nodes, memory.blocks)


def _changes(base: Params, config: Params) -> Iterator[tuple[str, dict[str, Any]]]:
    """By class of parameters, the plain values that differ."""
    differing: dict[str, Any] = {}
    for name in type(base).model_fields:
        before, after = getattr(base, name), getattr(config, name)
        if isinstance(before, Params) and isinstance(after, Params):
            yield from _changes(before, after)
        elif before != after:
            differing[name] = after
    if differing:
        yield classes.name_of(type(base)), differing
