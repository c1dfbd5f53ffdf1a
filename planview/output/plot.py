"""The figure of ``planview plot``: paths on the floor, speed and people over time, of one run or of several."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from calib.errors import InputError
from planview.output.folder import writing
from planview.trajectories.plot import INK, TRUTH_COLOUR, Colouring, plot_counts, plot_paths, plot_speed, plot_truth
from planview.trajectories.table import Trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Panel = Literal["paths", "speed", "counts"]
PANELS: tuple[Panel, ...] = ("paths", "speed", "counts")
RUN_COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#e377c2", "#8c564b")
"""Of several runs, in turn."""
BLUE = "#1f4e9c"
"""Of the numbers of one run."""
WIDE = 1.9
"""Width over depth of the floor from which it is drawn above the curves and not next to them."""


class NamedTracks(NamedTuple):
    """Tracks and what the legend calls them."""

    name: str
    tracks: Trajectories


def figure_of(
    runs: Sequence[NamedTracks], truth: Trajectories | None = None, colour: Colouring = "id",
    panels: Sequence[Panel] = PANELS,
) -> Figure:  # fmt: skip
    """A matplotlib figure of one run coloured by ``colour``, or of several in a colour each. Raises InputError: more
    runs than colours, runs in metres and in pixels, or tracks without any place."""
    if len(runs) > len(RUN_COLOURS):
        raise InputError(f"at most {len(RUN_COLOURS)} runs can be told apart in one plot, found {len(runs)}")
    if len({bool(np.isfinite(run.tracks.x_m).any()) for run in runs if len(run.tracks)}) > 1:
        raise InputError("some of the runs are in metres and some in pixels; plot them one by one")
    figure, places = _arranged(panels, _shape(runs))
    for n, (name, tracks) in enumerate((name, tracks.to_dataframe()) for name, tracks in runs):
        own = RUN_COLOURS[n] if len(runs) > 1 else None
        if axes := places.get("paths"):
            # Of runs that lie over each other the first is the widest.
            width = max(1.0, 3.2 - 1.6 * n) if own else 1.6
            plot_paths(tracks, axes, colour=own or colour, label=name, width=width)
        if axes := places.get("speed"):
            plot_speed(tracks, axes, colour=own or ("id" if colour == "id" else BLUE), label=name if own else "")
        if axes := places.get("counts"):
            plot_counts(tracks, axes, colour=own or BLUE, label=name if own else "tracked")
    if truth is not None:
        if axes := places.get("paths"):
            plot_truth(truth.to_dataframe(), axes)
        if axes := places.get("counts"):
            clock = runs[0].tracks.to_dataframe()
            plot_counts(truth.to_dataframe(), axes, colour=TRUTH_COLOUR, label="truth", style="--", clock=clock)
    _legends(figure, places, runs, colour)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as its name ends, .png or .svg (or .pdf). Raises InputError: another ending."""
    if path.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise InputError(f"{path}: a plot is written as .png, .svg or .pdf")
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=150, metadata={"Date": None} if path.suffix.lower() != ".png" else None)


def _shape(runs: Sequence[NamedTracks]) -> float:
    """Width over depth of the floor that people used; 4:3 where it is not known."""
    x, y = (np.concatenate([getattr(run.tracks, name) for run in runs]) for name in ("x_m", "y_m"))
    known = np.isfinite(x + y)
    return float(np.ptp(x[known]) / max(float(np.ptp(y[known])), 0.1)) if known.any() else 4 / 3


def _arranged(panels: Sequence[Panel], shape: float) -> tuple[Figure, dict[Panel, Axes]]:
    """The floor large, and curves to the right of it; below it where it is wide."""
    from matplotlib.figure import Figure

    curves: list[Any] = [panel for panel in PANELS if panel in panels and panel != "paths"]
    layout: list[Any]
    ratios: dict[str, Any] = {}
    if "paths" not in panels:
        layout, size = [[curve] for curve in curves], (9.0, 3.0 * len(curves))
    elif not curves:
        layout, size = [["paths"]], (min(max(6.0 * shape, 4.5), 12.0) + 1, 6.5)
    elif shape > WIDE:
        depth = min(max(10.5 / shape, 2.0), 5.0) + 1.0
        layout, size, ratios = [["paths"] * len(curves), curves], (11.0, depth + 3.2), {"height_ratios": (depth, 3.0)}
    else:
        width = max(5.0 * shape, 3.5) + 1.0
        layout, size = [["paths", curve] for curve in curves], (width + 5.5, 6.5)
        ratios = {"width_ratios": (width, 5.5)}
    figure = Figure(figsize=size, layout="constrained")
    places = figure.subplot_mosaic(layout, sharex="paths" not in panels, **ratios)
    for curve in curves[1:]:
        places[curve].sharex(places[curves[0]])
    return figure, places


def _legends(figure: Figure, places: dict[Panel, Axes], runs: Sequence[NamedTracks], colour: Colouring) -> None:
    on_floor = any(np.isfinite(run.tracks.x_m).any() for run in runs)
    titles = {"paths": "Seen from above" if on_floor else "In the image", "speed": "Walking speed", "counts": "People"}
    for panel, axes in places.items():
        axes.set_title(titles[panel], loc="left", fontsize=10, color=INK)
        is_plan = panel == "paths"
        by_id = is_plan and colour == "id" and len(runs) == 1
        names = axes.get_legend_handles_labels()[1]
        if len(names) < 2 and not by_id:
            continue
        at = (0.0, -0.09) if is_plan else (1.0, 1.0)
        axes.legend(
            loc="upper left" if is_plan else "lower right", bbox_to_anchor=at, ncols=7 if by_id else 4,
            title="person (ring: start, dot: end, dotted: hidden)" if by_id else None,
            fontsize=8, title_fontsize=8, frameon=False, alignment="left", handlelength=1.4, columnspacing=1.2,
        )  # fmt: skip
    if len(runs) == 1:
        figure.suptitle(runs[0].name, x=0.01, ha="left", fontsize=12, color=INK)
