"""Who is there when: pictures of bars over time, and a row of figures per person."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from calib.types import F64, I64
from planview.counting.totals import Clock
from planview.drawing.style import ERRORS, as_hex, person_hex
from planview.evaluation.significant import SignificantError
from planview.output.report import plots
from planview.output.report.plots import Picture
from planview.output.run_folder import RunFolder
from planview.trajectories.table import Trajectories


def people_rows(tracks: Trajectories, clock: Clock, ids: I64) -> list[dict[str, Any]]:
    """Of confirmed people, (P,) ids ascending: times [s], way [m], mean speed [m/s], median height [m]; empty where
    unknown."""
    rows = np.flatnonzero((tracks.state == "confirmed") & np.isin(tracks.track_id, ids))
    rows = rows[np.argsort(tracks.track_id[rows], kind="stable")]
    cuts = np.searchsorted(tracks.track_id[rows], ids[1:])
    return [_row(tracks.where(mine), clock) for mine in np.split(rows, cuts) if len(mine)]


def _row(person: Trajectories, clock: Clock) -> dict[str, Any]:
    when = clock.at(person.frame)
    # From places half a second apart, so that noise does not add up (our choice).
    picked = np.concatenate([[True], np.diff(np.floor((when - when[0]) / 0.5)) > 0])
    way = float(np.hypot(np.diff(person.x_m[picked]), np.diff(person.y_m[picked])).sum())
    span = float(when[-1] - when[0])
    known = person.height_m[np.isfinite(person.height_m)]
    return {
        "track_id": int(person.track_id[0]),
        "first": f"{when[0]:.1f}",
        "last": f"{when[-1]:.1f}",
        "observed": f"{len(person) * clock.frame_s:.1f}",
        "way": f"{way:.1f}" if np.isfinite(way) else "",
        "speed": f"{way / span:.2f}" if span > 0 and np.isfinite(way) else "",
        "height": f"{np.median(known):.2f}" if len(known) else "",
    }


UNHELD = -1
"""In place of a track's id: no track."""
ROWS_MAX = 60
"""Rows of a picture, those of the people seen longest."""


class Stretches(NamedTuple):
    """Runs of rows of one person with one value in consecutive frames, columns of equal length."""

    person: I64
    value: I64
    first: I64
    last: I64


def stretches(person: I64, frame: I64, value: I64) -> Stretches:
    """Stretches by person, then time, of (N,) rows, each (person, frame) once."""
    order = np.lexsort((frame, person))
    p, f, v = person[order], frame[order], value[order]
    new = np.ones(len(p), dtype=np.bool_)
    new[1:] = (np.diff(p) != 0) | (np.diff(f) != 1) | (np.diff(v) != 0)
    starts = np.flatnonzero(new)
    stops = np.append(starts[1:], len(p)) - 1
    return Stretches(p[starts], v[starts], f[starts], f[stops[: len(starts)]])


def identity_pictures(run: RunFolder, errors: Sequence[SignificantError]) -> list[Picture]:
    """A row per track, then a row per true person, with a triangle for each error."""
    shown, truth = run.tracks.where(run.tracks.state != "tentative"), run.truth
    if not len(shown):
        return []
    found = stretches(shown.track_id, shown.frame, (shown.state == "lost").astype(np.int64))
    colours = [person_hex(person) for person in found.person.tolist()]
    marks = [(error.track_id, error) for error in errors if error.truth_id is None]
    png = _bars(found, colours, np.where(found.value == 1, 0.2, 0.75), run.clock, marks, "")
    note = "A row per track, thin where only predicted."
    pictures = [plots.picture("Identities over time", png, note, keep_colours=True)]
    if truth is not None and len(truth):
        found = stretches(truth.track_id, truth.frame, held_by(run.tracks, truth))
        colours = ["#c9ced8" if track == UNHELD else person_hex(track) for track in found.value.tolist()]
        marks = [(error.truth_id, error) for error in errors if error.truth_id is not None]
        png = _bars(found, colours, np.full(len(colours), 0.75), run.clock, marks, "P")
        note = "A row per true person in the colour of the track that holds the person, grey where none does. A change "
        note += "of colour is a change of identity; triangles are significant errors."
        pictures.append(plots.picture("True people", png, note, keep_colours=True))
    return pictures


def held_by(tracks: Trajectories, truth: Trajectories) -> I64:
    """(N,) id of the confirmed track matched to every row of the truth, UNHELD where there is none."""
    from planview.evaluation.metrics import clear_scores  # brings scipy
    from planview.evaluation.sequence import build_sequence, floor_similarity

    claimed = tracks.where((tracks.state == "confirmed") & np.isfinite(tracks.x_m))
    matches = clear_scores(build_sequence(truth, claimed, floor_similarity(0.5))).matches
    holder = np.full(len(truth), UNHELD, dtype=np.int64)
    holder[matches[:, 0]] = claimed.track_id[matches[:, 1]]
    return holder


def _bars(
    found: Stretches,
    colours: Sequence[str],
    heights: F64,
    clock: Clock,
    marks: Sequence[tuple[int | None, SignificantError]],
    prefix: str,
) -> bytes:
    """Bars over time by person, in the order of first frames, with a triangle per error in its person's row."""
    people, first = np.unique(found.person, return_index=True)
    frames = np.bincount(np.searchsorted(people, found.person), found.last - found.first + 1, len(people))
    longest = np.argsort(-frames, kind="stable")[:ROWS_MAX]
    shown = people[longest][np.argsort(found.first[first[longest]], kind="stable")].tolist()
    row_of = {person: row for row, person in enumerate(shown)}
    figure, axes = plots.new_figure(12.0, 0.8 + 0.19 * len(shown))
    begin, end = clock.at(found.first), clock.at(found.last + 1)
    for i in np.flatnonzero(np.isin(found.person, shown)).tolist():
        row, width_s = row_of[int(found.person[i])], end[i] - begin[i]
        axes.barh(row, width_s, heights[i], begin[i], color=colours[i])
    for kind, rgb in ERRORS.items():
        at = [(error.frame, row_of[p]) for p, error in marks if error.kind == kind and p in row_of]
        if at:
            at_frame, rows = np.array(at).T
            label = kind.replace("_", " ")
            axes.plot(clock.at(at_frame), rows - 0.35, "v", color=as_hex(rgb), markeredgecolor="white", label=label)
    axes.set_yticks(range(len(shown)), [f"{prefix}{person}" for person in shown], fontsize=8)
    axes.set_ylim(len(shown) - 0.3, -0.9)
    axes.set_xlabel("time [s]")
    axes.margins(x=0)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5, fontsize=8, frameon=False)
    return plots.png_bytes(figure)
