"""Pictures of a run as PNG bytes (matplotlib without a display)."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from calib.types import F64, I64, Bool
from planview.counting.events import way_words
from planview.drawing.plan import PlanBounds
from planview.drawing.style import TRIPWIRE, ZONE, as_hex, person_hex
from planview.evaluation.significant import runs
from planview.maps.grid import Grid
from planview.output.results import RunResults
from planview.trajectories.table import Trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLOURS = (
    "#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#e377c2", "#8c564b", "#bcbd22", "#4c4c4c",
)  # fmt: skip
"""Of rules and configurations, in turn; people have colours of their own."""


def people_plot(tracks: Trajectories, times_s: F64, frames: I64) -> bytes:
    """Confirmed people, and those only predicted, over time.

    Args:
        times_s, frames: (N,) time and frame of every frame of the run.
    """
    figure, axes = new_figure(7.0, 2.4)
    shades = ((("confirmed", "lost"), "#c9d6ea", "only predicted"), (("confirmed",), "#1f4e9c", "observed"))
    for states, colour, label in shades:
        rows = tracks.frame[np.isin(tracks.state, states)]
        count = np.searchsorted(rows, frames, side="right") - np.searchsorted(rows, frames)
        axes.fill_between(times_s, count, step="post", color=colour, label=label, linewidth=0)
    axes.set_ylim(0, 1.1 * max(1.0, axes.get_ylim()[1]))
    _count_axes(axes, "people")
    return png_bytes(figure)


def stage_plot(stages_ms: dict[str, float]) -> bytes:
    """Median time of every stage."""
    figure, axes = new_figure(7.0, 0.7 + 0.3 * len(stages_ms))
    bars = axes.barh([plain_text(name) for name in stages_ms], list(stages_ms.values()), color="#1f4e9c")
    axes.bar_label(bars, fmt=" %.1f", fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("median per frame [ms]")
    axes.margins(x=0.12)
    return png_bytes(figure)


def crossings_plot(
    crossings: Mapping[str, Sequence[tuple[float, str]]], end_s: float, inward: Mapping[str, str]
) -> bytes:
    """Crossings of every tripwire added up over time, one line per direction.

    Args:
        crossings: (time [s], direction) of every tripwire by name.
        inward: direction that is in, by tripwire, where one is.
    """
    figure, axes = new_figure(7.0, 2.6)
    for number, (name, events) in enumerate(crossings.items()):
        for direction, style in (("left_to_right", "-"), ("right_to_left", "--")):
            times = sorted(t for t, way in events if way == direction)
            axes.step(
                [0.0, *times, max(end_s, *times, 0.0)],
                [0, *range(1, len(times) + 1), len(times)],
                style,
                where="post",
                color=COLOURS[number % len(COLOURS)],
                label=plain_text(f"{name}, {way_words(direction, inward.get(name))}"),
            )
    _count_axes(axes, "crossings")
    return png_bytes(figure)


def occupancy_plot(series: dict[str, list[tuple[float, int]]], end_s: float) -> bytes:
    """People in every zone and length of every queue over time.

    Args:
        series: (time [s], people from then on) of every zone or queue by name.
    """
    figure, axes = new_figure(7.0, 2.6)
    for number, (name, changes) in enumerate(series.items()):
        times = [t for t, _ in changes]
        numbers = [n for _, n in changes]
        axes.step(
            [*times, max(end_s, times[-1])],
            [*numbers, numbers[-1]],
            where="post",
            color=COLOURS[number % len(COLOURS)],
            label=plain_text(name),
        )
    axes.set_ylim(0, 1.1 * max(1.0, axes.get_ylim()[1]))
    _count_axes(axes, "people")
    return png_bytes(figure)


def new_figure(width: float, height: float) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots()
    axes.grid(color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    return figure, axes


def _count_axes(axes: Axes, label: str) -> None:
    """A whole number over time; the legend above the picture, where it hides nothing."""
    from matplotlib.ticker import MaxNLocator

    axes.set_xlabel("time [s]")
    axes.set_ylabel(label)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.margins(x=0)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize=8, frameon=False)


def plain_text(text: str) -> str:
    """Text that matplotlib does not take for a formula, and without characters that its font has no picture of."""
    return "".join(c for c in text if c.isprintable() and ord(c) < 0x2000).replace("$", r"\$")


def png_bytes(figure: Figure) -> bytes:
    """A finished picture."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, transparent=True)
    return buffer.getvalue()


