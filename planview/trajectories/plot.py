"""Plots of trajectories: paths on the floor, speed and number of people over time. Needs matplotlib."""

from __future__ import annotations

import colorsys
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from calib.errors import InputError
from calib.types import F64, I64, Bool
from planview.trajectories.state import State

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Colouring = Literal["id", "time"]
NAMED_MAX = 20
"""Ids in a legend; more cannot be told apart by their colours."""
SMOOTH_S = 0.5
"""Time over which a speed is the mean [s]: about one step."""
TRUTH_COLOUR, INK, FAINT = "#141414", "#333333", "#b9bec6"


class Rows(Protocol):
    """The columns of ``Trajectories`` that are drawn."""

    def __len__(self) -> int: ...

    @property
    def frame(self) -> I64: ...

    @property
    def track_id(self) -> I64: ...

    @property
    def timestamp_s(self) -> F64: ...

    @property
    def x_m(self) -> F64: ...

    @property
    def y_m(self) -> F64: ...

    @property
    def state(self) -> np.ndarray[tuple[int], np.dtype[np.str_]]: ...

    @property
    def box_px(self) -> F64: ...

    @property
    def velocity_mps(self) -> F64: ...


def person_rgb(track_id: int, state: State | Literal[""] = "confirmed") -> tuple[int, int, int]:
    """One colour per id, the same in all pictures; pale while lost."""
    # Step around the colour circle from id to id: neighbouring ids differ most.
    red, green, blue = colorsys.hsv_to_rgb(0.618034 * track_id % 1.0, 0.85, 0.95)
    # Colours are darkened to this luma, so that they are legible on white paper and on images [levels of 255].
    darker = min(1.0, 150.0 / max(1.0, 255 * (0.299 * red + 0.587 * green + 0.114 * blue)))
    rgb = 255 * darker * np.array([red, green, blue])
    red, green, blue = (0.55 * rgb + 0.45 * 190 if state == "lost" else rgb).tolist()
    return round(red), round(green), round(blue)


def person_hex(track_id: int) -> str:
    """``person_rgb`` of a confirmed person as "#rrggbb"."""
    return "#{:02x}{:02x}{:02x}".format(*person_rgb(track_id))


def plot_paths(table: Rows, axes: Axes, *, colour: Colouring | str = "id", label: str = "", width: float = 1.6) -> Axes:
    """Draw where people walked, seen from above: metres on the floor, or pixels where only boxes are known.

    A ring is where a path begins, a dot where it ends; dotted lines are predicted while a person was hidden. Tracks
    that were never confirmed are left out.

    Args:
        colour: "id", "time" with a colour bar, or one colour of matplotlib for all.
        label: of all paths together in the legend, for one colour.
        width: of the lines, in points.
    Raises:
        InputError: neither positions on the floor nor boxes.
    """
    places, unit = _places(table)
    shown = _shown(table, places)
    ids = _longest(table, shown)
    chosen = set(ids[:NAMED_MAX].tolist()) if colour == "id" else set()
    times_s = times_of(table, table.frame)
    for track_id in sorted(ids.tolist()):
        rows = np.flatnonzero(shown & (table.track_id == track_id))
        path, seen = places[rows].copy(), table.state[rows] == "confirmed"
        single = colour if colour not in ("id", "time") else person_hex(track_id) if track_id in chosen else FAINT
        if not seen.all():
            axes.plot(*_broken(path, table.frame[rows]).T, ":", color=single if colour != "time" else FAINT, lw=1.0)
        solid = _broken(np.where(seen[:, None], path, np.nan), table.frame[rows])
        if colour == "time":
            _plot_by_time(axes, np.where(seen[:, None], path, np.nan), times_s[rows], times_s)
        else:
            name = str(track_id) if track_id in chosen else None
            axes.plot(*solid.T, color=single, lw=width, solid_capstyle="round", label=name)
            axes.plot(*path[0], "o", ms=5, mfc="white", mec=single, zorder=3)
            axes.plot(*path[-1], "o", ms=5, color=single, zorder=3)
    if colour not in ("id", "time") and len(ids):
        axes.plot([], [], color=colour, lw=width, label=label or None)
    if len(ids) > len(chosen) > 0:
        axes.plot([], [], color=FAINT, lw=1.6, label=f"{len(ids) - len(chosen)} more")
    if colour == "time" and len(ids):
        bar = axes.figure.colorbar(axes.collections[0], ax=axes, shrink=0.7, pad=0.02, label="time [s]")
        bar.outline.set_visible(False)
        _styled(bar.ax).grid(False)
    return _floor_axes(axes, unit)


