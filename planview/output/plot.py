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
    Colouring,
    plot_counts,
    plot_density,
    plot_flow,
    plot_paths,
    plot_speed,
    plot_truth,
)
from planview.trajectories.table import Trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Panel = Literal["paths", "density", "flow", "speed", "count"]
PANELS: tuple[Panel, ...] = ("paths", "speed", "count")
"""What is drawn where nothing else is chosen."""
FROM_ABOVE: dict[Panel, str] = {"paths": "Seen from above", "density": "Density", "flow": "Flow"}
OVER_TIME: dict[Panel, str] = {"speed": "Walking speed", "count": "People"}
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


class FloorPicture(NamedTuple):
    """(H, W, 3) uint8 RGB of the floor from above, row 0 at its lowest y, and its x from, to, y from, to [m]."""

    image: U8
    extent_m: tuple[float, float, float, float]


PIXEL_M = 0.02
"""Of a picture of the floor [m]."""


def floor_picture(run: RunFolder) -> FloorPicture | None:
    """The floor where people were, as the first frame of a run shows it; None without its recording or a camera."""
    from planview.output.render import frames_or_none  # the engine's parts take half a second

    if not run.has_run or run.camera is None or (frames := frames_or_none(run, lambda _: None)) is None:
        return None
    bounds = run.bounds()
    x, y = np.arange(bounds.x_min_m, bounds.x_max_m, PIXEL_M), np.arange(bounds.y_min_m, bounds.y_max_m, PIXEL_M)
    for _, image in frames.at([run.info.first_frame]):
        rgb = np.ascontiguousarray(as_colour(image)[..., ::-1])
        shown = from_above(rgb, run.camera, *np.meshgrid(x, y))
        pale = np.where(shown.any(axis=2, keepdims=True), 128 + shown // 2, 255)
        extent_m = bounds.x_min_m, bounds.x_max_m, bounds.y_min_m, bounds.y_max_m
        return FloorPicture(np.asarray(pale, np.uint8), extent_m)
    return None


def figure_of(
    runs: Sequence[NamedTracks], truth: Trajectories | None = None, colour: Colouring = "id",
    panels: Sequence[Panel] = PANELS, floor: FloorPicture | None = None,
) -> Figure:  # fmt: skip
    """A matplotlib figure of one run coloured by ``colour``, or of several in a colour each, over a picture of the
    floor. Raises InputError: more runs than colours, runs in metres and in pixels, tracks without any place, or density
    or flow of several runs."""
    if len(runs) > len(RUN_COLOURS):
        raise InputError(f"at most {len(RUN_COLOURS)} runs can be told apart in one plot, found {len(runs)}")
    if len({bool(np.isfinite(run.tracks.x_m).any()) for run in runs if len(run.tracks)}) > 1:
        raise InputError("some of the runs are in metres and some in pixels; plot them one by one")
    if len(runs) > 1 and (alone := {"density", "flow"}.intersection(panels)):
        raise InputError(f"{' and '.join(sorted(alone))} of several runs cannot be told apart in one plot")
    figure, places = _arranged(panels, _shape(runs))
    for n, (name, tracks) in enumerate((name, tracks.to_dataframe()) for name, tracks in runs):
        own = RUN_COLOURS[n] if len(runs) > 1 else None
        if axes := places.get("paths"):
            # Of runs that lie over each other the first is the widest.
            width = max(1.0, 3.2 - 1.6 * n) if own else 1.6
            plot_paths(tracks, axes, colour=own or colour, label=name, width=width)
        if axes := places.get("density"):
            plot_density(tracks, axes)
        if axes := places.get("flow"):
            plot_flow(tracks, axes)
        if axes := places.get("speed"):
            plot_speed(tracks, axes, colour=own or ("id" if colour == "id" else BLUE), label=name if own else "")
        if axes := places.get("count"):
            plot_counts(tracks, axes, colour=own or BLUE, label=name if own else "tracked")
    if truth is not None:
        if axes := places.get("paths"):
            plot_truth(truth.to_dataframe(), axes)
        if axes := places.get("count"):
            clock = runs[0].tracks.to_dataframe()
            plot_counts(truth.to_dataframe(), axes, colour=TRUTH_COLOUR, label="truth", style="--", clock=clock)
    for panel in FROM_ABOVE:
        if floor is not None and (axes := places.get(panel)):
            axes.imshow(floor.image, extent=floor.extent_m, origin="lower", zorder=0)
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
    """The floor large, and curves to the right of it; below it where it is wide, or drawn more than once."""
    from matplotlib.figure import Figure

    plans: list[Any] = [panel for panel in FROM_ABOVE if panel in panels]
    curves: list[Any] = [panel for panel in OVER_TIME if panel in panels]
    layout: list[Any]
    ratios: dict[str, Any] = {}
    if not plans:
        layout, size = [[curve] for curve in curves], (9.0, 3.0 * len(curves))
    elif not curves:
        layout, size = [plans], (len(plans) * (min(max(6.0 * shape, 4.5), 12.0 / len(plans)) + 1), 6.5)
    elif shape > WIDE or len(plans) > 1:
        depth = min(max(10.5 / (shape * len(plans)), 2.0), 5.0) + 1.0
        above, below = ([each for each in row for _ in other] for row, other in ((plans, curves), (curves, plans)))
        layout, size, ratios = [above, below], (11.0, depth + 3.2), {"height_ratios": (depth, 3.0)}
    else:
        width = max(5.0 * shape, 3.5) + 1.0
        layout, size = [[*plans, curve] for curve in curves], (width + 5.5, 6.5)
        ratios = {"width_ratios": (width, 5.5)}
    figure = Figure(figsize=size, layout="constrained")
    # Notebooks show by themselves the figures of pyplot only.
    figure._repr_png_ = partial(_png, figure)  # type: ignore[attr-defined]
    places = figure.subplot_mosaic(layout, sharex=not plans, **ratios)
    for curve in curves[1:]:
        places[curve].sharex(places[curves[0]])
    return figure, places


def _png(figure: Figure) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=72)
    return file.getvalue()


def _legends(figure: Figure, places: dict[Panel, Axes], runs: Sequence[NamedTracks], colour: Colouring) -> None:
    on_floor = any(np.isfinite(run.tracks.x_m).any() for run in runs)
    titles = FROM_ABOVE | OVER_TIME | ({} if on_floor else {"paths": "In the image"})
    for panel, axes in places.items():
        axes.set_title(titles[panel], loc="left", fontsize=10, color=INK)
        is_plan = panel == "paths"
        by_id = is_plan and colour == "id" and len(runs) == 1
        names = axes.get_legend_handles_labels()[1]
        if not names or (len(names) < 2 and not by_id):
            continue
        at = (0.0, -0.09) if is_plan else (1.0, 1.0)
        axes.legend(
            loc="upper left" if is_plan else "lower right", bbox_to_anchor=at, ncols=7 if by_id else 4,
            title="person (ring: start, dot: end, dotted: hidden)" if by_id else None,
            fontsize=8, title_fontsize=8, frameon=False, alignment="left", handlelength=1.4, columnspacing=1.2,
        )  # fmt: skip
    if len(runs) == 1:
        figure.suptitle(runs[0].name, x=0.01, ha="left", fontsize=12, color=INK)
