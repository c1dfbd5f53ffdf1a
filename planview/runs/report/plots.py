"""Pictures of a run as PNG bytes (matplotlib without a display)."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.types import F64, I64
from planview.maps.grid import Grid
from planview.pipeline.info import CameraInfo
from planview.trajectories.table import Trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (
    "#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#e377c2", "#8c564b", "#bcbd22", "#4c4c4c",
)  # fmt: skip
"""Of ids, in turn."""
HEAT_CELL_M = 0.2
"""Side of a heat map's cell: about a footstep's uncertainty [m]."""
_MARGIN_M = 0.5
_DPI = 110


def floor_plot(tracks: Trajectories, camera: CameraInfo | None, rules: dict[str, Any]) -> bytes:
    """Tracks on the floor with the camera at its place, its view, and the rules.

    Args:
        tracks: confirmed and lost rows; lost ones are dotted.
        camera: its view_m outlines the floor that it sees.
        rules: the ``rules`` object of counts.json.
    """
    figure, axes = new_figure(7.0, 6.0)
    for head in (camera.heads or [camera]) if camera is not None else []:
        _draw_view(axes, head)
    if camera is None:
        _draw_camera(axes, (0.0, 0.0), "")
    for name, rule in rules.items():
        _draw_rule(axes, name, rule)
    for number, track_id in enumerate(np.unique(tracks.track_id)):
        _draw_track(axes, tracks.where(tracks.track_id == track_id), COLOURS[number % len(COLOURS)])
    _floor_axes(axes)
    return png_bytes(figure)


def _draw_view(axes: Axes, camera: CameraInfo) -> None:
    if camera.view_m:
        axes.fill(*np.array(camera.view_m).T, facecolor="#e8eef7b0", edgecolor="#9db2cf", zorder=0, label="view")
    _draw_camera(axes, camera.at_m, camera.name)


def _draw_camera(axes: Axes, at_m: tuple[float, float], name: str) -> None:
    axes.plot(*at_m, marker="v", markersize=11, color="black", zorder=5)
    axes.annotate(plain_text(name) or "camera", at_m, xytext=(8, -4), textcoords="offset points", fontsize=8)


def _draw_track(axes: Axes, track: Trajectories, colour: str) -> None:
    confirmed = track.state == "confirmed"
    x, y = (np.where(np.diff(track.frame, prepend=track.frame[0]) > 1, np.nan, v) for v in (track.x_m, track.y_m))
    axes.plot(np.where(confirmed, x, np.nan), np.where(confirmed, y, np.nan), color=colour, linewidth=1.4)
    axes.plot(
        np.where(confirmed, np.nan, x), np.where(confirmed, np.nan, y), color=colour, linewidth=0.9, linestyle=":"
    )
    axes.plot(track.x_m[0], track.y_m[0], marker="o", markersize=4, color=colour)
    axes.plot(track.x_m[-1], track.y_m[-1], marker="s", markersize=4, color=colour)
    axes.annotate(
        str(track.track_id[0]), (track.x_m[0], track.y_m[0]), xytext=(4, 4), textcoords="offset points", fontsize=8
    )


def _draw_rule(axes: Axes, name: str, rule: dict[str, Any]) -> None:
    if rule.get("plane") != "floor" or not rule.get("points"):
        return
    points = np.array(rule["points"], dtype=np.float64)
    if rule.get("kind") == "tripwire":
        axes.annotate("", points[1], points[0], arrowprops={"arrowstyle": "->", "color": "#b00020", "linewidth": 1.6})
        axes.plot(*points.T, color="none")
    else:
        axes.fill(*points.T, facecolor="#f5d76e55", edgecolor="#a07f00", zorder=1)
    axes.annotate(plain_text(name), points.mean(axis=0), fontsize=8, color="#b00020", zorder=6)


def heat_map(tracks: Trajectories, frame_s: float) -> tuple[Grid, F64]:
    """Time spent per cell.

    Args:
        tracks: rows with floor positions, at least one.
        frame_s: time that a row stands for [s].
    Returns:
        The grid around the rows (coarser where the cells would be too many), and (n_rows, n_cols) float64 [s].
    """
    x_min, y_min, x_max, y_max = tracks.x_m.min(), tracks.y_m.min(), tracks.x_m.max(), tracks.y_m.max()
    cell = max(HEAT_CELL_M, float(np.hypot(x_max - x_min, y_max - y_min)) / 1000)
    grid = Grid.covering(x_min - cell, y_min - cell, x_max + cell, y_max + cell, cell)
    rows = np.floor((tracks.y_m - grid.y_min_m) / cell).astype(np.int64)
    cols = np.floor((tracks.x_m - grid.x_min_m) / cell).astype(np.int64)
    heat = np.zeros(grid.shape)
    np.add.at(heat, (rows, cols), frame_s)
    return grid, heat


def heat_plot(tracks: Trajectories, frame_s: float) -> bytes:
    """Where people spent their time."""
    grid, heat = heat_map(tracks, frame_s)
    figure, axes = new_figure(7.0, 5.4)
    shown = axes.imshow(
        np.where(heat > 0, heat, np.nan),
        origin="lower",
        extent=(grid.x_min_m, grid.x_max_m, grid.y_min_m, grid.y_max_m),
        cmap="viridis",
        interpolation="nearest",
    )
    figure.colorbar(shown, ax=axes, label="seconds per cell")
    _floor_axes(axes)
    return png_bytes(figure)


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


def crossings_plot(crossings: Mapping[str, Sequence[tuple[float, str]]], end_s: float) -> bytes:
    """Crossings of every tripwire added up over time, one line per direction.

    Args:
        crossings: (time [s], direction) of every tripwire by name.
    """
    figure, axes = new_figure(7.0, 2.6)
    for number, (name, events) in enumerate(crossings.items()):
        for direction, style, text in (
            ("left_to_right", "-", "left to right"),
            ("right_to_left", "--", "right to left"),
        ):
            times = sorted(t for t, way in events if way == direction)
            axes.step(
                [0.0, *times, max(end_s, *times, 0.0)],
                [0, *range(1, len(times) + 1), len(times)],
                style,
                where="post",
                color=COLOURS[number % len(COLOURS)],
                label=plain_text(f"{name}, {text}"),
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


def _floor_axes(axes: Axes) -> None:
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.05)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def _count_axes(axes: Axes, label: str) -> None:
    """A whole number over time."""
    axes.set_xlabel("time [s]")
    axes.set_ylabel(label)
    _whole_numbers(axes)
    axes.margins(x=0)
    _legend(axes)


def _legend(axes: Axes) -> None:
    """Above the picture, where it hides nothing."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize=8, frameon=False)


def _whole_numbers(axes: Axes) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.yaxis.set_major_locator(MaxNLocator(integer=True))


def plain_text(text: str) -> str:
    """Text that matplotlib does not take for a formula, and without characters that its font has no picture of."""
    return "".join(c for c in text if c.isprintable() and ord(c) < 0x2000).replace("$", r"\$")


def png_bytes(figure: Figure) -> bytes:
    """A finished picture."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()
