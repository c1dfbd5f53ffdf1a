"""Pictures of a run as PNG bytes: the floor as in videos, curves by matplotlib without a display."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from calib.images import encode_image
from calib.types import F64, I64, Bool
from planview.drawing.plan import PlanPainter
from planview.drawing.style import TRUTH, Labels, as_bgr, person_rgb
from planview.output.run_folder import RunFolder
from planview.trajectories.table import Trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLOURS = (
    "#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#e377c2", "#8c564b", "#bcbd22", "#4c4c4c",
)  # fmt: skip
"""Of rules and configurations, in turn; people have colours of their own."""


class Picture(NamedTuple):
    """A PNG as a data URI; ``keep_colours``: its colours are a scale, which dark pages do not turn around."""

    title: str
    data: str
    note: str = ""
    keep_colours: bool = False


def picture(title: str, png: bytes, note: str = "", *, keep_colours: bool = False) -> Picture:
    """A PNG for a page."""
    return Picture(title, "data:image/png;base64," + base64.b64encode(png).decode("ascii"), note, keep_colours)


def people_plot(tracks: Trajectories, times_s: F64, frames: I64) -> bytes:
    """Confirmed people, and those only predicted, over the (N,) times [s] of (N,) frames."""
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


def steps_plot(series: Mapping[str, Sequence[tuple[float, int]]], end_s: float, label: str) -> bytes:
    """Whole numbers over time; ``series``: (time [s], number from then on) by name."""
    figure, axes = new_figure(7.0, 2.6)
    for place, (name, changes) in enumerate(series.items()):
        times, numbers = zip(*changes, strict=True)
        colour = COLOURS[place % len(COLOURS)]
        axes.step(
            [*times, max(end_s, times[-1])], [*numbers, numbers[-1]], where="post", color=colour, label=plain_text(name)
        )
    axes.set_ylim(0, 1.1 * max(1.0, axes.get_ylim()[1]))
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


WIDTH_PX, HEIGHTS_PX = 900, (450, 1150)
"""Size of a floor, its height as the floor's shape asks [px]."""
HEAT_CELL_M = 0.2
"""Side of a heat map's cell: about a footstep's uncertainty [m]."""
HEAT_RANGE = 300.0
"""The scale of the heat map spans this factor: who stands for a minute does not hide who walks by."""


class Places(NamedTuple):
    """Where people were, columns of equal length, by person then frame: (N, 2) places [m], and which are predicted."""

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

    def ways(self) -> list[slice]:
        """Rows of one person in frames that follow each other, all observed or all predicted.

        A way begins with the last row of the one before, where that leads to it.
        """
        if not len(self.frame):
            return []
        joined = (np.diff(self.track_id) == 0) & (np.diff(self.frame) == 1)
        starts = np.flatnonzero(~joined | (np.diff(self.is_lost) != 0)) + 1
        first = starts - joined[starts - 1]
        return list(map(slice, [0, *first], [*starts, len(self.frame)]))


def floor_plot(run: RunFolder) -> bytes:
    """Tracks on the floor, thin where lost, over the truth in black, with the cameras, their views, and the rules."""
    painter, tracks = _painter(run), Places.of(run.tracks)
    truth = Places.of(run.truth) if run.truth is not None else None
    picture = painter.paper.copy()
    for places in (tracks,) if truth is None else (truth, tracks):
        for way in places.ways():
            colour = TRUTH if places is truth else person_rgb(int(places.track_id[way.stop - 1]))
            width = 1 if places is truth or places.is_lost[way.stop - 1] else 2
            cv2.polylines(picture, [painter.px(places.xy_m[way])], False, as_bgr(colour), width, cv2.LINE_AA)
    # A dot where each track begins, a square where it ends.
    ids, first, counts = np.unique(tracks.track_id, return_index=True, return_counts=True)
    begin, end = painter.px(tracks.xy_m[first]), painter.px(tracks.xy_m[first + counts - 1])
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


class HeatMap(NamedTuple):
    """(n_rows, n_cols) time per cell [s], the side of a cell [m], and (x, y) of the first cell's outer corner [m]."""

    seconds: F64
    cell_m: float
    corner_m: F64


def heat_map(xy_m: F64, frame_s: float) -> HeatMap:
    """Time at (N, 2) places [m], at least one, of ``frame_s`` each; cells are coarser where they would be too many."""
    low, high = xy_m.min(axis=0), xy_m.max(axis=0)
    cell = max(HEAT_CELL_M, float(np.hypot(*(high - low))) / 1000)
    corner = (np.floor(low / cell) - 1) * cell
    edges = [
        start + cell * np.arange(np.ceil((stop - start) / cell) + 2) for start, stop in zip(corner, high, strict=True)
    ]
    return HeatMap(frame_s * np.histogram2d(xy_m[:, 1], xy_m[:, 0], edges[::-1])[0], cell, corner)


def heat_plot(xy_m: F64, run: RunFolder) -> bytes:
    """Where people spent their time, smoothed by a cell (arguments of ``heat_map``)."""
    painter, heat = _painter(run), heat_map(xy_m, run.clock.frame_s)
    seconds = cv2.GaussianBlur(heat.seconds, (0, 0), 0.7)
    share = np.log(np.maximum(seconds / max(float(seconds.max()), 1e-9) * HEAT_RANGE, 1e-9)) / np.log(HEAT_RANGE)
    colours = cv2.applyColorMap(np.clip(share * 255, 0, 255).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    # From cells to pixels, where y points down.
    step, (left, bottom) = heat.cell_m * painter.scale, painter.px(heat.corner_m[None] + heat.cell_m / 2)[0]
    to_px = np.array([[step, 0, left], [0, -step, bottom]], dtype=np.float64)
    size = painter.paper.shape[1::-1]
    cells = np.dstack([colours, np.where(share >= 0, 255, 0).astype(np.uint8)])
    laid = cv2.warpAffine(cells, to_px, size, flags=cv2.INTER_NEAREST)
    return encode_image(np.where(laid[..., 3:] > 0, laid[..., :3], painter.paper), ".png")
