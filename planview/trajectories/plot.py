"""Plots of trajectories: paths on the floor, speed and number of people over time. Needs matplotlib.

Rows are DataFrames with the columns of ``tracks.csv`` (``Trajectories.to_dataframe``).
"""

from __future__ import annotations

import colorsys
from typing import TYPE_CHECKING, Literal

import numpy as np

from calib.errors import InputError
from calib.types import F64, I64
from planview.trajectories.clock import USUAL_FPS, Clock
from planview.trajectories.ends import track_numbers
from planview.trajectories.state import State
from planview.trajectories.table import people_of, table_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from pandas import DataFrame

Colouring = Literal["id", "time"]
NAMED_MAX = 20
"""Ids in a legend; more cannot be told apart by their colours."""
SMOOTH_S = 0.5
"""Time over which a speed is the mean [s]: about one step."""
TRUTH_COLOUR = "#141414"
INK = "#333333"
FAINT = "#b9bec6"


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


def plot_paths(
    rows: DataFrame, axes: Axes, *, colour: Colouring | str = "id", label: str = "", width: float = 1.6
) -> Axes:
    """Draw where people walked, seen from above: metres on the floor, or pixels where only boxes are known.

    A ring is where a path begins, a dot where it ends; dotted lines are predicted while a person was hidden. Tracks
    that were never confirmed are left out. Raises InputError: neither positions on the floor nor boxes.

    Args:
        colour: "id", "time" with a colour bar, or one colour of matplotlib for all, with a label in the legend.
        width: of the lines, in points.
    """
    from matplotlib.collections import LineCollection

    placed, unit = _placed(rows)
    shown = _of_people(placed)
    longest = shown["id"].value_counts().index
    chosen = set(longest[:NAMED_MAX]) if colour == "id" else set()
    for track_id, own in shown.groupby("id"):
        path = own[["u", "v"]].to_numpy()
        seen = own["state"] == "confirmed"
        solid = np.where(seen.to_numpy()[:, None], path, np.nan)
        single = colour if colour not in ("id", "time") else person_hex(track_id) if track_id in chosen else FAINT
        if not seen.all():
            axes.plot(*_broken(path, own).T, ":", color=single if colour != "time" else FAINT, lw=1.0)
        if colour == "time":
            solid[_breaks(own) - 1] = np.nan
            segments = list(np.stack([solid[:-1], solid[1:]], axis=1))
            lines = LineCollection(segments, cmap="viridis", lw=1.8, capstyle="round")
            lines.set_array(own["time_s"].to_numpy()[:-1])
            lines.set_clim(float(placed["time_s"].min()), float(placed["time_s"].max()))
            axes.add_collection(lines)
        else:
            name = str(track_id) if track_id in chosen else None
            axes.plot(*_broken(solid, own).T, color=single, lw=width, solid_capstyle="round", label=name)
            axes.plot(*path[0], "o", ms=5, mfc="white", mec=single, zorder=3)
            axes.plot(*path[-1], "o", ms=5, color=single, zorder=3)
    if colour not in ("id", "time") and len(longest):
        axes.plot([], [], color=colour, lw=width, label=label or None)
    if len(longest) > len(chosen) > 0:
        axes.plot([], [], color=FAINT, lw=1.6, label=f"{len(longest) - len(chosen)} more")
    if colour == "time" and len(longest):
        _add_bar(axes, axes.collections[0], "time [s]")
    return _floor_axes(axes, unit)


DENSITY_CELL_M = 0.1
DENSITY_BLUR_M = 0.3
FLOW_CELL_M = 0.5
"""Cells of densities and of flows, and the deviation of the Gaussian that stands for a person's room [m]."""


def plot_density(rows: DataFrame, axes: Axes) -> Axes:
    """Draw the mean number of people per square metre over time, seen from above. Raises InputError: no positions on
    the floor."""
    from scipy.ndimage import gaussian_filter

    shown, x, y = _on_floor(rows, DENSITY_CELL_M)
    if shown.empty:
        return _floor_axes(axes, "m")
    people, _, _ = np.histogram2d(shown["u"], shown["v"], bins=[x, y])
    density = gaussian_filter(people, DENSITY_BLUR_M / DENSITY_CELL_M) / (_frames(rows) * DENSITY_CELL_M**2)
    shades = axes.pcolormesh(x, y, np.ma.masked_less(density.T, 0.04 * density.max()), cmap="inferno", alpha=0.75)
    _add_bar(axes, shades, "people per m²")
    return _floor_axes(axes, "m")


