"""Pictures of a run as PNG bytes, by matplotlib without a display."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from calib.types import I64, Bool
from planview.drawing.style import ERRORS, as_hex
from planview.evaluation.significant import SignificantError
from planview.output.plot import RUN_COLOURS, NamedTracks, Panel, figure_of, png_bytes
from planview.output.run_folder import RunFolder
from planview.trajectories.clock import Clock
from planview.trajectories.plot import INK, count_axes, person_hex, style_axes
from planview.trajectories.table import Trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Picture(NamedTuple):
    """A picture as a data URI; ``keep_colours``: its colours are a scale, which dark pages do not turn around;
    ``is_strip``: several frames side by side."""

    title: str
    data: str
    note: str = ""
    keep_colours: bool = False
    is_strip: bool = False


def picture(title: str, data: bytes, note: str = "", *, kind: str = "png", **looks: bool) -> Picture:
    """A PNG or JPEG (``kind`` "jpeg") for a page."""
    uri = f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
    return Picture(title, uri, note, **looks)


VIEW_COLOUR = "#e8eef7"


def plot_run(run: RunFolder, *panels: Panel) -> bytes:
    """The figure of ``planview plot`` with some panels; the floor with cameras, their views and rules, and curves over
    the whole recording."""
    figure = figure_of([NamedTracks("", run.tracks)], run.truth, panels=panels)
    for panel, axes in zip(panels, figure.axes, strict=False):
        if panel in ("speed", "count"):
            span = run.clock.span(run.n_frames)
            axes.set_xlim(span.start_s, span.end_s)
        elif np.isfinite(run.tracks.x_m).any():
            _draw_surroundings(axes, run)
    return png_bytes(figure)


def _draw_surroundings(axes: Axes, run: RunFolder) -> None:
    """Draw cameras, their views and rules on the floor, and limit it to what is of use."""
    for at_m, outline in run.cameras:
        axes.fill(*outline.T, color=VIEW_COLOUR, zorder=0)
        axes.plot(*at_m, "v", mfc="white", mec=INK)
    for rule in run.rules:
        if rule.on_floor:
            outline = rule.points if rule.is_line else np.vstack([rule.points, rule.points[:1]])
            colour = as_hex(rule.colour)
            axes.plot(*outline.T, color=colour, lw=1.2)
            axes.annotate(plain_text(rule.name), outline[0], color=colour, fontsize=8)
    bounds = run.bounds()
    axes.set_xlim(bounds.x_min_m, bounds.x_max_m)
    axes.set_ylim(bounds.y_min_m, bounds.y_max_m)


def plot_steps(series: Mapping[str, Sequence[tuple[float, int]]], end_s: float, label: str) -> bytes:
    """Whole numbers over time; ``series``: (time [s], number from then on) by name."""
    figure, axes = new_figure(7.0, 2.6)
    for n, (name, changes) in enumerate(series.items()):
        times_s, numbers = zip(*changes, strict=True)
        last_s = max(end_s, times_s[-1])
        colour = RUN_COLOURS[n % len(RUN_COLOURS)]
        axes.step([*times_s, last_s], [*numbers, numbers[-1]], where="post", color=colour, label=plain_text(name))
    count_axes(axes, label)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize=8, frameon=False)
    return png_bytes(figure)


def new_figure(width: float, height: float) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, style_axes(figure.subplots())


def plain_text(text: str) -> str:
    """Text that matplotlib does not parse as a formula, without characters that its font has no picture of."""
    return "".join(c for c in text if c.isprintable() and ord(c) < 0x2000).replace("$", r"\$")


UNHELD = -1
"""In place of a track's id: no track."""
UNHELD_COLOUR = "#c9ced8"
ROWS_MAX = 60
"""Rows of a picture, those of the people seen longest."""


