"""Pictures of a run as PNG bytes: the floor as in videos, curves and bars by matplotlib without a display."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from itertools import takewhile
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from calib.images import encode_image
from calib.types import F64, I64, Bool
from planview.drawing.people import facing_line, paint_facing
from planview.drawing.plan import PlanPainter
from planview.drawing.style import ERRORS, TRUTH, Labels, as_bgr, as_hex
from planview.evaluation.significant import SignificantError
from planview.maps.recording import is_maps
from planview.output.run_folder import RunFolder
from planview.trajectories.clock import Clock
from planview.trajectories.plot import person_hex, person_rgb
from planview.trajectories.table import Trajectories, row_states

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLOURS = (
    "#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#e377c2", "#8c564b", "#bcbd22", "#4c4c4c",
)  # fmt: skip
"""Of rules and configurations, in turn; people have colours of their own."""


class Picture(NamedTuple):
    """A picture as a data URI; ``keep_colours``: its colours are a scale, which dark pages do not turn around;
    ``is_strip``: several frames side by side."""

    title: str
    data: str
    note: str = ""
    keep_colours: bool = False
    is_strip: bool = False


def picture(
    title: str, data: bytes, note: str = "", *, keep_colours: bool = False, is_strip: bool = False, kind: str = "png"
) -> Picture:
    """A PNG or JPEG (``kind`` "jpeg") for a page."""
    uri = f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
    return Picture(title, uri, note, keep_colours, is_strip)


def people_plot(tracks: Trajectories, times_s: F64, frames: I64) -> bytes:
    """Confirmed people, and those only predicted, over the (N,) times [s] of (N,) frames."""
    figure, axes = new_figure(7.0, 2.4)
    shades = ((("confirmed", "lost"), "#c9d6ea", "only predicted"), (("confirmed",), "#1f4e9c", "observed"))
    for states, colour, label in shades:
        rows = tracks.frame[np.isin(tracks.state, states)]
        count = np.searchsorted(rows, frames, side="right") - np.searchsorted(rows, frames)
        axes.fill_between(times_s, count, step="post", color=colour, label=label, linewidth=0)
    _count_axes(axes, "people")
    return png_bytes(figure)


def steps_plot(series: Mapping[str, Sequence[tuple[float, int]]], end_s: float, label: str) -> bytes:
    """Whole numbers over time; ``series``: (time [s], number from then on) by name."""
    figure, axes = new_figure(7.0, 2.6)
    for place, (name, changes) in enumerate(series.items()):
        times, numbers = zip(*changes, (max(end_s, changes[-1][0]), changes[-1][1]), strict=True)
        axes.step(times, numbers, where="post", color=COLOURS[place % len(COLOURS)], label=plain_text(name))
    _count_axes(axes, label)
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

    axes.set(ylim=(0, 1.1 * max(1.0, axes.get_ylim()[1])), xlabel="time [s]", ylabel=label)
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


WIDTH_PX = 900
HEIGHTS_PX = (450, 1150)
"""Size of a floor, its height as the floor's shape asks [px]."""
HEAT_CELL_M = 0.2
"""Side of a heat map's cell: about a footstep's uncertainty [m]."""
HEAT_RANGE = 300.0
"""The scale of the heat map spans this factor: who stands for a minute does not hide who walks by."""


def placed(table: Trajectories) -> Trajectories:
    """The rows with positions, without tentative ones, by person, then frame."""
    rows = np.flatnonzero((table.state != "tentative") & np.isfinite(table.x_m) & np.isfinite(table.y_m))
    return table.where(rows[np.lexsort((table.frame[rows], table.track_id[rows]))])


def _ways(rows: Trajectories) -> list[slice]:
    """Rows of one person in frames that follow each other, all observed or all predicted, of rows by person, then
    frame. A way begins with the last row of the one before, where that leads to it."""
    first, last = stretches(rows.track_id, rows.frame, np.asarray(rows.state == "lost"))
    follows = (np.diff(rows.track_id, prepend=-1) == 0) & (np.diff(rows.frame, prepend=-1) == 1)
    return list(map(slice, first - follows[first], last + 1))


def stretches(person: I64, frame: I64, value: I64 | Bool) -> tuple[I64, I64]:
    """The first and the last row of each stretch of one person with one value in frames that follow each other; of (N,)
    rows by person, then frame."""
    cuts = np.flatnonzero((np.diff(person) != 0) | (np.diff(frame) != 1) | (np.diff(value) != 0)) + 1
    return np.append(0, cuts)[: len(person)], np.append(cuts, len(person))[: len(person)] - 1


