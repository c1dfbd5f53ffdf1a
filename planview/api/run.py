"""A recording tracked, and tracked again."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

from numpy.typing import ArrayLike
from rich.console import Console

from calib.errors import InputError
from calib.formats.one_camera import holds_one_camera
from calib.ground_camera import GroundCamera
from calib.images import write_image
from planview.api.arguments import Frames, Settings, frame_span, in_range, opening, path_of, settings
from planview.counting.rules import RulePlane, load_rules
from planview.counting.stream import Analytics
from planview.engine.engine import Engine, FrameResult
from planview.engine.open import AnyTracker, ImageTrackerName, base_config, open_engine
from planview.offline.refine import refine as refined
from planview.output.finished import refine_held_run
from planview.output.folder import HoldsResultsError, check_folder, finished_run, folder_lock, refuse_held
from planview.output.progress import FrameProgress, PlainConsole, compile_notice
from planview.output.render import frames_or_none
from planview.output.replay import difference_picture, difference_text, replay_run
from planview.output.report.page import write_report
from planview.output.resume import checkpoint_of, remove_checkpoint
from planview.output.run import (
    RunLog,
    RunOptions,
    begin_run,
    refuse_another_run,
    run_identity,
    skipped_between,
    track_into,
)
from planview.output.run_folder import RunFolder
from planview.output.tables import MapsLog, refuse_unrecorded
from planview.output.viewer import LiveViewer
from planview.trajectories.table import Trajectories, TrajectoryCollector
from stereo.matcher import Matcher


@dataclass(frozen=True)
class _Written:
    """What a run tracks and writes, and whether it resumes."""

    out: Path | None
    rules: Path | None
    refine: bool
    strict: bool
    rrd_every: int
    """0 for no run.rrd."""
    maps: bool
    frames: Frames | None
    overwrite: bool
    resume: bool
    checkpoint_every_s: float
    viewer: LiveViewer | None
    watch: Callable[[FrameResult], None] | None


def run(
    recording: Engine | Path | str,
    right: Path | str | None = None,
    *,
    out: Path | str | None = None,
    calibration: Path | str | None = None,
    camera: GroundCamera | Path | str | None = None,
    topics: str | None = None,
    fps: float | None = None,
    strict: bool = False,
    tracker: AnyTracker = "joint",
    detections: Path | str | Sequence[ArrayLike] | None = None,
    matcher: Matcher | None = None,
    config: Settings | None = None,
    set: Sequence[str] = (),
    refine: bool = False,
    rules: Path | str | None = None,
    rrd: bool = False,
    rrd_every: int = 1,
    maps: bool = False,
    frames: Frames | None = None,
    view: bool | LiveViewer = False,
    watch: Callable[[FrameResult], None] | None = None,
    quiet: bool = False,
    overwrite: bool = False,
    resume: bool = False,
    checkpoint_every: float = 30.0,
) -> Trajectories:
    """Track people in a recording: tracks.csv, run.json and report.html in a folder.

    Example: planview run my_recording --out out --rrd

    Example of two videos, or two folders of images: planview run left.mp4 right.mp4 --calibration rig.toml --out out

    Example of saving the plan-view maps and tracking them again:
        planview run my_recording --out out --maps
        planview run out/maps.h5 --out again --tracker template

    Example of watching it while it goes on: planview run my_recording --out out --view

    Example with one camera: planview run street.mp4 --tracker human-model --calibration camera.toml --out out

    Example without any calibration: planview run street.mp4 --tracker ellipse-particle --out out

    Example with a detector's boxes: planview run street.mp4 --detections det.txt --calibration camera.toml --out out

    Args:
        recording: Folder with left/ and right/ images or videos (or one side-by-side video) and a calibration; or one
            video; or the left one of two videos or folders of images; or maps.h5 of an earlier run. Maps are tracked
            with the parameters that made them, changed by ``config`` and ``set``; other parameters than before give an
            approximation.
        right: The right one of two videos or folders of images.
        out: Folder for the results (required); created where it does not exist.
        calibration: Calibration of the stereo pair, if it is not in the recording; or camera.toml of a single camera
            (planview calibrate human writes it), or its Tsai XML.
        camera: The single camera itself, or the file of its calibration.
        topics: Topics of a bag, LEFT,RIGHT or IMAGE,DEPTH, where they are not clear from their names.
        fps: Frames per second, where times are missing or wrong.
        strict: Refuse a recording that fails one of the cheap checks (exit status 2) instead of warning about it.
        tracker: joint (every pixel explained by people) or template (Harville's) for stereo and depth; human-model or
            ellipse-particle for one camera.
        detections: Boxes of people from a detector of your own (MOTChallenge det.txt or COCO results), tracked instead
            of what moves; one camera only.
        matcher: Of stereo pairs; SGBM when None.
        config: TOML file with parameters of a run, a table per stage.
        set: One parameter, e.g. ``set`` foreground.learning_rate=0.002; can be repeated.
        refine: Refine the tracks afterwards, knowing the whole recording (as planview refine does).
        rules: rules.toml with tripwires and zones to count while tracking.
        rrd: Also write run.rrd, which planview view opens.
        rrd_every: Images, clouds and maps of every n-th frame only go into run.rrd; people and curves of all.
        maps: Also write maps.h5: foreground points of every frame as disparities and coarse colour codes, without
            images.
        frames: Frames to track, FIRST:LAST, or N for the first N: the background is learned from the first of them on.
        view: Show the run in rerun while it goes on: in a window, or where there is no display on a page whose address
            is printed.
        watch: Called after every frame.
        quiet: Print nothing but errors.
        overwrite: Replace the results of an earlier run in the folder.
        resume: Resume the run that was interrupted or killed in this folder: the same results as without interruption.
        checkpoint_every: Time between two checkpoints to resume from, in seconds; 0 for none.

    Returns:
        The tracks. In Python the folder may be left out, and nothing is written.

    Raises:
        InputError: a recording, calibration or camera that is missing or does not fit; results in the folder.
        WorkError: no floor is visible, or the folder cannot be written.
    """
    in_range("rrd_every", rrd_every, 1, 100_000)
    in_range("checkpoint_every", checkpoint_every, 0, 86_400, " s")
    for name, is_given in (("overwrite", overwrite), ("detections", detections is not None)):
        if resume and is_given:
            raise InputError(f"resume and {name} cannot be combined")
    every = rrd_every if rrd else 0
    console = PlainConsole(stderr=True, quiet=quiet)
    viewer = LiveViewer() if view is True else view or None
    what = _Written(
        path_of(out), path_of(rules), refine, strict, every, maps, frames, overwrite, resume, checkpoint_every, viewer,
        watch,
    )  # fmt: skip
    if isinstance(recording, Engine):
        named = {"right": right, "calibration": calibration, "camera": camera, "topics": topics, "fps": fps,
                 "detections": detections, "matcher": matcher, "config": config, "set": set or None}  # fmt: skip
        if given := [name for name, value in named.items() if value is not None]:
            raise InputError(f"an engine has its own {' and '.join(given)}: give them to open_engine")
        _refuse_results(what, None)
        return _tracked(recording, what, console)
    path = Path(recording)
    parameters = settings(config, set, base_config(path))
    _refuse_results(what, path)
    single = camera
    if calibration is not None and is_of_one_camera(Path(calibration), tracker, detections is not None):
        single = Path(calibration)
        calibration = None
    options = opening(calibration, fps, topics, right)
    with compile_notice(console):
        with console.status("opening the recording, aligning rows, finding the floor"):
            engine = open_engine(path, tracker, parameters, single, options, matcher, detections)
        return _tracked(engine, what, console)


def is_of_one_camera(calibration: Path, tracker: AnyTracker, detections: bool = False) -> bool:
    """Whether a calibration is of one camera rather than of a pair."""
    images = tracker in get_args(ImageTrackerName) if isinstance(tracker, str) else tracker.needs == "image"
    return images or detections or calibration.name == "camera.toml" or holds_one_camera(calibration)


def _refuse_results(what: _Written, recording: Path | None) -> None:
    if what.out is None:
        needing = {"rules": what.rules, "rrd": what.rrd_every, "maps": what.maps, "resume": what.resume}
        if given := [name for name, value in needing.items() if value]:
            raise InputError(f"{' and '.join(given)} need a folder for the results", remedy="out")
        return
    refuse_held(what.out)
    try:
        check_folder(what.out, what.overwrite or what.resume, recording)
    except HoldsResultsError as error:
        raise InputError(f"{error}; choose another folder or pass overwrite=True") from error


def _end(out: Path, refine: bool, console: Console) -> None:
    """Do what a kill after the last frame left undone, the page last."""
    info = RunFolder(out).info
    remove_checkpoint(out)
    if (out / "report.html").is_file() and (info.refined or not refine):
        console.print(f"{out}: the run is finished; nothing is left to resume")
    elif info.refined or refine:
        refine_held_run(out)
    else:
        write_report(out)


def _tracked(engine: Engine, what: _Written, console: Console) -> Trajectories:
    announced = engine.recording.n_frames
    first, last = (0, None) if what.frames is None else frame_span(what.frames)
    if announced and first >= announced:
        raise InputError(f"the recording has only {announced} frames, 0 to {announced - 1}", argument="frames")
    ends = [announced] if announced else []
    if last is not None:
        ends.append(last + 1)
    progress = FrameProgress(console, min(ends) - first if ends else None, first)
    if what.out is None:
        return _tracked_in_memory(engine, first, last, what, progress)
    if what.maps:
        refuse_unrecorded(engine)
    plane = RulePlane(engine.camera, engine.size, has_floor=engine.camera is not None)
    analytics = Analytics(load_rules(what.rules, plane)) if what.rules else None
    every_s = 0.0 if engine.tracker_name == "detections" else what.checkpoint_every_s
    with folder_lock(what.out):
        how = RunOptions(analytics, first, last, every_s, what.strict)
        if what.resume and finished_run(what.out) is not None:
            refuse_another_run(engine, how, what.out)
            _end(what.out, what.refine, console)
        else:
            _write(engine, what.out, what, how, console, progress)
            if what.refine:
                refine_held_run(what.out)
        return _tracks_in(what.out)


def _tracked_in_memory(
    engine: Engine, first: int, last: int | None, what: _Written, progress: FrameProgress
) -> Trajectories:
    """Tracks of the frames from the first to the last, or to the end, without a folder."""
    rows = TrajectoryCollector()
    n_read = 0
    engine.reset()
    with _watched(engine, what, progress) as watch:
        for result in engine.after(first - 1, last):
            rows.add(result.frame, result.timestamp_s, result.tracks)
            n_read += 1
            watch(result)
    tracks = rows.trajectories()
    if what.refine:
        tracks = refined(tracks).tracks
    n_frames = first + n_read + len(skipped_between(engine, first, last))
    return replace(tracks, first_frame=first, n_frames=n_frames)


@contextmanager
def _watched(engine: Engine, what: _Written, progress: FrameProgress) -> Iterator[Callable[[FrameResult], None]]:
    """What is called with every frame: shows progress, feeds the viewer, and calls the user's own function."""
    with ExitStack() as stack:
        calls = [stack.enter_context(progress), what.watch]
        if what.viewer is not None:
            calls.append(stack.enter_context(what.viewer.showing(engine)))

        def watch(result: FrameResult) -> None:
            for call in filter(None, calls):
                call(result)

        yield watch


def _write(
    engine: Engine, out: Path, what: _Written, how: RunOptions, console: Console, progress: FrameProgress
) -> None:
    """Track into a folder, from the checkpoint in it where the run resumes."""
    checkpoint = None
    if what.resume:
        names = ["MapsLog"] * what.maps + ["RerunLog"] * (what.rrd_every > 0)
        identity = run_identity(engine, how, names)
        checkpoint = checkpoint_of(out, identity, lambda text: console.print(text, soft_wrap=True))
    if checkpoint is None:
        begin_run(engine, out, how, overwrite=what.overwrite or what.resume)
    positions = checkpoint.written["logs"] if checkpoint else {}
    logs: list[RunLog] = []
    if what.maps:
        logs.append(MapsLog(engine, out / "maps.h5", positions.get("MapsLog")))
    if what.rrd_every:
        from planview.output.rerun_log import RerunLog  # rerun takes a second, and few runs write for it

        logs.append(RerunLog(engine, out / "run.rrd", what.rrd_every, resumed=checkpoint is not None))
    with _watched(engine, what, progress) as watch:
        track_into(engine, out, how, logs, watch, checkpoint)
    write_report(out)
    if how.analytics is not None and (note := how.analytics.rules.unreached(RunFolder(out).tracks)):
        console.print(note, soft_wrap=True)


def _tracks_in(out: Path) -> Trajectories:
    return RunFolder(out).tracks


@dataclass(frozen=True, eq=False)
class Replay:
    """A run tracked again; printed, what differs.

    Attributes:
        source: what was tracked: the maps of the run, or its recording.
        tracks: of the frames up to the one that was looked at.
        picture: the frame as it was run and as it is tracked now.
    """

    source: Path
    tracks: Trajectories
    picture: Path
    lines: tuple[str, ...]

    def __repr__(self) -> str:
        return "\n".join(self.lines)


def replay(
    folder: Path | str,
    frame: int,
    *,
    set: Sequence[str] = (),
    out: Path | str | None = None,
    quiet: bool = False,
) -> Replay:
    """Track a run again up to a frame with a parameter changed, and show both: a picture, and what differs in words.
    Without a parameter to change, the run is repeated as it was.

    The run is tracked again from its first frame: from its maps.h5 (planview run --maps) in a tenth of the time where
    the parameter does not change these, else from the recording.

    Example: planview replay out --frame 310 --set joint.patch_m=0.15

    Args:
        folder: Output folder of a run.
        frame: The frame to look at.
        set: One parameter, e.g. ``set`` foreground.learning_rate=0.002; can be repeated.
        out: Picture to write; replay-N.png in the folder when not given.
        quiet: Show no progress.

    Raises:
        InputError: no run in the folder, a frame outside of it, or parameters that its maps exclude.
        WorkError: the recording ends before the frame.
    """
    folder = Path(folder)
    results = RunFolder(folder)
    first = results.info.first_frame
    in_range("frame", frame, first, results.n_frames - 1)
    config = settings(None, set, results.config)
    with FrameProgress(PlainConsole(stderr=True, quiet=quiet), frame + 1 - first, first) as progress:
        replayed = replay_run(results, config, frame, progress)
    lines = difference_text(results, replayed, frame)
    frames = frames_or_none(results, warnings.warn)
    path = path_of(out) or folder / f"replay-{frame}.png"
    write_image(path, difference_picture(results, replayed, frames, frame, ", ".join(set) or "again"))
    return Replay(replayed.source, replayed.results.tracks, path, tuple(lines))