def plot_flow(rows: DataFrame, axes: Axes) -> Axes:
    """Draw the specific flow seen from above: density times mean velocity, in people per metre and second, as arrows.
    Raises InputError: no positions on the floor."""
    shown, x, y = _on_floor(rows, FLOW_CELL_M)
    if shown.empty:
        return _floor_axes(axes, "m")
    velocities = shown[["vx_mps", "vy_mps"]]
    if velocities.isna().all(axis=None):  # a table of places alone
        by_track = shown.groupby("track")
        velocities = by_track[["u", "v"]].diff().div(by_track["time_s"].diff(), axis=0)
    sums = [
        np.histogram2d(shown["u"], shown["v"], bins=[x, y], weights=np.nan_to_num(velocities[name].to_numpy()))[0]
        for name in velocities
    ]
    u, v = (each.T / (_frames(rows) * FLOW_CELL_M**2) for each in sums)
    flow = np.hypot(u, v)
    middle = FLOW_CELL_M / 2
    shows = flow > 0.02 * flow.max()
    places = [axis[shows] for axis in np.meshgrid(x[:-1] + middle, y[:-1] + middle)]
    along = np.stack([u[shows], v[shows]]) / np.maximum(flow[shows], 1e-9)
    arrows = axes.quiver(*places, *along, flow[shows], cmap="viridis", pivot="mid", scale=2.5, scale_units="x")
    _add_bar(axes, arrows, "people per metre and second")
    return _floor_axes(axes, "m")


def _on_floor(rows: DataFrame, cell_m: float) -> tuple[DataFrame, F64, F64]:
    """Confirmed rows on the floor, and the edges of cells around them [m]; none where there is nobody."""
    placed, unit = _placed(rows)
    shown = _of_people(placed)
    shown = shown[shown["state"] == "confirmed"]
    if unit != "m":
        raise InputError("expected trajectories on the floor, found none")
    if shown.empty:
        return shown, np.empty(0), np.empty(0)
    low = shown[["u", "v"]].min() - 1.0
    high = shown[["u", "v"]].max() + 1.0
    x, y = (np.arange(low[name], high[name] + cell_m, cell_m) for name in ("u", "v"))
    return shown, x, y


def _frames(rows: DataFrame) -> int:
    """Number of frames from the first row to the last."""
    return int(np.ptp(rows["frame"])) // _frame_step(rows["frame"].to_numpy()) + 1


def _add_bar(axes: Axes, shades: ScalarMappable, label: str) -> None:
    bar = axes.figure.colorbar(shades, ax=axes, shrink=0.7, pad=0.02, label=label)
    bar.outline.set_visible(False)
    _styled(bar.ax).grid(False)


def plot_truth(rows: DataFrame, axes: Axes) -> None:
    """Draw true paths thinly below others."""
    known = _placed(rows)[0].dropna(subset=["u", "v"])
    for n, (_, own) in enumerate(known.groupby("id")):
        path = _broken(own[["u", "v"]].to_numpy(), own)
        axes.plot(*path.T, "--", color=TRUTH_COLOUR, lw=0.8, label="truth" if n == 0 else None, zorder=1.5)


def plot_speed(rows: DataFrame, axes: Axes, *, colour: str = "id", label: str = "") -> Axes:
    """Draw speed over time: one line per person, or in one colour the mean of all people at every moment."""
    placed, unit = _placed(rows)
    shown = _of_people(placed)
    shown = shown[shown["state"] == "confirmed"].copy()
    named = set(shown["id"].value_counts().index[:NAMED_MAX])
    for (track_id, _), own in shown.groupby(["id", "track"]):
        speed = _speed(own)
        shown.loc[own.index, "speed"] = speed
        if colour == "id":
            line = _broken(np.column_stack([own["time_s"], speed]), own)
            first = track_id in named
            axes.plot(*line.T, color=person_hex(track_id) if first else FAINT, lw=1.2, zorder=2 if first else 1)
    if colour != "id" and len(shown):
        mean = shown.dropna(subset="speed").groupby("frame")[["time_s", "speed"]].mean()
        moments = mean.reset_index().assign(track=0)
        axes.plot(*_broken(mean.to_numpy(), moments).T, color=colour, lw=1.4, label=label or None)
    axes.set_ylabel(f"speed [{unit}/s]" if colour == "id" else f"mean speed [{unit}/s]")
    return _time_axes(axes)


