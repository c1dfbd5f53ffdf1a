"""A run shown to people: its page, plots, pictures and videos."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast, get_args

from rich.console import RenderableType
from rich.progress import track
from rich.table import Table

from calib.errors import InputError, WorkError
from planview.api.arguments import Frames, frame_span, in_range, one_of, path_of, table_of
from planview.output.plot import PANELS, NamedTracks, Panel, figure_of, floor_picture, save_figure
from planview.output.progress import PlainConsole, as_text
from planview.output.report.page import differing_settings, write_report
from planview.output.run_folder import RunFolder
from planview.trajectories.formats import load_tracks, load_truth, tracks_file, truth_file
from planview.trajectories.plot import Colouring
from planview.trajectories.table import Trajectories

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


@dataclass(frozen=True)
class Reports:
    """Pages that were written, and the settings in which several runs differ; printed, a table of these.

    Attributes:
        settings: name of a setting and its value in each run, as text.
    """

    files: tuple[Path, ...]
    settings: tuple[tuple[str, list[str]], ...] = ()

    def __repr__(self) -> str:
        return as_text(self)

    def __rich__(self) -> RenderableType:
        if len(self.files) < 2:
            return str(self.files[0])
        table = Table("setting", *(str(file.parent) for file in self.files), box=None, pad_edge=False)
        for name, values in self.settings:
            table.add_row(name, *values)
        return table if self.settings else "the same settings"


def report(*folders: Path | str, truth: Path | str | None = None) -> Reports:
    """Write report.html of runs again; of several, also print the settings in which they differ.

    Example: planview report out

    Example of two runs and what differs between them: planview report out/narrow out/wide

    Args:
        folders: Output folders of runs.
        truth: True people; truth.csv of each recording when not given.

    Raises:
        InputError: no tracks.csv, or a file that cannot be read.
        WorkError: the page cannot be written.
    """
    if not folders:
        raise InputError("report needs the folder of a run")
    paths = [Path(folder) for folder in folders]
    for file in filter(Path.is_file, paths):
        raise InputError(f"{file}: a file; report takes the folder of a run")
    files = tuple(write_report(path, truth=path_of(truth)) for path in paths)
    return Reports(files, tuple(differing_settings([RunFolder(path).info for path in paths]) if len(paths) > 1 else ()))


def plot(
    *runs: Trajectories | DataFrame | Path | str,
    out: Path | str | None = None,
    truth: Path | str | None = None,
    colour: Colouring = "id",
    what: Sequence[Panel] = (),
) -> Figure:
    """Plot where people walked, how fast, and how many there were, of one run or of several.

    Example: planview plot out

    Example with the true paths, as vector graphics: planview plot out --truth recording/truth.csv --out paths.svg

    Example of the mean density and flow of people over a picture of the floor:
        planview plot out --what density --what flow --out flow.png

    Example of two runs over each other: planview plot out/narrow out/wide --out both.png

    Args:
        runs: Folders of runs, their tracks.csv, or trajectories in a format of planview export.
        out: Picture to write (.png, .svg or .pdf); plot.png in the folder of the first run when not given.
        truth: True people (truth.csv, or what planview evaluate reads), drawn as thin dashed lines.
        colour: What colours stand for in a plot of one run.
        what: Plots to draw; can be repeated. [default: paths, speed and count]

    Returns:
        The figure, which a notebook shows; of tables it is written only where ``out`` names a file.

    Raises:
        InputError: a file that cannot be read, or runs that do not fit into one plot.
    """
    if not runs:
        raise InputError("plot needs the folder of a run")
    panels: Sequence[Panel] = (cast(Panel, what),) if isinstance(what, str) else what
    one_of("colour", colour, get_args(Colouring))
    for panel in panels:
        one_of("what", panel, get_args(Panel))
    short = [_name(run, n) for n, run in enumerate(runs, 1)]
    names = short if len(set(short)) == len(short) else [str(run) for run in runs]
    tables = [load_tracks(tracks_file(Path(run))) if isinstance(run, Path | str) else table_of(run) for run in runs]
    tracks = [NamedTracks(name, table) for name, table in zip(names, tables, strict=True)]
    known = None if truth is None else load_truth(truth_file(Path(truth)) or Path(truth))
    folder = RunFolder.around(tracks_file(Path(runs[0]))) if isinstance(runs[0], Path | str) else None
    floor = floor_picture(folder) if folder is not None and len(runs) == 1 and panels else None
    figure = figure_of(tracks, known, colour, panels or PANELS, floor)
    if path := plot_file(*runs, out=path_of(out)):
        save_figure(figure, path)
    return figure


def plot_file(*runs: object, out: Path | None) -> Path | None:
    """Where ``plot`` writes its picture; None for tables without a name for it."""
    first = runs[0]
    return out or (tracks_file(Path(first)).parent / "plot.png" if isinstance(first, Path | str) else None)


def _name(run: object, number: int) -> str:
    if not isinstance(run, Path | str):
        return f"tracks {number}"
    file = tracks_file(Path(run))
    return file.parent.resolve().name if file.name == "tracks.csv" else file.stem


def render(
    folder: Path | str,
    *,
    out: Path | str | None = None,
    frame: int | None = None,
    frames: Frames | None = None,
    every: int = 1,
    trail: float = 4.0,
    truth: Path | str | None = None,
    no_truth: bool = False,
    no_plan: bool = False,
    quiet: bool = False,
) -> Path:
    """Draw a run: boxes, ids, trails, a metre grid on the floor, the floor from above, and what was counted.

    The images are read from the recording again; if it is gone, only the floor is shown.

    Example: planview render out --out out.webm

    Example of a picture: planview render out --frame 120 --out still.png

    Args:
        folder: Output folder of a run.
        out: Video to write: .webm or .mp4 (browsers play both), .avi or .mkv; with ``frame`` the picture. [default:
            scene.webm or frame-N.png in the folder]
        frame: Draw this frame only, as a picture.
        frames: First and last frame of the video, e.g. 100:300, or 300 for the first 300.
        every: Draw every n-th frame; the video then runs faster.
        trail: Length of the trails behind people, in seconds.
        truth: True people to mark. [default: truth.csv of the recording]
        no_truth: Do not mark the true people.
        no_plan: Leave out the floor from above.
        quiet: Show no progress.

    Returns:
        The video or picture.

    Raises:
        InputError: no run in the folder, or a frame outside of it.
        WorkError: no frame can be read, or the file cannot be written.
    """
    in_range("every", every, 1, 100_000)
    in_range("trail", trail, 0, 3600, " s")
    folder = Path(folder)
    path = path_of(out)
    if frame is None and path is not None and path.suffix.lower() in (".png", ".jpg", ".jpeg"):
        raise InputError(f"{path} is one picture: say of which frame", remedy="frame")
    # The engine's parts take half a second.
    from planview.output.render import SceneComposer, frames_or_none, scene_pictures_of, write_still, write_video

    results = RunFolder(folder, path_of(truth))
    opened = frames_or_none(results, warnings.warn)
    composer = SceneComposer(results, trail, plan=not no_plan, truth=not no_truth)
    end = results.n_frames - 1
    if frame is not None:
        path = path or folder / f"frame-{frame}.png"
        in_range("frame", frame, 0, end)
        write_still(composer, opened, frame, path)
        return path
    path = path or folder / "scene.webm"
    first, last = (0, end) if frames is None else frame_span(frames)
    if first > end:
        raise InputError(f"{folder}: expected frames from {first} on, found {end + 1}")
    last = min(last, end)
    pictures = scene_pictures_of(composer, opened, first, last, every)
    total = len(range(first, last + 1, every))
    shown = track(pictures, "drawing", total, console=PlainConsole(stderr=True, quiet=quiet))
    if not write_video(path, min(240.0, 1.0 / results.clock.frame_s), shown):
        raise WorkError(f"{path}: none of the frames {first} to {last} can be read")
    return path
