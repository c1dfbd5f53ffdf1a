"""The figure of ``planview plot``: paths on the floor, speed and people over time, of one run or of several."""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from calib.errors import InputError
from calib.images import as_colour
from calib.types import U8
from planview.drawing.plan import from_above
from planview.output.folder import writing
from planview.output.run_folder import RunFolder
from planview.trajectories.plot import (
    INK,
    TRUTH_COLOUR,
    plot_counts,
    plot_density,
    plot_paths,
    plot_speed,
    plot_truth,
)
from planview.trajectories.table import Trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Panel = Literal["paths", "density", "speed", "count"]
PANELS: tuple[Panel, ...] = ("paths", "speed", "count")
"""Default panels."""
FROM_ABOVE: dict[Panel, str] = {"paths": "Seen from above", "density": "Density"}
OVER_TIME: dict[Panel, str] = {"speed": "Walking speed", "count": "People"}
RUN_COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#e377c2", "#8c564b")
"""Colours of several runs, in turn."""
BLUE = "#1f4e9c"
"""Colour of the numbers of one run."""
WIDE = 1.9
"""Width over depth of the floor from which it is drawn above the curves and not next to them."""


LEGEND: dict[str, Any] = {
    "fontsize": 8, "title_fontsize": 8, "frameon": False, "alignment": "left",
    "handlelength": 1.4, "columnspacing": 1.2,
}  # fmt: skip
"""Looks of all legends."""


class NamedTracks(NamedTuple):
    """Tracks and what the legend calls them."""

    name: str
    tracks: Trajectories


class FloorPicture(NamedTuple):
    """(H, W, 3) uint8 RGB of the floor from above, row 0 at its lowest y, and its x from, to, y from, to [m]."""

    image: U8
    extent_m: tuple[float, float, float, float]


PIXEL_M = 0.02
"""Pixel of a picture of the floor [m]."""


