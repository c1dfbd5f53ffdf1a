"""A self-contained page about a board calibration: errors, coverage, lens models, a rectified pair."""

from __future__ import annotations

import base64
import io
import math
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from calib.board.detect import SIDES
from calib.board.fit import rms
from calib.board.solve import FOLDS, BoardCalibration
from calib.images import as_colour, encode_image
from calib.io import write_whole
from calib.types import F64, U8
from planview.calibration.board import BoardImages
from planview.drawing.style import page_of
from stereo.rectify import Rectifier, RectifyParams

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def write_report(result: BoardCalibration, images: Path, path: Path) -> Path:
    """Write the page and return its path; one of the pairs in ``images`` is read again and shown rectified."""
    name, picture = _rectified_pair(result, images)
    page = page_of(
        "planview.calibration",
        "board_report.html.j2",
        source=images.name or str(images),
        board=result.board.name,
        size=f"{result.rig.left.width}x{result.rig.left.height}",
        figures=[
            ("stereo rms", f"{result.fit.rms_px:.3f} px"),
            ("rows after rectification, rms", f"{result.row_rms_px:.3f} px"),
            ("baseline", f"{1000 * result.rig.baseline_m:.2f} ± {1000 * result.std['baseline']:.2f} mm"),
            ("baseline in squares", f"{result.baseline_squares:.3f}"),
            ("between the cameras", f"{math.degrees(result.rig.right_SE3_left.angle_rad):.2f}°"),
            ("pairs used", f"{len(result.views)} of {len(result.views) + len(result.rejected)}"),
            ("lens", result.rig.left.model),
        ],
        pair_name=name,
        rectified=base64.b64encode(encode_image(picture)).decode("ascii"),
        errors=_png(_error_figure(result)),
        coverage=_png(_coverage_figure(result)),
        rejected=result.rejected,
        lenses=result.lenses,
        chosen=result.chosen_lens,
        folds=min(FOLDS, len(result.views)),
        parameters=_parameters(result),
    )
    write_whole(path, page)
    return path


def _parameters(result: BoardCalibration) -> list[tuple[str, str, str]]:
    rows = []
    for name, value in result.parameters.items():
        if name.startswith("rotation"):
            scale, unit, digits = math.degrees(1), "°", 4
        elif name.startswith("translation") or name == "baseline":
            scale, unit, digits = 1000.0, " mm", 3
        else:
            scale, unit, digits = (1.0, " px", 3) if name.split()[1] in {"fx", "fy", "cx", "cy"} else (1.0, "", 6)
        shown, deviation = (f"{scale * one:.{digits}f}{unit}" for one in (value, result.std[name]))
        rows.append((name, shown, deviation))
    return rows


def _rectified_pair(result: BoardCalibration, images: Path) -> tuple[str, U8]:
    """The pair with the median error, rectified side by side with lines across both."""
    order = np.argsort(result.fit.view_rms_px())
    name = result.views[int(order[len(order) // 2])].name
    source = BoardImages(images)
    pair = next(source.at([source.names.index(name)]))
    if pair.left is None or pair.right is None:
        raise ValueError(f"expected {name} to be readable as before")
    rectified = Rectifier(result.rig, RectifyParams(working_px=720))(pair.left, pair.right)
    both = np.hstack([rectified.left_grey, rectified.right_grey])
    colour = as_colour(both)
    for row in np.linspace(0, colour.shape[0] - 1, 18 + 2).astype(int)[1:-1]:
        cv2.line(colour, (0, int(row)), (colour.shape[1] - 1, int(row)), (60, 200, 60), 1)
    return name, colour


def _error_figure(result: BoardCalibration) -> Figure:
    figure = _new_figure(11, 8.5)
    grid = figure.add_gridspec(2, 6, height_ratios=(1.0, 1.1))
    scatter, bars = figure.add_subplot(grid[0, :2]), figure.add_subplot(grid[0, 2:])
    place = np.arange(len(result.views))
    for side, colour, shift in zip(SIDES, ("tab:blue", "tab:orange"), (-0.2, 0.2), strict=True):
        errors = result.fit.side_errors(side)
        scatter.plot(*np.concatenate(errors).T, ".", ms=2.5, alpha=0.5, color=colour, label=side)
        bars.bar(place + shift, [rms([error]) for error in errors], 0.4, color=colour, label=side)
    reach = 1.1 * max(np.abs(error).max() for error in result.fit.errors)
    scatter.set(
        xlim=(-reach, reach), ylim=(reach, -reach), xlabel="x error [px]", ylabel="y error [px]", aspect="equal"
    )
    scatter.grid(alpha=0.3)
    scatter.legend(loc="upper right")
    bars.axhline(result.fit.rms_px, color="black", lw=0.8, ls="--", label="all")
    bars.set_xticks(place, [view.name.split()[0] for view in result.views], rotation=90, fontsize=7)
    bars.set(ylabel="rms error [px]", title="per view")
    bars.legend(loc="upper right")
    for column, side in zip((slice(0, 3), slice(3, 6)), SIDES, strict=True):
        axes = figure.add_subplot(grid[1, column])
        p = np.concatenate([view.image_points(side) for view in result.views])
        e = -60.0 * np.concatenate(result.fit.side_errors(side))
        axes.quiver(
            *p.T, *e.T, np.linalg.norm(e, axis=1), angles="xy", scale_units="xy", scale=1, cmap="viridis", width=0.002
        )
        _as_image(axes, result, f"{side}: errors x 60")
    return figure


def _coverage_figure(result: BoardCalibration) -> Figure:
    figure = _new_figure(11, 4.2)
    for axes, side in zip(figure.subplots(1, 2), SIDES, strict=True):
        counts: F64 = result.coverage(side)
        w, h = result.rig.left.size
        shown = np.where(counts > 0, counts, np.nan)
        axes.imshow(shown, extent=(-0.5, w - 0.5, h - 0.5, -0.5), cmap="YlGn", vmin=0)
        for view in result.views:
            axes.plot(*view.image_points(side).T, ".", ms=1.5, color="black", alpha=0.6)
        _as_image(axes, result, f"{side}: {100 * result.coverage_share(side):.0f} % covered")
    return figure


def _as_image(axes: Axes, result: BoardCalibration, title: str) -> None:
    w, h = result.rig.left.size
    axes.set(xlim=(-0.5, w - 0.5), ylim=(h - 0.5, -0.5), aspect="equal", title=title)


def _new_figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=110, layout="constrained")


def _png(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return base64.b64encode(buffer.getvalue()).decode("ascii")
