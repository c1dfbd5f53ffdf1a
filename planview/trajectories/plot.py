"""Plots of trajectories: paths on the floor, speed and number of people over time. Needs matplotlib."""

from __future__ import annotations

import colorsys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from calib.errors import InputError
from calib.types import F64, I64, Bool
from planview.trajectories.clock import USUAL_FPS, Clock
from planview.trajectories.ends import track_numbers, velocities
from planview.trajectories.state import State
from planview.trajectories.table import Trajectories, frame_step, people_of, rows_by_id

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable

NAMED_MAX = 20
"""Most ids in a legend: more have no colours that differ visibly."""
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


class _Rows(NamedTuple):
    """Rows of people with a place: (N,) ids, numbers of the tracks, frames, times, and whether they were seen; (N, 2)
    places on the floor [m], or of the middle of the lower edge of boxes [px], and velocities."""

    track_id: I64
    track: I64
    frame: I64
    time_s: F64
    is_seen: Bool
    place: F64
    velocity: F64

    def where(self, keep: Bool | I64) -> _Rows:
        columns: Iterable[Any] = self
        return _Rows(*(column[keep] for column in columns))


def plot_paths(tracks: Trajectories, axes: Axes, *, colour: str = "id", label: str = "", width: float = 1.6) -> Axes:
    """Draw where people walked, seen from above: metres on the floor, or pixels where only boxes are known.

    A ring is where a path begins, a dot where it ends; dotted lines are predicted while a person was hidden. Tracks
    that were never confirmed are left out. Raises InputError: neither positions on the floor nor boxes.

    Args:
        colour: "id", or one colour of matplotlib for all, with a label in the legend.
        width: of the lines, in points.
    """
    rows, unit = _rows_of_people(tracks)
    longest = _by_length(rows.track_id)
    named = longest[:NAMED_MAX] if colour == "id" else []
    for track_id, indices in rows_by_id(rows.track_id):
        person = rows.where(indices)
        path = person.place
        seen_path = np.where(person.is_seen[:, None], path, np.nan)
        line_colour = FAINT
        if track_id in named:
            line_colour = person_hex(track_id)
        elif colour != "id":
            line_colour = colour
        if not person.is_seen.all():
            axes.plot(*_with_gaps(path, person).T, ":", color=line_colour, lw=1.0)
        name = str(track_id) if track_id in named else None
        axes.plot(*_with_gaps(seen_path, person).T, color=line_colour, lw=width, solid_capstyle="round", label=name)
        axes.plot(*path[0], "o", ms=5, mfc="white", mec=line_colour, zorder=3)
        axes.plot(*path[-1], "o", ms=5, color=line_colour, zorder=3)
    if colour != "id" and longest:
        axes.plot([], [], color=colour, lw=width, label=label or None)
    elif len(longest) > len(named):
        axes.plot([], [], color=FAINT, lw=1.6, label=f"{len(longest) - len(named)} more")
    return _floor_axes(axes, unit)


def _by_length(track_id: I64) -> list[int]:
    """The ids, those with most rows first."""
    ids, counts = np.unique(track_id, return_counts=True)
    longest: list[int] = ids[np.argsort(-counts, kind="stable")].tolist()
    return longest


DENSITY_CELL_M = 0.1
DENSITY_BLUR_M = 0.3
"""Cells of densities, and the deviation of the Gaussian that stands for a person's room [m]."""


def plot_density(tracks: Trajectories, axes: Axes) -> Axes:
    """Draw the mean number of people per square metre over time, seen from above. Raises InputError: no positions on
    the floor."""
    from scipy.ndimage import gaussian_filter

    rows, unit = _rows_of_people(tracks)
    if unit != "m":
        raise InputError("expected trajectories on the floor, found none")
    places_m = rows.where(rows.is_seen).place
    if len(places_m):
        low = places_m.min(axis=0) - 1.0
        high = places_m.max(axis=0) + 1.0 + DENSITY_CELL_M
        x = np.arange(low[0], high[0], DENSITY_CELL_M)
        y = np.arange(low[1], high[1], DENSITY_CELL_M)
        rows_per_cell, _, _ = np.histogram2d(places_m[:, 1], places_m[:, 0], bins=[y, x])
        frames = int(np.ptp(tracks.frame)) // frame_step(np.unique(tracks.frame)) + 1
        density = gaussian_filter(rows_per_cell / (frames * DENSITY_CELL_M**2), DENSITY_BLUR_M / DENSITY_CELL_M)
        shades = axes.pcolormesh(x, y, np.ma.masked_less(density, 0.04 * density.max()), cmap="inferno", alpha=0.75)
        _add_bar(axes, shades, "people per m²")
    return _floor_axes(axes, "m")


