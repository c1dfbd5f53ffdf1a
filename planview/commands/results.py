"""``planview report``, ``render`` and ``view``: a run shown to people."""

from __future__ import annotations

import os
import signal
import subprocess
import sysconfig
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from rich.progress import track
from rich.table import Table

from calib.errors import InputError, WorkError
from calib.io import missing, reason
from planview.commands.options import Flag, frame_span, in_range, say
from planview.output.folder import rrd_parts
from planview.output.plot import PANELS, NamedTracks, Panel, figure_of, save_figure
from planview.output.progress import PlainConsole
from planview.output.report.page import differing_settings, write_report
from planview.output.run_folder import RunFolder
from planview.trajectories.formats import load_tracks, load_truth, tracks_file, truth_file
from planview.trajectories.plot import Colouring


def report(*folders: Path, truth: Path | None = None) -> None:
    """Write report.html of runs again; of several, also print the settings in which they differ.

    Example: planview report out

    Example of two runs and what differs between them: planview report out/narrow out/wide

    Parameters
    ----------
    folders
        Output folders of runs.
    truth
        True people; truth.csv of each recording when not given.
    """
    if not folders:
        raise InputError("report needs the folder of a run")
    for file in filter(Path.is_file, folders):
        raise InputError(f"{file}: a file; report takes the folder of a run")
    for folder in folders:
        say(write_report(folder, truth=truth))
    if len(folders) > 1:
        rows = differing_settings([RunFolder(folder).info for folder in folders])
        table = Table("setting", *map(str, folders), box=None, pad_edge=False)
        for name, values in rows:
            table.add_row(name, *values)
        PlainConsole().print(table if rows else "the same settings")


def plot(
    *runs: Path,
    out: Path | None = None,
    truth: Path | None = None,
    colour: Annotated[Colouring, Parameter(name=["--colour", "--color"])] = "id",
    only: Annotated[Sequence[Panel], Parameter(negative="")] = (),
) -> None:
    """Plot where people walked, how fast, and how many there were, of one run or of several.

    Example: planview plot out

    Example with the true paths, as vector graphics: planview plot out --truth recording/truth.csv --out paths.svg

    Example of two runs over each other: planview plot out/narrow out/wide --out both.png

    Parameters
    ----------
    runs
        Folders of runs, their tracks.csv, or trajectories in a format of planview export.
    out
        Picture to write (.png, .svg or .pdf); plot.png in the folder of the first run when not given.
    truth
        True people (truth.csv, or what planview evaluate reads), drawn as thin dashed lines.
    colour
        What colours stand for in a plot of one run.
    only
        Plots to draw, all when not given; can be repeated.
    """
    if not runs:
        raise InputError("plot needs the folder of a run")
    files = [tracks_file(run) for run in runs]
    parents = [file.parent.resolve().name if file.name == "tracks.csv" else file.stem for file in files]
    names = parents if len(set(parents)) == len(parents) else [str(run) for run in runs]
    tracks = [NamedTracks(name, load_tracks(file)) for name, file in zip(names, files, strict=True)]
    known = None if truth is None else load_truth(truth_file(truth) or truth)
    path = out or files[0].parent / "plot.png"
    save_figure(figure_of(tracks, known, colour, only or PANELS), path)
    say(path)


@Parameter(name="*")
@dataclass(frozen=True)
class RenderOptions:
    """What is shown, and where it goes."""

    out: Annotated[Path | None, Parameter(name=["--out", "--video", "--png"])] = None
    """Video to write: .webm or .mp4 (browsers play both), .avi or .mkv; with --frame the picture. [default: scene.webm
    or frame-N.png in the folder]"""
    frame: int | None = None
    """Draw this frame only, as a picture."""
    frames: str | None = None
    """First and last frame of the video, e.g. 100:300, or 300 for the first 300."""
    every: int = 1
    """Draw every n-th frame; the video then runs faster."""
    trail: float = 4.0
    """Length of the trails behind people, in seconds."""
    truth: Path | None = None
    """True people to mark. [default: truth.csv of the recording]"""
    no_truth: Flag = False
    """Do not mark the true people."""
    no_plan: Flag = False
    """Leave out the floor from above."""