def floor_picture(run: RunFolder) -> FloorPicture | None:
    """The floor where people were, as the first frame of a run shows it; None without its recording or a camera."""
    from planview.output.render import frames_or_none  # the engine's parts take half a second

    if not run.has_run or run.camera is None:
        return None
    frames = frames_or_none(run, lambda _: None)
    image = None if frames is None else frames.image(run.info.first_frame)
    if image is None:
        return None
    bounds = run.bounds()
    x = np.arange(bounds.x_min_m, bounds.x_max_m, PIXEL_M)
    y = np.arange(bounds.y_min_m, bounds.y_max_m, PIXEL_M)
    rgb = np.ascontiguousarray(as_colour(image)[..., ::-1])
    seen = from_above(rgb, run.camera, *np.meshgrid(x, y))
    pale = np.where(seen.any(axis=2, keepdims=True), 128 + seen // 2, 255)
    return FloorPicture(np.asarray(pale, np.uint8), (bounds.x_min_m, bounds.x_max_m, bounds.y_min_m, bounds.y_max_m))


def figure_of(
    runs: Sequence[NamedTracks], truth: Trajectories | None = None,
    panels: Sequence[Panel] = PANELS, floor: FloorPicture | None = None,
) -> Figure:  # fmt: skip
    """A figure of one run in a colour for each person, or of several in one each, over a picture of the floor.
    Raises InputError: more runs than colours, runs in metres and in pixels, tracks without any place, or density of
    several runs."""
    _refuse_mixed(runs, panels)
    figure, places = _empty_figure(panels, _shape(runs))
    for n, run in enumerate(runs):
        style = STYLE_OF_ONE
        if len(runs) > 1:
            colour = RUN_COLOURS[n]
            # Of those that lie over each other the first is the widest.
            style = _Style(colour, colour, colour, max(1.0, 3.2 - 1.6 * n), run.name, run.name)
        _draw_run(places, run, style)
    if truth is not None:
        if "paths" in places:
            plot_truth(truth, places["paths"])
        if "count" in places:
            clock = runs[0].tracks
            plot_counts(truth, places["count"], colour=TRUTH_COLOUR, label="truth", style="--", clock=clock)
    if floor is not None:
        for panel in places.keys() & FROM_ABOVE.keys():
            places[panel].imshow(floor.image, extent=floor.extent_m, origin="lower", zorder=0)
    _write_legends(figure, places, runs)
    return figure


def _refuse_mixed(runs: Sequence[NamedTracks], panels: Sequence[Panel]) -> None:
    """Raise InputError for runs that cannot be drawn in one plot."""
    if len(runs) > len(RUN_COLOURS):
        raise InputError(f"at most {len(RUN_COLOURS)} runs can be distinguished in one plot, found {len(runs)}")
    in_metres = {bool(np.isfinite(run.tracks.x_m).any()) for run in runs if len(run.tracks)}
    if len(in_metres) > 1:
        raise InputError("some of the runs are in metres and some in pixels; plot them one by one")
    if len(runs) > 1 and "density" in panels:
        raise InputError("density of several runs cannot be distinguished in one plot")


class _Style(NamedTuple):
    """Colours, width and labels of a run."""

    path_colour: str
    speed_colour: str
    count_colour: str
    path_width: float
    speed_label: str
    count_label: str


STYLE_OF_ONE = _Style("id", "id", BLUE, 1.6, "", "tracked")


def _draw_run(places: dict[Panel, Axes], run: NamedTracks, style: _Style) -> None:
    name, tracks = run
    if "paths" in places:
        plot_paths(tracks, places["paths"], colour=style.path_colour, label=name, width=style.path_width)
    if "density" in places:
        plot_density(tracks, places["density"])
    if "speed" in places:
        plot_speed(tracks, places["speed"], colour=style.speed_colour, label=style.speed_label)
    if "count" in places:
        plot_counts(tracks, places["count"], colour=style.count_colour, label=style.count_label)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as its name ends, .png or .svg (or .pdf). Raises InputError: another ending."""
    if path.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise InputError(f"{path}: a plot is written as .png, .svg or .pdf")
    metadata = None if path.suffix.lower() == ".png" else {"Date": None}
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=150, metadata=metadata)


def _shape(runs: Sequence[NamedTracks]) -> float:
    """Width over depth of the floor that people used; 4:3 where it is not known."""
    x = np.concatenate([run.tracks.x_m for run in runs])
    y = np.concatenate([run.tracks.y_m for run in runs])
    is_known = np.isfinite(x + y)
    if not is_known.any():
        return 4 / 3
    return float(np.ptp(x[is_known]) / max(float(np.ptp(y[is_known])), 0.1))


def _empty_figure(panels: Sequence[Panel], shape: float) -> tuple[Figure, dict[Panel, Axes]]:
    """A figure with the floor large, and curves to the right of it; below it where it is wide, or drawn more than
    once."""
    from matplotlib.figure import Figure

    plans = [panel for panel in FROM_ABOVE if panel in panels]
    curves = [panel for panel in OVER_TIME if panel in panels]
    ratios: dict[str, Any] = {}
    if not plans:
        layout = [[curve] for curve in curves]
        size = (9.0, 3.0 * len(curves))
    elif not curves:
        layout = [plans]
        plan_width = min(max(6.0 * shape, 4.5), 12.0 / len(plans))
        size = (len(plans) * (plan_width + 1), 6.5)
    elif shape > WIDE or len(plans) > 1:
        # Each plan is as many columns wide as there are curves, and the other way round.
        layout = [
            [plan for plan in plans for _ in curves],
            [curve for curve in curves for _ in plans],
        ]
        depth = min(max(10.5 / (shape * len(plans)), 2.0), 5.0) + 1.0
        size = (11.0, depth + 3.2)
        ratios = {"height_ratios": (depth, 3.0)}
    else:
        layout = [[*plans, curve] for curve in curves]
        width = max(5.0 * shape, 3.5) + 1.0
        size = (width + 5.5, 6.5)
        ratios = {"width_ratios": (width, 5.5)}
    figure = Figure(figsize=size, layout="constrained")
    # Notebooks show by themselves the figures of pyplot only.
    figure._repr_png_ = partial(png_bytes, figure, 72, False)  # type: ignore[attr-defined]
    mosaic: Any = layout
    places = figure.subplot_mosaic(mosaic, sharex=not plans, **ratios)
    for curve in curves[1:]:
        places[curve].sharex(places[curves[0]])
    return figure, places


def png_bytes(figure: Figure, dpi: int = 110, transparent: bool = True) -> bytes:
    """A finished picture."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=dpi, transparent=transparent)
    return file.getvalue()


def _write_legends(figure: Figure, places: dict[Panel, Axes], runs: Sequence[NamedTracks]) -> None:
    """Write the titles of figure and panels, and a legend where there is more than one name."""
    titles = FROM_ABOVE | OVER_TIME
    if not any(np.isfinite(run.tracks.x_m).any() for run in runs):
        titles["paths"] = "In the image"
    for panel, axes in places.items():
        axes.set_title(titles[panel], loc="left", fontsize=10, color=INK)
        _, names = axes.get_legend_handles_labels()
        if panel == "paths" and len(runs) == 1:
            if names:
                title = "person (ring: start, dot: end, dotted: hidden)"
                axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.09), ncols=7, title=title, **LEGEND)
        elif len(names) > 1:
            if panel == "paths":
                axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.09), ncols=4, **LEGEND)
            else:
                axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, **LEGEND)
    if len(runs) == 1 and runs[0].name:
        figure.suptitle(runs[0].name, x=0.01, ha="left", fontsize=12, color=INK)