def floor_plot(run: RunFolder) -> bytes:
    """Tracks on the floor, thin where lost, with arrows where people face, over the truth in black, with the cameras,
    their views, and the rules."""
    painter = _painter(run)
    tracks = placed(run.tracks)
    truth = placed(run.truth) if run.truth is not None else None
    picture = painter.paper.copy()
    for rows in (tracks,) if truth is None else (truth, tracks):
        at = painter.px(np.column_stack([rows.x_m, rows.y_m]))
        for way in _ways(rows):
            colour = TRUTH if rows is truth else person_rgb(int(rows.track_id[way.stop - 1]))
            width = 1 if rows is truth or rows.state[way.stop - 1] == "lost" else 2
            cv2.polylines(picture, [at[way]], False, as_bgr(colour), width, cv2.LINE_AA)
    # Where people face, every two seconds.
    step = max(1, round(2.0 / run.clock.frame_s))
    for person in row_states(tracks.where(tracks.frame % step == 0), slice(None)):
        if (line := facing_line(person)) is not None:
            paint_facing(picture, person, painter.px(line), as_bgr(person_rgb(person.track_id)), 1)
    # A dot where each track begins, a square where it ends.
    ids, first, counts = np.unique(tracks.track_id, return_index=True, return_counts=True)
    begin = at[first]
    end = at[first + counts - 1]
    for track_id, dot, square in zip(ids.tolist(), begin, end, strict=True):
        colour = as_bgr(person_rgb(track_id))
        cv2.circle(picture, dot.tolist(), 4, colour, -1, cv2.LINE_AA)
        cv2.rectangle(picture, (square - 3).tolist(), (square + 3).tolist(), colour, -1)
    # Tracks with their ids in the picture, the longest ones; with more the ids would cover the ways.
    labels = Labels(picture)
    for i in np.argsort(-counts, kind="stable")[:40].tolist():
        labels.put(str(ids[i]), (begin[i] + (5, -5)).tolist(), person_rgb(int(ids[i])))
    return encode_image(picture, ".png")


def _painter(run: RunFolder) -> PlanPainter:
    bounds = run.bounds()
    shape = (bounds.y_max_m - bounds.y_min_m) / (bounds.x_max_m - bounds.x_min_m)
    size = WIDTH_PX, int(np.clip(WIDTH_PX * shape, *HEIGHTS_PX))
    return PlanPainter(bounds, size, run.cameras, run.rules)