def plot_counts(
    rows: DataFrame, axes: Axes, *, colour: str = "#1f4e9c", label: str = "", style: str = "-",
    clock: DataFrame | None = None,
) -> Axes:  # fmt: skip
    """Draw the number of people in view over time; ``clock`` has the times of the frames where the rows have none."""
    from matplotlib.ticker import MaxNLocator

    table = table_of(rows, "rows")
    if len(table):
        step = _frame_step(table.frame)
        frames = np.arange(table.frame.min(), table.frame.max() + step + 1, step)
        is_seen = (table.state == "confirmed") & np.isin(table.track_id, people_of(table))
        seen, people = np.unique(table.frame[is_seen], return_counts=True)
        count = np.zeros(len(frames), dtype=np.int64)
        count[np.searchsorted(frames, seen)] = people
        times_s = Clock(table if clock is None else table_of(clock, "clock"), USUAL_FPS).at(frames)
        axes.plot(times_s, count, style, drawstyle="steps-post", color=colour, lw=1.3, label=label or None)
    axes.set_ylabel("people in view")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=6, min_n_ticks=2))
    return _time_axes(axes)


def _placed(rows: DataFrame) -> tuple[DataFrame, str]:
    """The rows with time_s, the number of their track, whether they are of people, and their place u, v: on the floor,
    and "m"; the middle of the lower edge of boxes, and "px", where none is known there."""
    table = table_of(rows, "rows")
    rows = table.to_dataframe()
    u = rows["x_m"]
    v = rows["y_m"]
    unit = "m"
    if len(rows) and (u + v).isna().all():
        u = rows["left_px"] + rows["width_px"] / 2
        v = rows["top_px"] + rows["height_px"]
        unit = "px"
        if (u + v).isna().all():
            raise InputError("expected trajectories with floor positions or boxes to plot, found neither")
    time_s = Clock(table, USUAL_FPS).at(table.frame)
    is_person = np.isin(table.track_id, people_of(table))
    return rows.assign(u=u, v=v, time_s=time_s, track=track_numbers(table, time_s), is_person=is_person), unit


def _of_people(placed: DataFrame) -> DataFrame:
    """The rows with a place of people, from when they were confirmed to the last time."""
    return placed[placed["is_person"] & (placed["state"] != "tentative")].dropna(subset=["u", "v"])


def _frame_step(frames: I64) -> int:
    """Usual step from a frame with rows to the next: 1 but for truth of every n-th frame."""
    steps = np.diff(np.unique(frames))
    return int(np.median(steps)) if len(steps) else 1


def _broken(values: F64, rows: DataFrame) -> F64:
    """The (N, 2) values of rows with a row of NaN wherever frames are missing or a track ends, so that no line bridges
    them."""
    return np.asarray(np.insert(values.astype(np.float64), _breaks(rows), np.nan, axis=0))


def _breaks(rows: DataFrame) -> I64:
    """The rows of one person before which frames are missing or a track ends."""
    frames = rows["frame"].to_numpy()
    is_missing = np.diff(frames) > 2 * _frame_step(frames)
    has_ended = np.diff(rows["track"].to_numpy()) != 0
    return np.flatnonzero(is_missing | has_ended) + 1


def _speed(own: DataFrame) -> F64:
    """(N,) speeds of one track, smoothed; by differences where the tracker gave no velocity."""
    speed = np.hypot(own["vx_mps"], own["vy_mps"])
    steps_s = own["time_s"].diff()
    if speed.isna().all() and own["time_s"].nunique() > 1:
        # Rows of one time, as of clocks that count whole seconds, have one place and one speed.
        places = own.groupby("time_s")[["u", "v"]].mean()
        u_mps, v_mps = np.gradient(places, places.index, axis=0).T
        speed[:] = np.hypot(u_mps, v_mps)[np.searchsorted(places.index, own["time_s"])]
    step_s = float(steps_s.median() or steps_s.mean()) if len(own) > 1 else 1.0
    width = max(1, min(len(own), round(SMOOTH_S / max(step_s, 1e-6))))
    return np.asarray(speed.rolling(width, min_periods=1, center=True).mean())


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
    axes.autoscale(axis="y")  # a limit that is set stays, and would cut off what is drawn after it
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
