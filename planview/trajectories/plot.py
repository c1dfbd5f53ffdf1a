"""Plots of trajectories: paths on the floor, speed and number of people over time. Needs matplotlib."""

from __future__ import annotations

import colorsys
from typing import TYPE_CHECKING, Literal

import numpy as np

from calib.errors import InputError
from calib.types import F64, I64
from planview.trajectories.clock import USUAL_FPS, Clock
from planview.trajectories.ends import track_numbers
from planview.trajectories.state import State
from planview.trajectories.table import Trajectories, frame_step, people_of

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
    if state == "lost":
        rgb = 0.55 * rgb + 0.45 * 190
    red, green, blue = rgb.tolist()
    return round(red), round(green), round(blue)


def person_hex(track_id: int) -> str:
    """``person_rgb`` of a confirmed person as "#rrggbb"."""
    return "#{:02x}{:02x}{:02x}".format(*person_rgb(track_id))


def plot_paths(
    tracks: Trajectories, axes: Axes, *, colour: Colouring | str = "id", label: str = "", width: float = 1.6
) -> Axes:
    """Draw where people walked, seen from above: metres on the floor, or pixels where only boxes are known.

    A ring is where a path begins, a dot where it ends; dotted lines are predicted while a person was hidden. Tracks
    that were never confirmed are left out. Raises InputError: neither positions on the floor nor boxes.

    Args:
        colour: "id", "time" with a colour bar, or one colour of matplotlib for all, with a label in the legend.
        width: of the lines, in points.
    """
    rows, unit = _rows_with_places(tracks)
    people = _rows_of_people(rows)
    longest = people["id"].value_counts().index
    named = set(longest[:NAMED_MAX]) if colour == "id" else set()
    for track_id, person in people.groupby("id"):
        path = person[["u", "v"]].to_numpy()
        is_seen = (person["state"] == "confirmed").to_numpy()
        seen_path = np.where(is_seen[:, None], path, np.nan)
        line_colour = FAINT
        if track_id in named:
            line_colour = person_hex(track_id)
        elif colour not in ("id", "time"):
            line_colour = colour
        if not is_seen.all():
            axes.plot(*_with_gaps(path, person).T, ":", color=line_colour, lw=1.0)
        if colour == "time":
            _draw_times(axes, seen_path, person, rows["time_s"].min(), rows["time_s"].max())
        else:
            name = str(track_id) if track_id in named else None
            line = _with_gaps(seen_path, person)
            axes.plot(*line.T, color=line_colour, lw=width, solid_capstyle="round", label=name)
            axes.plot(*path[0], "o", ms=5, mfc="white", mec=line_colour, zorder=3)
            axes.plot(*path[-1], "o", ms=5, color=line_colour, zorder=3)
    if colour == "time" and len(longest):
        _add_bar(axes, axes.collections[0], "time [s]")
    elif colour != "id" and len(longest):
        axes.plot([], [], color=colour, lw=width, label=label or None)
    elif len(longest) > len(named):
        axes.plot([], [], color=FAINT, lw=1.6, label=f"{len(longest) - len(named)} more")
    return _floor_axes(axes, unit)


def _draw_times(axes: Axes, path: F64, person: DataFrame, first_s: float, last_s: float) -> None:
    """Draw an (N, 2) path in the colours of its times."""
    from matplotlib.collections import LineCollection

    path[_gaps(person) - 1] = np.nan
    segments = list(np.stack([path[:-1], path[1:]], axis=1))
    lines = LineCollection(segments, cmap="viridis", lw=1.8, capstyle="round")
    lines.set_array(person["time_s"].to_numpy()[:-1])
    lines.set_clim(first_s, last_s)
    axes.add_collection(lines)


DENSITY_CELL_M = 0.1
DENSITY_BLUR_M = 0.3
FLOW_CELL_M = 0.5
"""Cells of densities and of flows, and the deviation of the Gaussian that stands for a person's room [m]."""


def plot_density(tracks: Trajectories, axes: Axes) -> Axes:
    """Draw the mean number of people per square metre over time, seen from above. Raises InputError: no positions on
    the floor."""
    from scipy.ndimage import gaussian_filter

    people, x, y = _rows_on_floor(tracks, DENSITY_CELL_M)
    if people.empty:
        return _floor_axes(axes, "m")
    counts, _, _ = np.histogram2d(people["u"], people["v"], bins=[x, y])
    density = gaussian_filter(counts, DENSITY_BLUR_M / DENSITY_CELL_M) / (_frames(tracks) * DENSITY_CELL_M**2)
    shades = axes.pcolormesh(x, y, np.ma.masked_less(density.T, 0.04 * density.max()), cmap="inferno", alpha=0.75)
    _add_bar(axes, shades, "people per m²")
    return _floor_axes(axes, "m")