def plot_truth(table: Rows, axes: Axes) -> None:
    """Draw true paths thinly below others."""
    places, _ = _places(table)
    for n, track_id in enumerate(np.unique(table.track_id).tolist()):
        rows = np.flatnonzero((table.track_id == track_id) & np.isfinite(places).all(axis=1))
        path = _broken(places[rows], table.frame[rows])
        axes.plot(*path.T, "--", color=TRUTH_COLOUR, lw=0.8, label="truth" if n == 0 else None, zorder=1.5)


def plot_speed(table: Rows, axes: Axes, *, colour: str = "id", label: str = "") -> Axes:
    """Draw speed over time: one line per person, or in one colour the mean of all people at every moment."""
    places, unit = _places(table)
    shown = _shown(table, places) & (table.state == "confirmed")
    times_s, speeds = times_of(table, table.frame), np.full(len(table), np.nan)
    ids = _longest(table, shown)
    for track_id in ids.tolist():
        rows = np.flatnonzero(shown & (table.track_id == track_id))
        speeds[rows] = _speed(places[rows], table.velocity_mps[rows], times_s[rows])
        if colour == "id":
            line = _broken(np.column_stack([times_s[rows], speeds[rows]]), table.frame[rows])
            named = track_id in ids[:NAMED_MAX]
            axes.plot(*line.T, color=person_hex(track_id) if named else FAINT, lw=1.2, zorder=2 if named else 1)
    if colour != "id" and len(ids):
        known = np.flatnonzero(np.isfinite(speeds))
        frames, where = np.unique(table.frame[known], return_inverse=True)
        mean = np.bincount(where, speeds[known]) / np.bincount(where)
        line = _broken(np.column_stack([times_of(table, frames), mean]), frames)
        axes.plot(*line.T, color=colour, lw=1.4, label=label or None)
    axes.set_ylabel(f"speed [{unit}/s]" if colour == "id" else f"mean speed [{unit}/s]")
    return _time_axes(axes)


def plot_counts(
    table: Rows, axes: Axes, *, colour: str = "#1f4e9c", label: str = "", style: str = "-",
    clock: Rows | None = None,
) -> Axes:  # fmt: skip
    """Draw the number of people in view over time; ``clock`` has the times of the frames where the table has none."""
    from matplotlib.ticker import MaxNLocator

    if len(table):
        step = _frame_step(table.frame)
        frames = np.arange(table.frame.min(), table.frame.max() + step + 1, step)
        seen = np.sort(table.frame[table.state == "confirmed"])
        count = np.searchsorted(seen, frames, side="right") - np.searchsorted(seen, frames)
        times_s = times_of(table if clock is None else clock, frames)
        axes.plot(times_s, count, style, drawstyle="steps-post", color=colour, lw=1.3, label=label or None)
    axes.set_ylabel("people in view")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=6, min_n_ticks=2))
    return _time_axes(axes)


def times_of(table: Rows, frames: I64) -> F64:
    """(N,) times [s] of frames; at 30 frames per second where no row has a time."""
    known = np.isfinite(table.timestamp_s)
    at, first = np.unique(table.frame[known], return_index=True)
    if len(at) < 2:
        return frames / 30.0
    times_s = table.timestamp_s[known][first]
    beyond = (frames - np.clip(frames, at[0], at[-1])) * (times_s[-1] - times_s[0]) / (at[-1] - at[0])
    return np.asarray(np.interp(frames, at, times_s) + beyond)