WIDTH_IN, HEIGHTS_IN = 7.0, (3.5, 9.0)
"""Size of a picture, its height as the floor's shape asks [inch]."""
HEAT_CELL_M = 0.2
"""Side of a heat map's cell: about a footstep's uncertainty [m]."""
HEAT_RANGE = 300.0
"""The scale of the heat map spans this factor: who stands for a minute does not hide who walks by."""


class Places(NamedTuple):
    """Where people were, columns of equal length (N,), by person then frame; a third of the room of whole rows.

    Attributes:
        frame, track_id: int64.
        xy_m: (N, 2) float64 [m].
        is_lost: only predicted.
    """

    frame: I64
    track_id: I64
    xy_m: F64
    is_lost: Bool

    @staticmethod
    def of(table: Trajectories) -> Places:
        """Of rows with positions, without tentative ones."""
        rows = np.flatnonzero((table.state != "tentative") & np.isfinite(table.x_m) & np.isfinite(table.y_m))
        rows = rows[np.lexsort((table.frame[rows], table.track_id[rows]))]
        xy = np.column_stack([table.x_m[rows], table.y_m[rows]])
        return Places(table.frame[rows], table.track_id[rows], xy, np.asarray(table.state[rows] == "lost"))

    def observed(self) -> F64:
        """(K, 2) places that are not only predicted [m]."""
        return self.xy_m[~self.is_lost]


def floor_plot(tracks: Places, run: RunResults, truth: Places | None = None) -> bytes:
    """Tracks on the floor with the camera at its place, its view, and the rules.

    Args:
        tracks: lost ones are dotted.
        run: gives views, rules and bounds.
        truth: dashed.
    """
    bounds = run.bounds()
    figure, axes = _floor_figure(bounds)
    _draw_scene(axes, run)
    if truth is not None:
        # By person, with a gap wherever a way ends.
        gaps = np.flatnonzero((np.diff(truth.track_id) != 0) | (np.diff(truth.frame) > 1)) + 1
        axes.plot(
            *np.insert(truth.xy_m, gaps, np.nan, axis=0).T,
            color="black",
            linewidth=0.8,
            linestyle=(0, (4, 3)),
            zorder=2,
        )
    # Steps from row to row of each track, all at once.
    from matplotlib.collections import LineCollection

    step = (np.diff(tracks.track_id) == 0) & (np.diff(tracks.frame) == 1)
    lost = tracks.is_lost[1:]
    for kind, width, style in ((step & ~lost, 1.5, "-"), (step & lost, 0.9, ":")):
        parts = runs(kind)
        colours = _colours(tracks.track_id[np.array([start for start, _ in parts], dtype=np.int64)])
        lines = [tracks.xy_m[start : stop + 1] for start, stop in parts]
        axes.add_collection(LineCollection(lines, colors=colours, linewidths=width, linestyles=style))
    _draw_ends(axes, tracks)
    _floor_axes(axes, bounds)
    return png_bytes(figure)


def _draw_scene(axes: Axes, run: RunResults) -> None:
    rig = run.info.rig
    for head in (rig.heads or [rig]) if rig is not None else [None]:
        at_m = head.at_m if head else (0.0, 0.0)
        axes.plot(*at_m, marker="v", markersize=11, color="black", zorder=5)
        _write(axes, plain_text(head.name if head else "") or "camera", at_m, "black")
        if head and head.view_m:
            outline = np.array(head.view_m)
            axes.fill(*outline.T, facecolor="#9db2cf30", edgecolor="#9db2cf", zorder=0, label="view")
    for rule in (rule for rule in run.rules if rule.on_floor):
        points, colour = rule.points, as_hex(TRIPWIRE if rule.is_line else ZONE)
        if rule.is_line:
            axes.annotate("", points[1], points[0], arrowprops={"arrowstyle": "->", "color": colour, "linewidth": 1.6})
        else:
            axes.fill(*points.T, facecolor=f"{colour}33", edgecolor=colour, zorder=1)
        _write(axes, plain_text(rule.name), (float(points[:, 0].mean()), float(points[:, 1].mean())), colour)