def plot_flow(tracks: Trajectories, axes: Axes) -> Axes:
    """Draw the specific flow seen from above: density times mean velocity, in people per metre and second, as arrows.
    Raises InputError: no positions on the floor."""
    people, x, y = _rows_on_floor(tracks, FLOW_CELL_M)
    if people.empty:
        return _floor_axes(axes, "m")
    velocities = people[["vx_mps", "vy_mps"]]
    if velocities.isna().all(axis=None):  # a table of places alone
        by_track = people.groupby("track")
        velocities = by_track[["u", "v"]].diff().div(by_track["time_s"].diff(), axis=0)
    flows = []
    for velocity in np.nan_to_num(velocities.to_numpy()).T:
        total, _, _ = np.histogram2d(people["u"], people["v"], bins=[x, y], weights=velocity)
        flows.append(total.T / (_frames(tracks) * FLOW_CELL_M**2))
    flow = np.hypot(*flows)
    is_shown = flow > 0.02 * flow.max()
    middle_x, middle_y = np.meshgrid(x[:-1] + FLOW_CELL_M / 2, y[:-1] + FLOW_CELL_M / 2)
    strength = flow[is_shown]
    along = np.stack([part[is_shown] for part in flows]) / np.maximum(strength, 1e-9)
    arrows = axes.quiver(
        middle_x[is_shown], middle_y[is_shown], *along, strength,
        cmap="viridis", pivot="mid", scale=2.5, scale_units="x",
    )  # fmt: skip
    _add_bar(axes, arrows, "people per metre and second")
    return _floor_axes(axes, "m")


def _rows_on_floor(tracks: Trajectories, cell_m: float) -> tuple[DataFrame, F64, F64]:
    """Confirmed rows of people on the floor, and the edges of cells around them [m]; none where there is nobody."""
    rows, unit = _rows_with_places(tracks)
    if unit != "m":
        raise InputError("expected trajectories on the floor, found none")
    people = _rows_of_people(rows)
    people = people[people["state"] == "confirmed"]
    if people.empty:
        return people, np.empty(0), np.empty(0)
    low = people[["u", "v"]].min() - 1.0
    high = people[["u", "v"]].max() + 1.0
    x = np.arange(low["u"], high["u"] + cell_m, cell_m)
    y = np.arange(low["v"], high["v"] + cell_m, cell_m)
    return people, x, y


def _frames(tracks: Trajectories) -> int:
    """Number of frames from the first row to the last."""
    return int(np.ptp(tracks.frame)) // frame_step(np.unique(tracks.frame)) + 1


def _add_bar(axes: Axes, shades: ScalarMappable, label: str) -> None:
    bar = axes.figure.colorbar(shades, ax=axes, shrink=0.7, pad=0.02, label=label)
    bar.outline.set_visible(False)
    style_axes(bar.ax).grid(False)


def plot_truth(truth: Trajectories, axes: Axes) -> None:
    """Draw true paths thinly below others."""
    rows, _ = _rows_with_places(truth)
    label = "truth"
    for _, person in rows.dropna(subset=["u", "v"]).groupby("id"):
        path = _with_gaps(person[["u", "v"]].to_numpy(), person)
        axes.plot(*path.T, "--", color=TRUTH_COLOUR, lw=0.8, label=label, zorder=1.5)
        label = "_"  # once in the legend


def plot_speed(tracks: Trajectories, axes: Axes, *, colour: str = "id", label: str = "") -> Axes:
    """Draw speed over time: one line per person, or in one colour the mean of all people at every moment."""
    rows, unit = _rows_with_places(tracks)
    people = _rows_of_people(rows)
    people = people[people["state"] == "confirmed"].copy()
    named = set(people["id"].value_counts().index[:NAMED_MAX])
    for (track_id, _), track in people.groupby(["id", "track"]):
        speed = _speed(track)
        people.loc[track.index, "speed"] = speed
        if colour == "id":
            line = _with_gaps(np.column_stack([track["time_s"], speed]), track)
            if track_id in named:
                axes.plot(*line.T, color=person_hex(track_id), lw=1.2, zorder=2)
            else:
                axes.plot(*line.T, color=FAINT, lw=1.2, zorder=1)
    if colour != "id" and len(people):
        mean = people.dropna(subset="speed").groupby("frame")[["time_s", "speed"]].mean()
        moments = mean.reset_index().assign(track=0)
        axes.plot(*_with_gaps(mean.to_numpy(), moments).T, color=colour, lw=1.4, label=label or None)
    axes.set_ylabel(f"speed [{unit}/s]" if colour == "id" else f"mean speed [{unit}/s]")
    return time_axes(axes)


