"""A self-contained page about a board calibration: errors, lens models, a rectified pair."""

from __future__ import annotations

import base64
import io
import math
from pathlib import Path

import cv2
import numpy as np

from calib.board.detect import SIDES
from calib.board.fit import rms
from calib.board.solve import FOLDS, BoardCalibration
from calib.images import as_colour, encode_image
from calib.io import write_whole
from calib.types import U8
from planview.calibration.board import BoardImages
from planview.drawing.style import page_of
from stereo.rectify import Rectifier, RectifyParams


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
        errors=base64.b64encode(_figure(result)).decode("ascii"),
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


def _figure(result: BoardCalibration) -> bytes:
    """PNG: the error of each view, and of each corner as an arrow where it was found."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8), dpi=110, layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=(1.0, 1.4))
    bars = figure.add_subplot(grid[0, :])
    place, (w, h) = np.arange(len(result.views)), result.rig.left.size
    for column, (side, colour) in enumerate(zip(SIDES, ("tab:blue", "tab:orange"), strict=True)):
        errors = result.fit.side_errors(side)
        bars.bar(place + 0.4 * column - 0.2, [rms([error]) for error in errors], 0.4, color=colour, label=side)
        axes = figure.add_subplot(grid[1, column])
        found = np.concatenate([view.image_points(side) for view in result.views])
        arrows = -60.0 * np.concatenate(errors)
        size = np.linalg.norm(arrows, axis=1)
        axes.quiver(*found.T, *arrows.T, size, angles="xy", scale_units="xy", scale=1, cmap="viridis", width=0.002)
        title = f"{side}: errors x 60, {100 * result.coverage_share(side):.0f} % of the image covered"
        axes.set(xlim=(-0.5, w - 0.5), ylim=(h - 0.5, -0.5), aspect="equal", title=title)
    bars.axhline(result.fit.rms_px, color="black", lw=0.8, ls="--", label="all")
    bars.set_xticks(place, [view.name.split()[0] for view in result.views], rotation=90, fontsize=7)
    bars.set(ylabel="rms error [px]", title="per view")
    bars.legend(loc="upper right")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
