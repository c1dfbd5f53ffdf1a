"""A run shown to people: its page, plots, pictures and videos."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from calib.errors import InputError
from planview.api.arguments import Frames, frame_span, given_tracks, in_range, log_errors_only, one_of, path_of
from planview.api.result import Result, table_text
from planview.output.plot import PANELS, NamedTracks, Panel, figure_of, floor_picture, save_figure
from planview.output.report.page import differing_settings, write_report
from planview.output.run_folder import RunFolder
from planview.progress import Progress, unseen
from planview.trajectories.formats import load_truth, tracks_file, truth_file
from planview.trajectories.table import Trajectories

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

log = logging.getLogger(__name__)


def report(*runs: Path | str, truth: Path | str | None = None) -> Result[list[Path]]:
    """Write the report of a run, and compare the settings of several.

    ```python
    print(planview.report("out/narrow", "out/wide"))  # the settings in which they differ
    ```

    Args:
        runs: Folders of runs.
        truth: True people; truth.csv of each recording when not given.

    Returns:
        The pages, report.html in each folder.

    Raises:
        InputError: no tracks.csv, or a file that cannot be read.
        WorkError: the page cannot be written.
    """
    if not runs:
        raise InputError("report needs the folder of a run")
    paths = [Path(run) for run in runs]
    for file in filter(Path.is_file, paths):
        raise InputError(f"{file}: a file; report takes the folder of a run")
    pages = [write_report(path, truth=path_of(truth)) for path in paths]
    if len(paths) == 1:
        return Result(pages, files=pages)
    differing = differing_settings([RunFolder(path).info for path in paths])
    rows = [{"setting": name} | dict(zip(map(str, paths), values, strict=True)) for name, values in differing]
    return Result(pages, {"differing": rows}, rows, pages, text=table_text(rows) if rows else "the same settings")


def plot(
    *runs: Trajectories | DataFrame | Path | str,
    out: Path | str | None = None,
    truth: Path | str | None = None,
    what: Sequence[Panel] = (),
) -> Figure:
    """Plot paths on the floor, speeds and counts of one or several runs.

    ```python
    planview.plot("out", truth="my_recording", out="paths.svg")
    planview.plot(tracks, what=["density"])  # over a picture of the floor
    ```

    Args:
        runs: Folders of runs, their tracks.csv, or trajectories in a format of planview export.
        out: Picture to write (.png, .svg or .pdf); plot.png in the folder of the first run when not given.
        truth: True people (truth.csv, or what planview evaluate reads), drawn as thin dashed lines.
        what: Plots to draw; can be repeated. [default: paths, speed and count]

    Returns:
        The figure, which a notebook shows; of tables it is written only where ``out`` names a file.

    Raises:
        InputError: a file that cannot be read, or runs that do not fit into one plot.
    """
    if not runs:
        raise InputError("plot needs the folder of a run")
    for panel in what:
        one_of("what", panel, get_args(Panel))
    given = [given_tracks(run) for run in runs]
    short = [_name(tracks.path, n) for n, tracks in enumerate(given, 1)]
    names = short if len(set(short)) == len(short) else [str(run) for run in runs]
    tables = [NamedTracks(name, tracks.file.table) for name, tracks in zip(names, given, strict=True)]
    known = None if truth is None else load_truth(truth_file(Path(truth)) or Path(truth))
    folder = given[0].run
    floor = floor_picture(folder) if folder and len(runs) == 1 and what else None
    figure = figure_of(tables, known, what or PANELS, floor)
    if path := plot_file(*runs, out=path_of(out)):
        save_figure(figure, path)
    return figure


def plot_file(*runs: object, out: Path | None) -> Path | None:
    """Where ``plot`` writes its picture; None for tables without a name for it."""
    first = runs[0]
    return out or (tracks_file(Path(first)).parent / "plot.png" if isinstance(first, Path | str) else None)


def _name(path: Path | None, number: int) -> str:
    if path is None:
        return f"tracks {number}"
    return path.parent.resolve().name if path.name == "tracks.csv" else path.stem


def render(
    run: Path | str,
    *,
    out: Path | str | None = None,
    frame: int | None = None,
    frames: Frames | None = None,
    every: int = 1,
    trail: float = 4.0,
    truth: Path | str | None = None,
    no_truth: bool = False,
    no_plan: bool = False,
    progress: Progress = unseen,
    quiet: bool = False,
) -> Path:
    """Draw a run as a video or a picture.

    It shows boxes, ids, trails, a metre grid on the floor, the floor from above, and what was counted. The images are
    read from the recording again; if it is gone, only the floor is shown.

    ```python
    planview.render("out", out="out.webm")
    planview.render("out", frame=120, out="still.png")
    ```

    Args:
        run: Folder of a run.
        out: Video to write: .webm or .mp4 (browsers play both), .avi or .mkv; with ``frame`` the picture. [default:
            scene.webm or frame-N.png in the folder]
        frame: Draw this frame only, as a picture.
        frames: First and last frame of the video, e.g. 100:300, or 300 for the first 300.
        every: Draw every n-th frame; the video then runs faster.
        trail: Length of the trails behind people, in seconds.
        truth: True people to mark. [default: truth.csv of the recording]
        no_truth: Do not mark the true people.
        no_plan: Leave out the floor from above.
        progress: Called after every frame.
        quiet: Log errors only.

    Returns:
        The video or picture.

    Raises:
        InputError: no run in the folder, or a frame outside of it.
        WorkError: no frame can be read, or the file cannot be written.
    """
    in_range("every", every, 1, 100_000)
    in_range("trail", trail, 0, 3600, " s")
    folder = Path(run)
    path = path_of(out)
    if frame is None and path and path.suffix.lower() in (".png", ".jpg", ".jpeg"):
        raise InputError(f"{path} is one picture: say of which frame", remedy="frame")
    from planview.output.render import SceneComposer, render_frame, render_frames  # the engine takes half a second

    results = RunFolder(folder, path_of(truth))
    composer = SceneComposer(results, trail, plan=not no_plan, truth=not no_truth)
    if frame is not None:
        in_range("frame", frame, 0, results.n_frames - 1)
        return render_frame(composer, results, frame, path or folder / f"frame-{frame}.png")
    first, last = (0, results.n_frames) if frames is None else frame_span(frames)
    log.debug("drawing")
    shown = range(first, last + 1, every)
    with log_errors_only(quiet):
        return render_frames(composer, results, shown, path or folder / "scene.webm", progress)