def plot_counts(
    tracks: Trajectories, axes: Axes, *, colour: str = "#1f4e9c", label: str = "", style: str = "-",
    clock: Trajectories | None = None,
) -> Axes:  # fmt: skip
    """Draw the number of people in view over time; ``clock`` has the times of the frames where the tracks have none."""
    if len(tracks):
        step = frame_step(np.unique(tracks.frame))
        frames = np.arange(tracks.frame.min(), tracks.frame.max() + step + 1, step)
        is_seen = (tracks.state == "confirmed") & np.isin(tracks.track_id, people_of(tracks))
        seen, people = np.unique(tracks.frame[is_seen], return_counts=True)
        count = np.zeros(len(frames), dtype=np.int64)
        count[np.searchsorted(frames, seen)] = people
        times_s = Clock(clock or tracks, USUAL_FPS).at(frames)
        axes.plot(times_s, count, style, drawstyle="steps-post", color=colour, lw=1.3, label=label or None)
    return count_axes(axes, "people in view")


def _rows_with_places(tracks: Trajectories) -> tuple[DataFrame, str]:
    """The rows with time_s, the number of their track, whether they are of people, and their place u, v: on the floor,
    and "m"; the middle of the lower edge of boxes, and "px", where none is known there."""
    rows = tracks.to_dataframe()
    unit = "m"
    u = rows["x_m"]
    v = rows["y_m"]
    if len(rows) and (u + v).isna().all():
        unit = "px"
        u = rows["left_px"] + rows["width_px"] / 2
        v = rows["top_px"] + rows["height_px"]
        if (u + v).isna().all():
            raise InputError("expected trajectories with floor positions or boxes to plot, found neither")
    time_s = Clock(tracks, USUAL_FPS).at(tracks.frame)
    is_person = np.isin(tracks.track_id, people_of(tracks))
    return rows.assign(u=u, v=v, time_s=time_s, track=track_numbers(tracks, time_s), is_person=is_person), unit


def _rows_of_people(rows: DataFrame) -> DataFrame:
    """The rows with a place of people, from when they were confirmed to the last time."""
    return rows[rows["is_person"] & (rows["state"] != "tentative")].dropna(subset=["u", "v"])


def _with_gaps(values: F64, rows: DataFrame) -> F64:
    """The (N, 2) values of rows with a row of NaN in every gap, so that no line bridges it."""
    return np.asarray(np.insert(values.astype(np.float64), _gaps(rows), np.nan, axis=0))


def _gaps(rows: DataFrame) -> I64:
    """The rows of one person before which frames are missing or a track ends."""
    frames = rows["frame"].to_numpy()
    is_missing = np.diff(frames) > 2 * frame_step(frames)
    has_ended = np.diff(rows["track"].to_numpy()) != 0
    return np.flatnonzero(is_missing | has_ended) + 1


def _speed(track: DataFrame) -> F64:
    """(N,) speeds of one track, smoothed; by differences where the tracker gave no velocity."""
    speed = np.hypot(track["vx_mps"], track["vy_mps"])
    steps_s = track["time_s"].diff()
    if speed.isna().all() and track["time_s"].nunique() > 1:
        # Rows of one time, as of clocks that count whole seconds, have one place and one speed.
        places = track.groupby("time_s")[["u", "v"]].mean()
        u_mps, v_mps = np.gradient(places, places.index, axis=0).T
        speed[:] = np.hypot(u_mps, v_mps)[np.searchsorted(places.index, track["time_s"])]
    step_s = float(steps_s.median() or steps_s.mean()) if len(track) > 1 else 1.0
    width = max(1, min(len(track), round(SMOOTH_S / max(step_s, 1e-6))))
    return np.asarray(speed.rolling(width, min_periods=1, center=True).mean())


def _floor_axes(axes: Axes, unit: str) -> Axes:
    axes.set_aspect("equal", adjustable="datalim" if unit == "px" else "box")
    axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    if unit == "px" and not axes.yaxis_inverted():
        axes.invert_yaxis()
    if axes.collections:
        axes.autoscale_view()
    axes.margins(0.06)
    return style_axes(axes)


def count_axes(axes: Axes, label: str) -> Axes:
    """Axes of whole numbers over time."""
    from matplotlib.ticker import MaxNLocator

    axes.set_ylabel(label)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=6, min_n_ticks=2))
    return time_axes(axes)


def time_axes(axes: Axes) -> Axes:
    """Axes of values over time, from 0 up."""
    axes.set_xlabel("time [s]")
    axes.autoscale(axis="y")  # a limit that is set stays, and would cut off what is drawn after it
    axes.set_ylim(bottom=0)
    axes.margins(x=0.01)
    return style_axes(axes)


def style_axes(axes: Axes) -> Axes:
    """Axes with the looks of all plots."""
    axes.grid(color="#e3e6ea", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(FAINT)
    axes.tick_params(colors=INK, labelsize=8, length=3)
    axes.xaxis.label.set(size=9, color=INK)
    axes.yaxis.label.set(size=9, color=INK)
    return axes
