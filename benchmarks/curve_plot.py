"""The curves of ``python -m benchmarks speed`` as one picture for the documentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from calib.errors import InputError

_INK, _LINES = "#444", ("#2b6cb0", "#c05621")
WIDTH_IN, HEIGHT_IN = 9.0, 5.2


class Panel(NamedTuple):
    """One curve family: ``series`` holds by label how the names of its points begin; the place on the axis follows."""

    title: str
    axis: str
    series: Mapping[str, str]


ENGINE = "Whole engine over the yardstick"
PANELS = (
    Panel(ENGINE, "width of the images [px]", {"works at 640 px": "pixels_", "works at full size": "full_pixels_"}),
    Panel("After disparity over SGBM, 320x240", "people in view", {"": "people_"}),
    Panel(ENGINE, "disparities searched", {"": "disparities_"}),
    Panel(ENGINE, "frames per second", {"": "rate_"}),
)  # fmt: skip

Point = tuple[float, float, float, float]
"""Place on the axis, median, quartiles."""


def points_of(prefix: str, ratios: Mapping[str, float], quartiles: Mapping[str, tuple[float, float]]) -> list[Point]:
    """Of the curve whose points' names begin so, in the order of the axis."""
    names = [name for name in ratios if name.startswith(prefix)]
    points = [(_place(name[len(prefix) :]), ratios[name], *quartiles[name]) for name in names]
    return sorted((x, y, low, high) for x, y, low, high in points)


def _place(text: str) -> float:
    return float(text.split("x")[0].split("_")[0])


def write_plot(
    path: Path,
    ratios: Mapping[str, float],
    quartiles: Mapping[str, tuple[float, float]],
    memory: Sequence[tuple[int, float]] = (),
) -> None:
    """Draw all curves that were measured, with quartiles as bars, and the memory over frames, to a PNG or SVG file.

    Raises:
        InputError: no curve was measured.
    """
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt

    panels = [panel for panel in PANELS if any(points_of(p, ratios, quartiles) for p in panel.series.values())]
    if not panels and not memory:
        raise InputError(f"--plot: expected --part curves with it, found no curve for {path}")
    with mpl.rc_context({"font.size": 8, "svg.fonttype": "none", "svg.hashsalt": "planview"}):
        count = len(panels) + bool(memory)
        figure, grid = plt.subplots(-(-count // 3), min(count, 3), figsize=(WIDTH_IN, HEIGHT_IN), squeeze=False)
        axes = grid.ravel()
        for panel, one in zip(panels, axes, strict=False):
            _draw(panel, one, ratios, quartiles)
        if memory:
            _draw_memory(axes[len(panels)], memory)
        for unused in axes[count:]:
            unused.remove()
        figure.tight_layout()
        figure.savefig(path, dpi=90, metadata={"Date": None} if path.suffix == ".svg" else None)
        plt.close(figure)


def _draw(panel: Panel, axes: Any, ratios: Mapping[str, float], quartiles: Mapping[str, tuple[float, float]]) -> None:
    for (label, prefix), colour in zip(panel.series.items(), _LINES, strict=False):
        if points := points_of(prefix, ratios, quartiles):
            x, y, low, high = zip(*points, strict=True)
            bars = [[a - b for a, b in zip(y, low, strict=True)], [b - a for a, b in zip(y, high, strict=True)]]
            axes.errorbar(x, y, bars, color=colour, marker="o", markersize=3, linewidth=1, label=label or None)
    _dress(axes, panel.title, panel.axis)
    if any(panel.series):
        axes.legend(frameon=False)


def _draw_memory(axes: Any, memory: Sequence[tuple[int, float]]) -> None:
    frames, megabytes = zip(*memory, strict=True)
    axes.plot(frames, megabytes, color=_LINES[0], linewidth=1)
    _dress(axes, "Resident memory [MB]", "frames tracked")
    axes.set_ylim(top=1.2 * max(megabytes))


def _dress(axes: Any, title: str, axis: str) -> None:
    axes.set_title(title, color=_INK, fontsize=8)
    axes.set_xlabel(axis, color=_INK)
    axes.set_ylim(bottom=0)
    axes.set_xlim(left=0)
    axes.grid(alpha=0.3, linewidth=0.5)
    axes.spines[["top", "right"]].set_visible(False)