def _places(table: Rows) -> tuple[F64, str]:
    """(N, 2) floor positions and "m"; the middle of the lower edge of boxes and "px" where none is known."""
    places = np.column_stack([table.x_m, table.y_m])
    if len(table) and not np.isfinite(places).all(axis=1).any():
        left, top, width, height = table.box_px.T
        places = np.column_stack([left + width / 2, top + height])
        if not np.isfinite(places).all(axis=1).any():
            raise InputError("expected trajectories with floor positions or boxes to plot, found neither")
        return places, "px"
    return places, "m"


def _shown(table: Rows, places: F64) -> Bool:
    """(N,) rows of tracks that were confirmed at some time, from then to the last time."""
    confirmed = table.state == "confirmed"
    known = (table.state != "tentative") & np.isin(table.track_id, np.unique(table.track_id[confirmed]))
    return np.asarray(known & np.isfinite(places).all(axis=1))


def _longest(table: Rows, shown: Bool) -> I64:
    """Ids by falling number of rows."""
    ids, rows = np.unique(table.track_id[shown], return_counts=True)
    return np.asarray(ids[np.argsort(-rows, kind="stable")])


def _frame_step(frames: I64) -> int:
    """Usual step from a frame with rows to the next: 1 but for truth of every n-th frame."""
    steps = np.diff(np.unique(frames))
    return int(np.median(steps)) if len(steps) else 1


def _broken(values: F64, frames: I64) -> F64:
    """The (N, 2) values with a row of NaN wherever frames are missing, so that no line bridges them."""
    gaps = np.flatnonzero(np.diff(frames) > 2 * _frame_step(frames)) + 1
    return np.asarray(np.insert(values.astype(np.float64), gaps, np.nan, axis=0))


def _plot_by_time(axes: Axes, path: F64, times_s: F64, all_s: F64) -> None:
    from matplotlib.collections import LineCollection

    lines = LineCollection(list(np.stack([path[:-1], path[1:]], axis=1)), cmap="viridis", lw=1.8, capstyle="round")
    lines.set_array(times_s[:-1])
    lines.set_clim(float(all_s.min()), float(all_s.max()))
    axes.add_collection(lines)


def _speed(places: F64, velocity: F64, times_s: F64) -> F64:
    """(N,) speeds of one track, smoothed; by differences where the tracker gave no velocity."""
    speed = np.hypot(*velocity.T)
    if not np.isfinite(speed).any() and len(places) > 1:
        speed = np.hypot(*np.gradient(places, times_s, axis=0).T)
    step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 1.0
    width = max(1, min(len(speed), round(SMOOTH_S / max(step_s, 1e-6))))
    known, window = np.isfinite(speed), np.ones(width)
    weight = np.convolve(known, window, "same")
    return np.asarray(np.convolve(np.where(known, speed, 0.0), window, "same") / np.maximum(weight, 1e-9))


def _floor_axes(axes: Axes, unit: str) -> Axes:
    axes.set_aspect("equal", adjustable="datalim" if unit == "px" else "box")
    axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    if unit == "px" and not axes.yaxis_inverted():
        axes.invert_yaxis()
    if axes.collections:
        axes.autoscale_view()
    axes.margins(0.06)
    return _styled(axes)


def _time_axes(axes: Axes) -> Axes:
    axes.set_xlabel("time [s]")
    axes.set_ylim(bottom=0)
    axes.margins(x=0.01)
    return _styled(axes)


def _styled(axes: Axes) -> Axes:
    axes.grid(color="#e3e6ea", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(FAINT)
    axes.tick_params(colors=INK, labelsize=8, length=3)
    axes.xaxis.label.set(size=9, color=INK)
    axes.yaxis.label.set(size=9, color=INK)
    return axes