def render(folder: Path, /, *, options: RenderOptions = RenderOptions()) -> None:
    """Draw a run: boxes, ids, trails, a metre grid on the floor, the floor from above, and what was counted.

    The images are read from the recording again; if it is gone, only the floor is shown.

    Example: planview render out --out out.webm

    Example of a picture: planview render out --frame 120 --out still.png

    Parameters
    ----------
    folder
        Output folder of a run.
    """
    if options.every < 1 or not 0 <= options.trail <= 3600:
        raise InputError("--every is 1 or more, --trail 0 to 3600 s")
    if options.frame is None and options.out is not None and options.out.suffix.lower() in (".png", ".jpg", ".jpeg"):
        raise InputError(f"{options.out} is one picture: add --frame N")
    # The engine's parts take half a second.
    from planview.output.render import SceneComposer, frames_or_none, scene_pictures_of, write_still, write_video

    results = RunFolder(folder, options.truth)
    known = results.tracks.frame
    frames = frames_or_none(results, say)
    composer = SceneComposer(results, options.trail, plan=not options.no_plan, truth=not options.no_truth)
    end = results.n_frames - 1
    if options.frame is not None:
        path = options.out or folder / f"frame-{options.frame}.png"
        in_range("--frame", options.frame, 0, end)
        write_still(composer, frames, options.frame, path)
        say(path)
        return
    path = options.out or folder / "scene.webm"
    first, last = frame_span(options.frames) if options.frames else (0, end)
    if first > end or not len(known):
        raise InputError(f"{folder}: expected frames from {first} on, found {int(np.max(known, initial=-1)) + 1}")
    last = min(last, end)
    pictures = scene_pictures_of(composer, frames, first, last, options.every)
    total = len(range(first, last + 1, options.every))
    shown = track(pictures, "drawing", total, console=PlainConsole(stderr=True))
    if not write_video(path, min(240.0, 1.0 / results.clock.frame_s), shown):
        raise WorkError(f"{path}: none of the frames {first} to {last} can be read")
    say(path)


def view(folder: Path, /, *, port: int = 9876, web: Flag = False, web_port: int = 9090) -> None:
    """Open a run in the rerun viewer, which listens on this machine only and sends no usage statistics.

    Example: planview view out

    Example on a machine without a display, then on yours, where a browser opens the address that it prints:
        planview view out --web
        ssh -L 9090:127.0.0.1:9090 -L 9876:127.0.0.1:9876 MACHINE

    Parameters
    ----------
    folder
        Output folder of a run made with --rrd, or an .rrd file.
    port
        Port of the viewer, or with --web of the data, on 127.0.0.1.
    web
        Serve the viewer to a browser instead of opening a window.
    web_port
        Port of the page, on 127.0.0.1.
    """
    recording = folder if folder.suffix == ".rrd" else folder / "run.rrd"
    if not folder.exists():
        raise missing(folder)
    if not recording.is_file():
        raise InputError(f"{folder}: no run.rrd in it; planview run --rrd writes one")
    parts = [recording] if folder.suffix == ".rrd" else rrd_parts(recording)
    for part in parts:
        refuse_broken(part)
    viewer = Path(sysconfig.get_path("scripts")) / "rerun"
    command = [str(viewer), "--bind", "127.0.0.1", "--port", str(port)]
    if web:
        command += ["--serve-web", "--web-viewer-port", str(web_port), "--server-memory-limit", "75%"]
        data = f"rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{port}%2Fproxy"
        say(f"open http://127.0.0.1:{web_port}/?url={data}   (Ctrl-C ends it)")
    try:
        status = _viewed([*command, *map(str, parts)])
    except OSError as error:
        raise WorkError(f"the rerun viewer cannot be started ({reason(error)}); is rerun-sdk installed?") from error
    if status != 0:
        hint = "is the port free?" if web else "it needs a display and a graphics driver; --web needs none"
        raise WorkError(f"the rerun viewer ended with status {status} ({hint})")


def refuse_broken(part: Path) -> None:
    """Raise InputError for what the viewer would show as an empty page: no recording, of another version, cut off."""
    with part.open("rb") as file:
        head = file.read(8)
        file.seek(max(0, part.stat().st_size - 12))
        end = file.read()
    own = tuple(map(int, version("rerun-sdk").split(".")[:2]))
    found = ""
    if len(head) < 8 or not head.startswith(b"RRF"):
        found = "a file of another kind" if head else "an empty file"
    elif not (0, 23) <= (head[4], head[5]) <= own or head[:4] != b"RRF2":  # each reads what 0.23 and later wrote
        found = f"one of rerun {head[4]}.{head[5]}, which rerun {own[0]}.{own[1]} does not read: install that version"
    elif (head[4], head[5]) == own and not end.startswith(b"RRF2FOOT"):
        found = f"one that was cut off: rerun rrd merge {part} -o whole.rrd recovers what is there"
    if found:
        raise InputError(f"{part}: expected a rerun recording, found {found}")


def _viewed(command: list[str]) -> int:
    """Exit status of the viewer; whatever ends the wait, it and the processes that it started end, too."""
    viewer = subprocess.Popen(command, env=quiet_environment(), start_new_session=True)
    try:
        return viewer.wait()
    finally:
        with suppress(OSError):
            os.killpg(viewer.pid, signal.SIGTERM)
        viewer.wait()


def quiet_environment() -> dict[str, str]:
    """Variables under which rerun's programs send no usage statistics: they send none where ``CI`` is set."""
    return {**{k: v for k, v in os.environ.items() if k != "FORCE_RERUN_ANALYTICS"}, "CI": "1"}
