"""``planview run``, ``demo`` and ``replay``: a recording tracked, and tracked again."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

from cyclopts import Group, Parameter
from rich.console import Console

from calib.errors import InputError
from calib.formats.one_camera import holds_one_camera
from calib.images import write_image
from planview.commands.options import (
    Flag,
    FrameRate,
    JsonFlag,
    OneSetting,
    Settings,
    Topics,
    frame_span,
    in_range,
    open_options,
    say,
)
from planview.commands.results import RenderOptions, render
from planview.commands.scores import EvaluateOptions, evaluate, print_counts
from planview.commands.tools import config_toml
from planview.counting.rules import RulePlane, load_rules
from planview.counting.stream import Analytics
from planview.engine.config import Config, load_config
from planview.engine.engine import Engine
from planview.engine.open import ImageTrackerName, TrackerName, base_config, open_engine
from planview.output.finished import refine_run
from planview.output.folder import HoldsResultsError, RunInfo, check_folder, finished_run, folder_lock
from planview.output.progress import FrameProgress, PlainConsole, compile_notice, summary
from planview.output.render import frames_or_none
from planview.output.replay import difference_picture, difference_text, replay_run
from planview.output.report.page import write_report
from planview.output.report.snapshots import busiest_frame
from planview.output.resume import checkpoint_of, remove_checkpoint
from planview.output.run import RunLog, RunOptions, begin_run, run_identity
from planview.output.run import run as run_engine
from planview.output.run_folder import RunFolder
from planview.output.tables import MapsLog, refuse_unrecorded
from planview.synthetic.assets import DEMO

INPUT, TRACKING, OUTPUT = (Group(name, sort_key=place) for place, name in enumerate(("Input", "Tracking", "Output")))
_In, _How, _Out = (Parameter(group=group) for group in (INPUT, TRACKING, OUTPUT))


@Parameter(name="*")
@dataclass(frozen=True)
class TrackingOptions:
    """How the recording is tracked, and what is written."""

    calibration: Annotated[Path | None, _In, Parameter(name=["--calibration", "--camera"])] = None
    """Calibration of the stereo pair, if it is not in the recording; or camera.toml of a single camera
    (planview calibrate human writes it), or its Tsai XML."""
    topics: Annotated[Topics, _In] = None
    fps: Annotated[FrameRate, _In] = None
    strict: Annotated[Flag, _In] = False
    """Refuse a recording that fails one of the cheap checks (exit status 2) instead of warning about it."""
    tracker: Annotated[TrackerName, _How] = "joint"
    """joint (every pixel explained by people) or template (Harville's) for stereo and depth; human-model or
    ellipse-particle for one camera."""
    detections: Annotated[Path | None, _How] = None
    """Boxes of people from a detector of your own (MOTChallenge det.txt or COCO results), tracked instead of what
    moves; one camera only."""
    config: Annotated[Settings, _How] = None
    set_: Annotated[OneSetting, _How] = ()
    refine: Annotated[Flag, _How] = False
    """Refine the tracks afterwards, knowing the whole recording (as planview edit --refine does)."""
    rules: Annotated[Path | None, _How] = None
    """rules.toml with tripwires and zones to count while tracking."""
    rrd: Annotated[Flag, _Out] = False
    """Also write run.rrd, which planview view opens."""
    rrd_every: Annotated[int, _Out] = 1
    """Images, clouds and maps of every n-th frame only go into run.rrd; people and curves of all."""
    maps: Annotated[Flag, _Out, Parameter(name=["--maps", "--save-maps"])] = False
    """Also write maps.h5: foreground points of every frame as disparities and coarse colour codes, without images."""
    frames: Annotated[str | None, _In] = None
    """Frames to track, FIRST:LAST, or N for the first N: the background is learned from the first of them on."""
    quiet: Annotated[Flag, _Out] = False
    """Print nothing but errors."""
    json_output: Annotated[JsonFlag, _Out] = False
    print_config: Annotated[Flag, _How] = False
    """Print all parameters that the run would have as a file for --config, and end."""
    overwrite: Annotated[Flag, _Out] = False
    """Replace the results of an earlier run in the folder."""
    resume: Annotated[Flag, _Out] = False
    """Resume the run that was interrupted or killed in this folder: the same results as without interruption."""
    checkpoint_every: Annotated[float, Parameter(show=False)] = 30.0
    """Time between two checkpoints to resume from, in seconds; 0 for none."""


def run(
    recording: Path,
    right: Path | None = None,
    /,
    *,
    out: Annotated[Path | None, _Out] = None,
    options: TrackingOptions = TrackingOptions(),
) -> None:
    """Track people in a recording: tracks.csv, run.json and report.html in a folder.

    Example: planview run my_recording --out out --rrd

    Example of two videos, or two folders of images: planview run left.mp4 right.mp4 --calibration rig.toml --out out

    Example of saving the plan-view maps and tracking them again:
        planview run my_recording --out out --maps
        planview run out/maps.h5 --out again --tracker template

    Example with one camera: planview run street.mp4 --tracker human-model --calibration camera.toml --out out

    Example without any calibration: planview run street.mp4 --tracker ellipse-particle --out out

    Example with a detector's boxes: planview run street.mp4 --detections det.txt --calibration camera.toml --out out

    Parameters
    ----------
    recording
        Folder with left/ and right/ images or videos (or one side-by-side video) and a calibration; or one video;
        or the left one of two videos or folders of images; or maps.h5 of an earlier run. Maps are tracked with the
        parameters that made them, changed by --config and --set; other parameters than before give an approximation.
    right
        The right one of two videos or folders of images.
    out
        Folder for the results (required); created where it does not exist.
    """
    if options.print_config:
        print(config_toml(load_config(options.config, options.set_, base_config(recording))))
        return
    if out is None:
        raise InputError("run needs --out FOLDER for the results")
    try:
        _run(recording, right, out, options)
    except HoldsResultsError as error:
        way = f"choose another folder, or add {'--resume or ' * error.resumable}--overwrite"
        again = "--overwrite instead of --resume starts again"
        raise InputError(f"{error}; {again if options.resume else way}") from error


def _run(recording: Path, right: Path | None, out: Path, options: TrackingOptions) -> None:
    in_range("--rrd-every", options.rrd_every, 1, 100_000)
    in_range("--checkpoint-every", options.checkpoint_every, 0, 86_400, " s")
    settings = load_config(options.config, options.set_, base_config(recording))
    for name, is_given in (("--overwrite", options.overwrite), ("--detections", bool(options.detections))):
        if options.resume and is_given:
            raise InputError(f"--resume and {name} cannot be combined")
    check_folder(out, options.overwrite or options.resume, recording)
    console = PlainConsole(stderr=True, quiet=options.quiet)
    if options.resume and (info := finished_run(out)) is not None:
        with folder_lock(out):  # what a kill after the last frame left undone; the page comes last
            remove_checkpoint(out)
            if (out / "report.html").is_file() and (info.refined or not options.refine):
                console.print(f"{out}: the run is finished; nothing is left to resume")
                return
            if info.refined or options.refine:
                _, info = refine_run(out)
            else:
                write_report(out)
    else:
        with compile_notice(console):
            info = _opened_and_tracked(recording, right, out, options, settings, console)
    summary(console, info, out)
    if info.counts:
        print_counts(info.counts, console)
    if options.json_output:
        print(json.dumps({"out": str(out), **info.model_dump(mode="json", exclude={"config"})}, indent=2))


def _opened_and_tracked(
    recording: Path, right: Path | None, out: Path, options: TrackingOptions, settings: Config, console: Console
) -> RunInfo:
    camera = options.calibration if options.calibration and _is_of_one_camera(options.calibration, options) else None
    source = open_options(None if camera else options.calibration, options.fps, options.topics, right)
    with console.status("opening the recording, aligning rows, finding the floor"):
        engine = open_engine(recording, options.tracker, settings, camera, source, detections=options.detections)
    if options.maps:
        refuse_unrecorded(engine)
    plane = RulePlane(engine.camera, engine.size, has_floor=engine.camera is not None)
    analytics = Analytics(load_rules(options.rules, plane)) if options.rules else None
    with folder_lock(out):
        return _track(engine, out, options, analytics, console)


def _is_of_one_camera(calibration: Path, options: TrackingOptions) -> bool:
    """Whether a calibration is of one camera rather than of a pair."""
    of_images = options.tracker in get_args(ImageTrackerName) or options.detections is not None
    return of_images or calibration.name == "camera.toml" or holds_one_camera(calibration)


def _track(
    engine: Engine, out: Path, options: TrackingOptions, analytics: Analytics | None, console: Console
) -> RunInfo:
    announced = engine.recording.n_frames
    first, last = frame_span(options.frames) if options.frames is not None else (0, -1)
    if announced and first >= announced:
        raise InputError(f"--frames: the recording has only {announced} frames, 0 to {announced - 1}")
    how = RunOptions(
        "detections" if options.detections else options.tracker, analytics, first, last - first + 1 if last >= 0 else 0,
        0.0 if options.detections else options.checkpoint_every, options.strict,
    )  # fmt: skip
    checkpoint = None
    if options.resume:
        names = ["MapsLog"] * options.maps + ["RerunLog"] * options.rrd
        identity = run_identity(engine, how, names)
        checkpoint = checkpoint_of(out, identity, lambda text: console.print(text, soft_wrap=True))
    if checkpoint is None:
        begin_run(engine, out, how, overwrite=options.overwrite or options.resume)
    positions = checkpoint.written["logs"] if checkpoint else {}
    logs: list[RunLog] = []
    if options.maps:
        logs.append(MapsLog(engine, out / "maps.h5", positions.get("MapsLog")))
    if options.rrd:
        from planview.output.rerun_log import RerunLog  # rerun takes a second, and few runs write for it

        logs.append(RerunLog(engine, out / "run.rrd", options.rrd_every, resumed=checkpoint is not None))
    remaining = max(announced - first, 0)
    n_frames = min(how.max_frames or remaining, remaining) if announced else how.max_frames or None
    with FrameProgress(console, n_frames, first) as progress:
        info = run_engine(engine, out, how, logs, progress, checkpoint)
    write_report(out)
    if analytics is not None and (note := analytics.rules.unreached(RunFolder(out).tracks)):
        console.print(note, soft_wrap=True)
    return refine_run(out)[1] if options.refine else info


def replay(
    folder: Path,
    /,
    *,
    frame: int,
    set_: OneSetting = (),
    out: Annotated[Path | None, Parameter(name=["--out", "--png"])] = None,
) -> None:
    """Track a run again up to a frame with a parameter changed, and show both: a picture, and what differs in words.
    Without a parameter to change, the run is repeated as it was.

    The run is tracked again from its first frame: from its maps.h5 (planview run --maps) in a tenth of the time where
    the parameter does not change these, else from the recording.

    Example: planview replay out --frame 310 --set joint.patch_m=0.15

    Parameters
    ----------
    folder
        Output folder of a run.
    frame
        The frame to look at.
    out
        Picture to write; replay-N.png in the folder when not given.
    """
    results = RunFolder(folder)
    if results.info.tracker == "detections":
        raise InputError(f"{folder}: expected a run without --detections, whose file a run does not keep; run it again")
    first = results.info.first_frame
    in_range("--frame", frame, first, results.n_frames - 1)
    config = load_config(None, set_, results.config)
    with FrameProgress(PlainConsole(stderr=True), frame + 1 - first, first) as progress:
        replayed = replay_run(results, config, frame, progress)
    say(f"tracked from {replayed.source}")
    for line in difference_text(results, replayed, frame):
        PlainConsole(soft_wrap=True, highlight=False).print(line)
    frames = frames_or_none(results, say)
    path = out or folder / f"replay-{frame}.png"
    write_image(path, difference_picture(results, replayed, frames, frame, ", ".join(set_) or "again"))
    say(path)


def demo(*, out: Path = Path("out/demo"), json_output: JsonFlag = False) -> None:
    """Track the clip that comes with the package, write all results, a picture and run.rrd, and print the scores.

    Example: planview demo

    Parameters
    ----------
    out
        Folder for the results; results of an earlier demo there are replaced.
    """
    if not DEMO.is_dir():
        remedy = "install planview again, or run it from its repository"
        raise InputError(f"{DEMO}: expected the demo clip, found nothing; {remedy}")
    run(DEMO, out=out, options=TrackingOptions(rrd=True, overwrite=True))
    evaluate(out / "tracks.csv", DEMO / "truth.csv", options=EvaluateOptions(json_output=json_output))
    render(out, options=RenderOptions(frame=busiest_frame(RunFolder(out)) or 0, out=out / "scene.png"))
    say(
        f"Next: open {out / 'report.html'}: pictures, plots and settings of this run\n"
        f"      planview view {out}: every frame, and why the tracker decided as it did\n"
        "      planview check MY_RECORDING --quick: what a recording of yours holds, and what it lacks"
    )
