"""``planview run``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from calib.errors import InputError
from planview.commands.options import Flag, JsonFlag
from planview.commands.source import open_options
from planview.counting.geometry import RulePlane
from planview.counting.rules import load_rules
from planview.counting.stream import Analytics
from planview.engine.config import Config, load_config
from planview.engine.engine import Engine
from planview.engine.factory import TrackerName, base_config, open_engine
from planview.engine.kept_setup import KeptSetup
from planview.maps.recording import is_maps
from planview.output.checkpoint.file import Checkpoint
from planview.output.compiling import compile_notice
from planview.output.console import PlainConsole
from planview.output.folder import check_folder, prepare_folder
from planview.output.info import RunInfo
from planview.output.lock import folder_lock
from planview.output.log import RunLog
from planview.output.pace import Pace
from planview.output.progress import FrameProgress, summary
from planview.output.resume import checkpoint_of, is_finished
from planview.output.run import RunOptions, run_identity
from planview.output.run import run as run_engine
from planview.sweep.jobs import content_key, engine_version, files_beside, key_of
from stereo.readers.open import is_heads


@Parameter(name="*")
@dataclass(frozen=True)
class TrackingOptions:
    """How the recording is tracked, and what is written."""

    tracker: TrackerName = "template"
    """Plan-view templates, or harville, the paper's (stereo); a human model, or ellipses and particles (one camera)."""
    camera: Path | None = None
    """camera.toml of a single camera (planview calibrate human writes it)."""
    person_height: float | None = None
    """Height of a person in the image in pixels, for ellipse-particle on one camera; learned when not given."""
    calibration: Path | None = None
    """Calibration of the stereo pair, when it does not lie in the recording."""
    topics: str | None = None
    """Topics of a bag, LEFT,RIGHT or IMAGE,DEPTH, where they are not clear from their names."""
    fps: float | None = None
    """Frames per second, in place of the recording's own times."""
    rules: Path | None = None
    """rules.toml with tripwires and zones to count while tracking."""
    config: Path | None = None
    """TOML file with parameters, a table per stage."""
    set_: Annotated[Sequence[str], Parameter(name="--set")] = ()
    """One parameter, e.g. --set foreground.learning_rate=0.002; may be given several times."""
    rrd: Flag = False
    """Also write run.rrd, to be looked at with planview view."""
    rrd_every: int = 1
    """Images, clouds and maps of every n-th frame only go into run.rrd; people and curves of all."""
    save_maps: Flag = False
    """Also write maps.h5: foreground points of every frame as disparities and coarse colour codes, without images."""
    debug: Flag = False
    """Also write decisions.csv: every decision of the tracker with its reason."""
    overwrite: Flag = False
    """Replace what a run, or another program under the same names, left in the folder."""
    resume: Flag = False
    """Go on with the run that was interrupted or killed in this folder: the same results as without interruption."""
    checkpoint_every: float = 30.0
    """Time between two checkpoints to resume from, in seconds; 0 for none."""
    fresh: Flag = False
    """Look for floor and row offset again: what an earlier run found out about the same recording is not used."""
    strict: Flag = False
    """Refuse a recording that fails one of doctor's cheap checks (exit status 2) instead of warning of it."""
    pace: Flag = False
    """Track in real time: frames come when their timestamps say, those that cannot be kept up with are dropped, and the
    latency from a frame's timestamp to its tracks is printed (median, 95 %, 99 %). Writes no checkpoints."""
    frames: int = 0
    """Stop after so many frames; 0 for all."""
    refine: Flag = False
    """Refine the tracks afterwards, knowing the whole recording (as planview refine does)."""
    json_output: JsonFlag = False
    """Print run.json to standard output at the end."""


def run(recording: Path, *, out: Path, options: TrackingOptions | None = None) -> None:
    """Track people in a recording: tracks.csv, run.json and report.html in a folder.

    Example: planview run my_recording --out out --rrd

    Example of saving the plan-view maps and tracking them again: planview run my_recording --out out --save-maps, then
    planview run out/maps.h5 --out again --tracker harville

    Example with one camera: planview run street.mp4 --tracker human-model --camera camera.toml --out out

    Example without any calibration: planview run street.mp4 --tracker ellipse-particle --out out

    Parameters
    ----------
    recording
        Folder with left/ and right/ images or videos (or one side-by-side video) and a calibration; or one video;
        or maps.h5 of an earlier run. Maps are tracked with the parameters that made them, changed by --config and
        --set: with the same tracker and parameters the tracks are the same, with others they are an approximation,
        since the earlier tracker's feedback to the foreground stays in the maps.
    out
        Folder for the results; made if need be.
    """
    options = options or TrackingOptions()
    _refuse(options)
    settings = load_config(options.config, _settings(options), base_config(recording))
    check_folder(out, options.overwrite or options.resume, recording)
    console = PlainConsole(stderr=True)
    if options.resume and is_finished(out):
        console.print(f"{out}: the run is finished; nothing is left to resume")
        return
    with compile_notice(console):
        info = _opened_and_tracked(recording, out, options, settings, console)
    summary(console, info, out)
    if options.json_output:
        print(info.model_dump_json())


