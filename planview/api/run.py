"""A recording tracked, and tracked again."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from numpy.typing import ArrayLike

from calib.errors import InputError
from calib.formats.one_camera import holds_one_camera
from calib.ground_camera import GroundCamera
from planview.api.arguments import Frames, Settings, frame_span, in_range, log_errors_only, opening, path_of, settings
from planview.api.result import Result
from planview.engine.engine import Engine
from planview.engine.open import AnyTracker, ImageTrackerName, base_config, open_engine
from planview.output.replay import difference_text, replay_run, write_difference
from planview.output.run import Watch, track
from planview.output.run_folder import RunFolder
from planview.output.run_spec import RunSpec
from planview.output.viewer import LiveViewer
from planview.progress import Progress, unseen
from planview.trajectories.table import Trajectories
from stereo.matcher import Matcher

log = logging.getLogger(__name__)


def run(
    recording: Engine | Path | str,
    right: Path | str | None = None,
    *,
    out: Path | str | None = None,
    calibration: GroundCamera | Path | str | None = None,
    topics: str | None = None,
    fps: float | None = None,
    strict: bool = False,
    tracker: AnyTracker = "joint",
    detections: Path | str | Sequence[ArrayLike] | None = None,
    matcher: Matcher | None = None,
    config: Settings | None = None,
    refine: bool = False,
    rules: Path | str | None = None,
    rrd: bool = False,
    rrd_every: int = 1,
    maps: bool = False,
    frames: Frames | None = None,
    view: bool | LiveViewer = False,
    watch: Watch | None = None,
    progress: Progress = unseen,
    quiet: bool = False,
    overwrite: bool = False,
    resume: bool = False,
    checkpoint_every: float = 30.0,
) -> Trajectories:
    """Track people in a recording.

    ```python
    tracks = planview.run("my_recording", out="out", config={"foreground.beta": 4})
    walked = tracks.to_dataframe().query("state == 'confirmed'")

    planview.run("left.mp4", "right.mp4", calibration="rig.toml", out="out", rrd=True)
    planview.run("out/maps.h5", out="again", tracker="template")  # maps of an earlier run, which wrote them (maps=True)
    planview.run("street.mp4", tracker="human-model", calibration="camera.toml", out="out")
    ```

    Args:
        recording: Folder with left/ and right/ images or videos (or one side-by-side video) and a calibration; or one
            video; or the left one of two videos or folders of images; or maps.h5 of an earlier run. Maps are tracked
            with the parameters that made them, changed by ``config``; other parameters than before give an
            approximation. In Python also an Engine.
        right: The right one of two videos or folders of images.
        out: Folder for the results (tracks.csv, run.json, report.html); created where it does not exist.
        calibration: Calibration of the stereo pair, if it is not in the recording; or camera.toml of a single camera,
            or its Tsai XML. In Python also a GroundCamera.
        topics: Topics of a bag, LEFT,RIGHT or IMAGE,DEPTH, where they are not clear from their names.
        fps: Frames per second, where times are missing or wrong.
        strict: Refuse a recording that fails one of the cheap checks instead of warning about it.
        tracker: joint (every pixel explained by people) or template (Harville's) for stereo and depth; human-model or
            ellipse-particle for one camera.
        detections: Boxes of people from a detector of your own (MOTChallenge det.txt or COCO results), tracked instead
            of what moves; one camera only. In Python also an array per frame, (N, 4) left, top, width, height [px] or
            (N, 5) with a score.
        matcher: Of stereo pairs; SGBM when None.
        config: TOML file with parameters of a run, a table per stage. In Python also a dict of those that differ, or a
            Config.
        refine: Refine the tracks afterwards, knowing the whole recording.
        rules: rules.toml with tripwires and zones to count while tracking.
        rrd: Also write run.rrd, which the viewer opens.
        rrd_every: Images, clouds and maps of every n-th frame only go into run.rrd; people and curves of all.
        maps: Also write maps.h5: foreground points of every frame as disparities and coarse colour codes, without
            images.
        frames: Frames to track, FIRST:LAST, or N for the first N: the background is learned from the first of them on.
        view: Show the run in rerun while it runs: in a window, or where there is no display on a page whose address
            is printed.
        watch: Called after every frame.
        progress: Called with how many frames are done, and how many there are in all.
        quiet: Log errors only.
        overwrite: Replace the results of an earlier run in the folder.
        resume: Resume the run that was interrupted or killed in this folder: the same results as without interruption.
        checkpoint_every: Time between two checkpoints to resume from, in seconds; 0 for none.

    Returns:
        The tracks. Without ``out`` nothing is written.

    Raises:
        InputError: a recording, calibration or camera that is missing or does not fit; results in the folder.
        WorkError: no floor is visible, or the folder cannot be written.
    """
    in_range("rrd_every", rrd_every, 1, 100_000)
    in_range("checkpoint_every", checkpoint_every, 0, 86_400, " s")
    if resume and detections is not None:
        raise InputError("resume and detections cannot be combined")
    first, last = (0, None) if frames is None else frame_span(frames)
    spec = RunSpec(
        out=path_of(out),
        first_frame=first,
        last_frame=last,
        rules=path_of(rules),
        strict=strict,
        refine=refine,
        maps=maps,
        rrd_every=rrd_every if rrd else 0,
        report=True,
        overwrite=overwrite,
        resume=resume,
        checkpoint_every_s=checkpoint_every,
    )
    if isinstance(recording, Engine):
        if any(value is not None for value in (right, calibration, topics, fps, detections, matcher, config)):
            raise InputError("an engine has its own calibration, matcher and parameters: give them to open_engine")
        spec.refuse_folder()
        engine = recording
    else:
        path = Path(recording)
        parameters = settings(config, base_config(path))
        spec.refuse_folder(path)
        camera = None
        if isinstance(calibration, GroundCamera) or is_of_one_camera(calibration, tracker, detections is not None):
            camera = calibration
            calibration = None
        options = opening(calibration, fps, topics, right)
        log.debug("opening the recording, aligning rows, finding the floor")
        engine = open_engine(path, tracker, parameters, camera, options, matcher, detections)
    viewer = LiveViewer() if view is True else view or None
    with log_errors_only(quiet):
        return track(engine, spec, watch, progress, viewer)


def is_of_one_camera(calibration: Path | str | None, tracker: AnyTracker, detections: bool = False) -> bool:
    """Whether a calibration is of one camera rather than of a pair."""
    if calibration is None:
        return False
    calibration = Path(calibration)
    images = tracker in get_args(ImageTrackerName) if isinstance(tracker, str) else tracker.needs == "image"
    return images or detections or calibration.name == "camera.toml" or holds_one_camera(calibration)


def replay(
    run: Path | str,
    frame: int,
    *,
    config: Settings | None = None,
    matcher: Matcher | None = None,
    out: Path | str | None = None,
    progress: Progress = unseen,
    quiet: bool = False,
) -> Result[Trajectories]:
    """Track a run again up to a frame with parameters changed, and show what differs.

    A picture has the frame as it was run and as it is tracked now, the result what differs in words. Without a
    parameter to change, the run is repeated as it was. The run is tracked again from its first frame: from its maps.h5
    in a tenth of the time, where it has one and the parameter does not change these, else from the recording.

    ```python
    print(planview.replay("out", 310, config={"joint.patch_m": 0.15}))
    ```

    Args:
        run: Folder of a run.
        frame: The frame to look at.
        config: TOML file with parameters that differ from those of the run. In Python also a dict.
        matcher: The one that the run was tracked with, where it was one of your own.
        out: Picture to write; replay-N.png in the folder when not given.
        progress: Called after every frame.
        quiet: Log errors only.

    Returns:
        The tracks up to the frame.

    Raises:
        InputError: no run in the folder, a frame outside of it, parameters that its maps exclude, or another matcher.
        WorkError: the recording ends before the frame.
    """
    results = RunFolder(Path(run))
    in_range("frame", frame, results.info.first_frame, results.n_frames - 1)
    changed = settings(config, results.config)
    picture = path_of(out) or results.path / f"replay-{frame}.png"
    log.debug("tracking")
    with log_errors_only(quiet):
        replayed = replay_run(results, changed, frame, progress, matcher)
    write_difference(results, replayed, frame, picture)
    text = "\n".join(difference_text(results, replayed, frame))
    return Result(replayed.results.tracks, {"source": str(replayed.source)}, files=[picture], text=text)