def _write(axes: Axes, text: str, at_m: tuple[float, float], colour: str) -> None:
    """Text beside a place, legible on lines."""
    from matplotlib.patheffects import withStroke

    axes.annotate(
        text, at_m, xytext=(5, 4), textcoords="offset points", fontsize=9, fontweight="bold", color=colour, zorder=7,
        path_effects=[withStroke(linewidth=2.5, foreground="white")],
    )  # fmt: skip


def _colours(ids: I64) -> list[str]:
    found, where = np.unique(ids, return_inverse=True)
    hexes = np.array([person_hex(i) for i in found.tolist()] or [""])
    return [str(colour) for colour in hexes[where]] if len(ids) else []


def _draw_ends(axes: Axes, tracks: Places) -> None:
    """A dot where each track begins, a square where it ends, and the ids of the longest ones."""
    ids, first, counts = np.unique(tracks.track_id, return_index=True, return_counts=True)
    last, colours = first + counts - 1, _colours(ids)
    axes.scatter(tracks.xy_m[first, 0], tracks.xy_m[first, 1], s=16, c=colours, marker="o", zorder=4)
    axes.scatter(tracks.xy_m[last, 0], tracks.xy_m[last, 1], s=16, c=colours, marker="s", zorder=4)
    # Tracks with their ids in the picture, the longest ones; with more the ids would cover the ways.
    for i in np.argsort(-counts, kind="stable")[:40].tolist():
        x, y = tracks.xy_m[first[i]].tolist()
        _write(axes, str(ids[i]), (x, y), colours[i])


def heat_map(xy_m: F64, frame_s: float) -> tuple[Grid, F64]:
    """Time spent per cell.

    Args:
        xy_m: (N, 2) places [m], at least one.
        frame_s: time that a place stands for [s].
    Returns:
        The grid around the places (coarser where the cells would be too many), and (n_rows, n_cols) float64 [s].
    """
    (x_min, y_min), (x_max, y_max) = xy_m.min(axis=0), xy_m.max(axis=0)
    cell = max(HEAT_CELL_M, float(np.hypot(x_max - x_min, y_max - y_min)) / 1000)
    grid = Grid.covering(x_min - cell, y_min - cell, x_max + cell, y_max + cell, cell)
    rows = np.floor((xy_m[:, 1] - grid.y_min_m) / cell).astype(np.int64)
    cols = np.floor((xy_m[:, 0] - grid.x_min_m) / cell).astype(np.int64)
    heat = np.zeros(grid.shape)
    np.add.at(heat, (rows, cols), frame_s)
    return grid, heat


def heat_plot(xy_m: F64, run: RunResults) -> bytes:
    """Where people spent their time, smoothed by a cell (arguments of ``heat_map``)."""
    from matplotlib.colors import LogNorm

    grid, heat = heat_map(xy_m, run.clock.frame_s)
    heat = np.asarray(cv2.GaussianBlur(heat, (0, 0), 0.7), dtype=np.float64)
    top = max(float(heat.max()), 1e-9)
    bounds = run.bounds()
    figure, axes = _floor_figure(bounds)
    _draw_scene(axes, run)
    shown = axes.imshow(
        np.where(heat >= top / HEAT_RANGE, heat, np.nan),
        origin="lower",
        extent=(grid.x_min_m, grid.x_max_m, grid.y_min_m, grid.y_max_m),
        cmap="viridis",
        norm=LogNorm(top / HEAT_RANGE, top),
        interpolation="nearest",
        zorder=2,
    )
    figure.colorbar(shown, ax=axes, label="seconds per cell")
    _floor_axes(axes, bounds)
    return png_bytes(figure)


def _floor_figure(bounds: PlanBounds) -> tuple[Figure, Axes]:
    shape = (bounds.y_max_m - bounds.y_min_m) / (bounds.x_max_m - bounds.x_min_m)
    return new_figure(WIDTH_IN, float(np.clip(WIDTH_IN * shape, *HEIGHTS_IN)))


def _floor_axes(axes: Axes, bounds: PlanBounds) -> None:
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(bounds.x_min_m, bounds.x_max_m)
    axes.set_ylim(bounds.y_min_m, bounds.y_max_m)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