def _opened_and_tracked(
    recording: Path, out: Path, options: TrackingOptions, settings: Config, console: Console
) -> RunInfo:
    source = open_options(options.calibration, options.fps, options.topics)
    with console.status("opening the recording, aligning rows, finding the floor"):
        kept = None if options.fresh or options.strict else kept_setup(recording, settings, options)
        engine = open_engine(recording, options.tracker, settings, options.camera, source, kept=kept)
    if options.save_maps:
        _refuse_to_save_maps(recording, engine)
    analytics = Analytics(load_rules(options.rules, RulePlane(engine.camera, engine.size))) if options.rules else None
    with folder_lock(out) as stale:
        if stale:
            console.print(stale)
        return _track(engine, out, options, analytics, console)


def _refuse(options: TrackingOptions) -> None:
    """Refuse values out of range and options that exclude one another (InputError)."""
    if options.frames < 0:
        raise InputError(f"--frames: expected a number from 0, found {options.frames}")
    if not 0 <= options.checkpoint_every < math.inf:
        raise InputError(f"--checkpoint-every: expected a time from 0 s, found {options.checkpoint_every:g}")
    if options.rrd_every < 1:
        raise InputError(f"--rrd-every: expected a number from 1, found {options.rrd_every}")
    if options.resume and options.overwrite:
        raise InputError("expected --resume or --overwrite, found both")
    if options.resume and options.pace:
        raise InputError("expected --resume or --pace, found both: a run in real time has no checkpoints to go on from")


def _refuse_to_save_maps(recording: Path, engine: Engine) -> None:
    """Refuse --save-maps where maps.h5 cannot hold what is tracked (InputError)."""
    if engine.stereo is None or is_maps(recording):
        raise InputError(f"--save-maps: expected a stereo recording, found {recording}")
    if is_heads(recording):
        raise InputError("--save-maps: expected a recording of one head, whose view maps.h5 holds, found several heads")


def kept_setup(recording: Path, config: Config, options: TrackingOptions) -> KeptSetup | None:
    """Where floor and row offset of a recording are kept, by its content; None for what is no file or folder.

    Pipes, devices and what is missing are refused with their own sentence where they are opened.
    """
    inputs = [recording, *([options.calibration] if options.calibration else files_beside(recording))]
    if not all(path.is_file() or path.is_dir() for path in inputs):
        return None
    contents = [content_key(path) for path in inputs]
    tables = [table.model_dump(mode="json") for table in (config.rectify, config.range, config.sgbm, config.floor)]
    frames = config.analysis.setup_frames
    return KeptSetup(key_of(contents, tables, frames, options.topics, options.fps, engine_version()))


def _track(
    engine: Engine, out: Path, options: TrackingOptions, analytics: Analytics | None, console: Console
) -> RunInfo:
    how = RunOptions(
        options.tracker, analytics, options.debug, options.frames, options.checkpoint_every, options.strict,
        Pace() if options.pace else None,
    )  # fmt: skip
    checkpoint = None
    if options.resume:
        identity = run_identity(engine, how, _log_names(options), out)
        checkpoint = checkpoint_of(out, identity, lambda text: console.print(text, soft_wrap=True))
    if checkpoint is None:
        prepare_folder(out, options.overwrite or options.resume)
    logs = _logs(engine, out, options, checkpoint)
    announced = engine.recording.n_frames
    n_frames = min(options.frames or announced, announced) if announced else options.frames or None
    with FrameProgress(console, n_frames) as progress:
        info = run_engine(engine, out, how, logs, progress, checkpoint)
    from planview.output.report.page import write_report

    write_report(out)
    if options.refine:
        from planview.output.refine import refine_run

        info = refine_run(out).info
    return info


def _log_names(options: TrackingOptions) -> list[str]:
    return ["MapsLog"] * options.save_maps + ["RerunLog"] * options.rrd


def _logs(engine: Engine, out: Path, options: TrackingOptions, checkpoint: Checkpoint | None) -> list[RunLog]:
    positions = checkpoint.written["logs"] if checkpoint else {}
    logs: list[RunLog] = []
    if options.save_maps:
        from planview.output.maps_log import MapsLog

        logs.append(MapsLog(engine, out / "maps.h5", positions.get("MapsLog")))
    if options.rrd:
        from planview.output.rerun.log import RerunLog

        logs.append(RerunLog(engine, out / "run.rrd", positions.get("RerunLog"), options.rrd_every))
    return logs


def _settings(options: TrackingOptions) -> list[str]:
    """What --set and the options for single parameters say."""
    height = options.person_height
    if height is None:
        return list(options.set_)
    if options.tracker != "ellipse-particle":
        raise InputError(f"--person-height: expected --tracker ellipse-particle with it, found {options.tracker}")
    if not 0 < height <= 20_000:
        raise InputError(f"--person-height: expected a height from 0 to 20000 px, found {height:g}")
    return [*options.set_, f"ellipse_particle.size.person_height_px={height}"]