def _add_bar(axes: Axes, shades: ScalarMappable, label: str) -> None:
    bar = axes.figure.colorbar(shades, ax=axes, shrink=0.7, pad=0.02, label=label)
    bar.outline.set_visible(False)
    style_axes(bar.ax).grid(False)


def plot_truth(truth: Trajectories, axes: Axes) -> None:
    """Draw true paths thinly below others."""
    rows, _ = _rows_with_places(truth)
    label = "truth"
    for _, indices in rows_by_id(rows.track_id):
        path = _with_gaps(rows.place[indices], rows.where(indices))
        axes.plot(*path.T, "--", color=TRUTH_COLOUR, lw=0.8, label=label, zorder=1.5)
        label = "_"  # once in the legend


def plot_speed(tracks: Trajectories, axes: Axes, *, colour: str = "id", label: str = "") -> Axes:
    """Draw speed over time: one line per person, or in one colour the mean of all people at every moment."""
    rows, unit = _rows_of_people(tracks)
    people = rows.where(rows.is_seen)
    named = _by_length(people.track_id)[:NAMED_MAX]
    speeds = np.hypot(*people.velocity.T)
    if colour == "id":
        for _, indices in rows_by_id(people.track):
            track = people.where(indices)
            line = _with_gaps(np.column_stack([track.time_s, speeds[indices]]), track)
            track_id = int(track.track_id[0])
            if track_id in named:
                axes.plot(*line.T, color=person_hex(track_id), lw=1.2, zorder=2)
            else:
                axes.plot(*line.T, color=FAINT, lw=1.2, zorder=1)
        axes.set_ylabel(f"speed [{unit}/s]")
        return time_axes(axes)
    is_known = np.isfinite(speeds)
    frames, first, frame_number = np.unique(people.frame[is_known], return_index=True, return_inverse=True)
    mean = np.bincount(frame_number, speeds[is_known]) / np.maximum(np.bincount(frame_number), 1)
    times_s = people.time_s[is_known][first]
    ends = np.flatnonzero(np.diff(frames) > 2 * frame_step(frames)) + 1
    line = np.insert(np.column_stack([times_s, mean]), ends, np.nan, axis=0)
    axes.plot(*line.T, color=colour, lw=1.4, label=label or None)
    axes.set_ylabel(f"mean speed [{unit}/s]")
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


def _rows_of_people(tracks: Trajectories) -> tuple[_Rows, str]:
    """The rows of people from when they were confirmed to the last time, and the unit of their places."""
    is_person = np.isin(tracks.track_id, people_of(tracks))
    return _rows_with_places(tracks, is_person & (tracks.state != "tentative"))


def _rows_with_places(tracks: Trajectories, keep: Bool | None = None) -> tuple[_Rows, str]:
    """The rows with a place, of some or all, and its unit: "m" on the floor, "px" where none is known there."""
    unit = "m"
    place = np.column_stack([tracks.x_m, tracks.y_m])
    is_known = np.isfinite(place).all(axis=1)
    if len(tracks) and not is_known.any():
        unit = "px"
        left, top, width, height = tracks.box_px.T
        place = np.column_stack([left + width / 2, top + height])
        is_known = np.isfinite(place).all(axis=1)
        if not is_known.any():
            raise InputError("expected trajectories with floor positions or boxes to plot, found neither")
    time_s = Clock(tracks, USUAL_FPS).at(tracks.frame)
    is_seen = np.asarray(tracks.state == "confirmed")
    track = track_numbers(tracks, time_s)
    if keep is not None:
        is_known &= keep
    seen = np.flatnonzero(is_known & is_seen)
    velocity = np.full_like(place, np.nan)
    velocity[seen] = velocities(tracks.where(seen), time_s[seen], place[seen])
    rows = _Rows(tracks.track_id, track, tracks.frame, time_s, is_seen, place, velocity)
    return rows.where(np.flatnonzero(is_known)), unit


def _with_gaps(values: F64, person: _Rows) -> F64:
    """The (N, 2) values of a person's rows with a row of NaN where frames are missing or a track ends, so that no line
    bridges it."""
    is_missing = np.diff(person.frame) > 2 * frame_step(person.frame)
    has_ended = np.diff(person.track) != 0
    return np.insert(values, np.flatnonzero(is_missing | has_ended) + 1, np.nan, axis=0)


def _floor_axes(axes: Axes, unit: str) -> Axes:
    axes.set_aspect("equal", adjustable="datalim" if unit == "px" else "box")
    axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    if unit == "px" and not axes.yaxis_inverted():
        axes.invert_yaxis()
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