def identity_pictures(run: RunFolder, errors: Sequence[SignificantError]) -> list[Picture]:
    """A row per track, then a row per true person, with a triangle for each error."""
    is_person = np.isin(run.tracks.track_id, run.people)
    shown = run.tracks.where(is_person & (run.tracks.state != "tentative"))
    truth = run.truth
    if not len(shown):
        return []
    of_tracks = [(error.track_id, error) for error in errors if error.truth_id is None]
    png = _plot_bars(shown, shown.track_id, shown.state == "lost", run.clock, of_tracks, "")
    note = "A row per person, thin where only predicted."
    pictures = [picture("Identities over time", png, note, keep_colours=True)]
    if truth is not None and len(truth):
        of_people = [(error.truth_id, error) for error in errors if error.truth_id is not None]
        is_thin = np.zeros(len(truth), np.bool_)
        png = _plot_bars(truth, held_by(run.tracks, truth), is_thin, run.clock, of_people, "P")
        note = "A row per true person in the colour of the track that holds the person, grey where none does. A change "
        note += "of colour is a change of identity; triangles are significant errors."
        pictures.append(picture("True people", png, note, keep_colours=True))
    return pictures


def held_by(tracks: Trajectories, truth: Trajectories) -> I64:
    """(N,) id of the confirmed track matched to every row of the truth, UNHELD where there is none."""
    from planview.evaluation.metrics import (
        build_sequence,
        clear_scores,  # brings scipy
        floor_similarity,
    )

    confirmed = tracks.where((tracks.state == "confirmed") & np.isfinite(tracks.x_m))
    matches = clear_scores(build_sequence(truth, confirmed, floor_similarity(0.5))).matches
    holder = np.full(len(truth), UNHELD, dtype=np.int64)
    holder[matches[:, 0]] = confirmed.track_id[matches[:, 1]]
    return holder


def _plot_bars(
    rows: Trajectories, track_id: I64, is_thin: Bool, clock: Clock,
    marks: Sequence[tuple[int | None, SignificantError]], prefix: str,
) -> bytes:  # fmt: skip
    """Bars over time by person, in the order of first frames, in the colours of the tracks of the (N,) rows, with a
    triangle per error in its person's row."""
    order = np.lexsort((rows.frame, rows.track_id))
    person = rows.track_id[order]
    frame = rows.frame[order]
    track = track_id[order]
    thin = is_thin[order]
    bar_of = _bar_of_person(person, frame)
    figure, axes = new_figure(12.0, 0.8 + 0.19 * len(bar_of))
    # A bar ends with the person, where frames are missing, and where track or state change.
    is_new = (np.diff(person) != 0) | (np.diff(frame) != 1) | (np.diff(track) != 0) | np.diff(thin)
    for stretch in np.split(np.arange(len(person)), np.flatnonzero(is_new) + 1):
        first = stretch[0]
        bar = bar_of.get(int(person[first]))
        if bar is None:
            continue
        begin_s, end_s = clock.at(np.array([frame[first], frame[stretch[-1]] + 1]))
        colour = UNHELD_COLOUR if track[first] == UNHELD else person_hex(int(track[first]))
        axes.barh(bar, end_s - begin_s, 0.2 if thin[first] else 0.75, begin_s, color=colour)
    for kind, rgb in ERRORS.items():
        shown = [(bar_of[who], error.frame) for who, error in marks if error.kind == kind and who in bar_of]
        if shown:
            bars, frames = np.array(shown, dtype=np.int64).T
            label = kind.replace("_", " ")
            axes.plot(clock.at(frames), bars - 0.35, "v", color=as_hex(rgb), markeredgecolor="white", label=label)
    axes.set_yticks(range(len(bar_of)), [f"{prefix}{one}" for one in bar_of], fontsize=8)
    axes.set_ylim(len(bar_of) - 0.3, -0.9)
    axes.set_xlabel("time [s]")
    axes.margins(x=0)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5, fontsize=8, frameon=False)
    return png_bytes(figure)


def _bar_of_person(person: I64, frame: I64) -> dict[int, int]:
    """The number of the bar of the people with most rows, in the order of first frames; rows are by person, then
    frame."""
    people, start, counts = np.unique(person, return_index=True, return_counts=True)
    longest = np.argsort(-counts, kind="stable")[:ROWS_MAX]
    by_first_frame = longest[np.argsort(frame[start[longest]], kind="stable")]
    return {one: bar for bar, one in enumerate(people[by_first_frame].tolist())}