def heat_plot(xy_m: F64, run: RunFolder) -> tuple[bytes, float]:
    """Where people spent their time, by (N, 2) places [m] of a frame each, smoothed by a cell; and the longest time in
    a cell [s]."""
    painter = _painter(run)
    height, width = painter.paper.shape[:2]
    side_px = max(1.0, HEAT_CELL_M * painter.scale)
    at = painter.px(xy_m)
    edges = [np.arange(0.0, size + side_px, side_px) for size in (height, width)]
    cells = run.clock.frame_s * np.histogram2d(at[:, 1], at[:, 0], edges)[0]
    seconds = cv2.GaussianBlur(cells, (0, 0), 0.7)
    share = np.log(np.maximum(seconds / max(float(seconds.max()), 1e-9) * HEAT_RANGE, 1e-9)) / np.log(HEAT_RANGE)
    colours = cv2.applyColorMap(np.clip(share * 255, 0, 255).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    rows, cols = ((np.arange(size) / side_px).astype(np.int64) for size in (height, width))
    of_pixel = rows[:, None], cols
    picture = np.where((share >= 0)[of_pixel][..., None], colours[of_pixel], painter.paper)
    return encode_image(picture, ".png"), float(cells.max())


TEMPLATES_MAX = 12
"""People whose templates are shown, the first ones."""


def template_plot(run: RunFolder) -> bytes | None:
    """T_H (above) and T_O of people in the middle of their tracks; None without the plan-view maps of the run."""
    maps = next((path for path in (run.path / "maps.h5", run.tracked) if path is not None and is_maps(path)), None)
    rows = [np.flatnonzero(run.of_people & (run.tracks.track_id == person)) for person in run.people[:TEMPLATES_MAX]]
    if maps is None or not rows:
        return None
    from matplotlib.figure import Figure

    from planview.engine.open import open_engine

    # Only the maps are of use: the template tracker is the one that costs little.
    engine = open_engine(maps, "template")
    middle = run.tracks.where(np.array([mine[len(mine) // 2] for mine in rows]))
    figure = Figure(figsize=(0.75 * len(rows) + 0.3, 1.9), layout="constrained")
    axes = figure.subplots(2, len(rows), squeeze=False)
    for frame in takewhile(lambda frame: frame.index <= middle.frame.max(), engine.recording):
        here = np.flatnonzero(middle.frame == frame.index).tolist()
        if here and (shown := engine.step(frame).observation.maps) is not None:
            for i in here:
                axes[0, i].set_title(f"{middle.track_id[i]}", fontsize=8)
                height, occupancy = shown.around(middle.x_m[i], middle.y_m[i])
                axes[0, i].imshow(height, origin="lower", vmin=0.0, vmax=2.0)
                axes[1, i].imshow(occupancy, origin="lower")
    for axis in axes.flat:
        axis.set_axis_off()
    return png_bytes(figure)


UNHELD = -1
"""In place of a track's id: no track."""
ROWS_MAX = 60
"""Rows of a picture, those of the people seen longest."""


def identity_pictures(run: RunFolder, errors: Sequence[SignificantError]) -> list[Picture]:
    """A row per track, then a row per true person, with a triangle for each error."""
    shown = run.tracks.where(run.tracks.state != "tentative")
    truth = run.truth
    if not len(shown):
        return []
    marks = [(error.track_id, error) for error in errors if error.truth_id is None]
    png = _bars(shown, shown.track_id, shown.state == "lost", run.clock, marks, "")
    note = "A row per track, thin where only predicted."
    found = [picture("Identities over time", png, note, keep_colours=True)]
    if truth is not None and len(truth):
        marks = [(error.truth_id, error) for error in errors if error.truth_id is not None]
        png = _bars(truth, held_by(run.tracks, truth), np.zeros(len(truth), np.bool_), run.clock, marks, "P")
        note = "A row per true person in the colour of the track that holds the person, grey where none does. A change "
        note += "of colour is a change of identity; triangles are significant errors."
        found.append(picture("True people", png, note, keep_colours=True))
    return found


def held_by(tracks: Trajectories, truth: Trajectories) -> I64:
    """(N,) id of the confirmed track matched to every row of the truth, UNHELD where there is none."""
    from planview.evaluation.metrics import (
        build_sequence,
        clear_scores,  # brings scipy
        floor_similarity,
    )

    claimed = tracks.where((tracks.state == "confirmed") & np.isfinite(tracks.x_m))
    matches = clear_scores(build_sequence(truth, claimed, floor_similarity(0.5))).matches
    holder = np.full(len(truth), UNHELD, dtype=np.int64)
    holder[matches[:, 0]] = claimed.track_id[matches[:, 1]]
    return holder


def _bars(
    rows: Trajectories, track_id: I64, is_thin: Bool, clock: Clock,
    marks: Sequence[tuple[int | None, SignificantError]], prefix: str,
) -> bytes:  # fmt: skip
    """Bars over time by person, in the order of first frames, in the colours of the tracks of the (N,) rows, with a
    triangle per error in its person's row."""
    order = np.lexsort((rows.frame, rows.track_id))
    (person, frame, track), thin = (c[order] for c in (rows.track_id, rows.frame, track_id)), is_thin[order]
    people, start, counts = np.unique(person, return_index=True, return_counts=True)
    longest = np.argsort(-counts, kind="stable")[:ROWS_MAX]
    shown = people[longest][np.argsort(frame[start[longest]], kind="stable")].tolist()
    row_of = {one: row for row, one in enumerate(shown)}
    figure, axes = new_figure(12.0, 0.8 + 0.19 * len(shown))
    first, last = stretches(person, frame, 2 * track + thin)
    begin = clock.at(frame[first])
    end = clock.at(frame[last] + 1)
    for i, n in enumerate(first.tolist()):
        if (row := row_of.get(int(person[n]))) is not None:
            colour = "#c9ced8" if track[n] == UNHELD else person_hex(int(track[n]))
            axes.barh(row, end[i] - begin[i], 0.2 if thin[n] else 0.75, begin[i], color=colour)
    for kind, rgb in ERRORS.items():
        at = [(error.frame, row_of[p]) for p, error in marks if error.kind == kind and p in row_of]
        if at:
            at_frame, at_row = np.array(at).T
            label = kind.replace("_", " ")
            axes.plot(clock.at(at_frame), at_row - 0.35, "v", color=as_hex(rgb), markeredgecolor="white", label=label)
    axes.set_yticks(range(len(shown)), [f"{prefix}{one}" for one in shown], fontsize=8)
    axes.set_ylim(len(shown) - 0.3, -0.9)
    axes.set_xlabel("time [s]")
    axes.margins(x=0)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5, fontsize=8, frameon=False)
    return png_bytes(figure)
