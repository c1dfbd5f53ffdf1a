"""Pictures of a run as PNG bytes (matplotlib without a display)."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from calib.types import F64, I64
from planview.trajectories.table import Trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (
    "#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#e377c2", "#8c564b", "#bcbd22", "#4c4c4c",
)  # fmt: skip
"""Of rules and configurations, in turn; people have colours of their own."""
_DPI = 110


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
    figure.savefig(buffer, format="png", dpi=_DPI, transparent=True)
    return buffer.getvalue()
