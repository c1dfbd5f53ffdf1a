"""``planview calibrate board``: a stereo rig from images of a chessboard or ChArUco board."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from cyclopts import Parameter
from rich.progress import Progress
from rich.table import Table

from calib.board.pattern import parse_board, parse_square
from calib.board.solve import BoardCalibration
from calib.errors import InputError
from calib.formats import write_rig
from planview.calibration.board import BoardRequest, calibrate_images
from planview.calibration.board_report import write_report
from planview.commands.options import JsonFlag
from planview.output.progress import PlainConsole


@Parameter(name="*")
@dataclass(frozen=True)
class BoardOptions:
    """What is known of the board and the lens, and where results go."""

    out: Path = Path("rig.toml")
    """Rig to write."""
    board: str | None = None
    """Inner corners of a chessboard, 9x6, found by itself when not given (give it for small or blurred images); or
    charuco:8x6, the squares of a ChArUco board."""
    marker: str | None = None
    """Side of a ChArUco marker, e.g. 18mm; usual sizes are tried when not given."""
    dictionary: str | None = None
    """ArUco dictionary, e.g. DICT_4X4_50; all are tried when not given."""
    model: Literal["auto", "brown", "rational", "fisheye"] = "auto"
    """Lens model; auto judges them on views left out of the fit."""
    json_: JsonFlag = False
    """Print one JSON object on stdout."""


def calibrate_board(images: Path, /, *, square: str, options: BoardOptions | None = None) -> None:
    """Calibrate a stereo rig from chessboard or ChArUco images.

    Writes the rig (OUT), the same for OpenCV (.yml) and a report page (.html) beside it.

    Example: planview calibrate board photos/ --square 24.23mm --out rig.toml

    Parameters
    ----------
    images
        Folder with left/ and right/, with names that tell left from right, with images side by side, or a video.
    square
        Side of a square with its unit, e.g. 24.23mm; a bare number is refused. When it is not known, give any size: the
        baseline is also told in squares, but distances measured with the rig are as wrong as the size.
    """
    options = options or BoardOptions()
    square_m = parse_square(square)
    request = BoardRequest(
        parse_board(options.board, square_m, options.marker, options.dictionary),
        square_m,
        any_dictionary=options.dictionary is None,
        any_marker=options.marker is None,
        model=None if options.model == "auto" else options.model,
    )
    if options.out.suffix.lower() != ".toml":
        raise InputError(f"--out: expected a name that ends in .toml, found {options.out.name!r}")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    result = _calibrate(images, request)
    files = [
        *write_rig(result.rig, options.out, "rig"),
        *write_rig(result.rig, options.out.with_suffix(".yml"), "opencv"),
    ]
    files.append(write_report(result, images, options.out.with_suffix(".html")))
    _print_summary(result, files)
    if options.json_:
        print(json.dumps(_as_json(result, files)))


def _calibrate(images: Path, request: BoardRequest) -> BoardCalibration:
    console = PlainConsole(stderr=True)
    with Progress(console=console, transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("detecting the board", total=None)

        def progress(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)
            if done == total:
                bar.update(task, description="calibrating")

        return calibrate_images(images, request, progress)


def _print_summary(result: BoardCalibration, files: list[Path]) -> None:
    console = PlainConsole(stderr=True)
    rig, std = result.rig, result.std
    for one in result.rejected:
        console.print(f"not used: {one.name}: {one.why}", highlight=False)
    table = Table(title=f"{result.board.name}, {len(result.views)} pairs, {rig.left.width}x{rig.left.height}")
    for column in ("", "left", "right"):
        table.add_column(column)
    for key in ("fx", "fy", "cx", "cy"):
        cells = [f"{getattr(getattr(rig, s), key):.2f} ± {std[f'{s} {key}']:.2f} px" for s in ("left", "right")]
        table.add_row(key, *cells)
    table.add_row("image covered", *(f"{100 * result.coverage_share(s):.0f} %" for s in ("left", "right")))
    console.print(table)
    for lens in result.lenses:
        chosen = "  <- chosen" if lens is result.chosen_lens else ""
        folds = ", turns back inside the image" if lens.folds_back else ""
        console.print(f"{lens.name}: {lens.held_out_px:.4f} px on views left out{folds}{chosen}", highlight=False)
    console.print(
        f"baseline {1000 * rig.baseline_m:.2f} ± {1000 * std['baseline']:.2f} mm "
        f"({result.baseline_squares:.3f} squares), stereo rms {result.fit.rms_px:.3f} px, "
        f"rows after rectification {result.row_rms_px:.3f} px",
        highlight=False,
    )
    console.print(f"wrote {', '.join(map(str, files))}", highlight=False, soft_wrap=True)


def _as_json(result: BoardCalibration, files: list[Path]) -> dict[str, Any]:
    return {
        "stereo_rms_px": result.fit.rms_px,
        "baseline_m": result.rig.baseline_m,
        "baseline_squares": result.baseline_squares,
        "baseline_std_m": result.std["baseline"],
        "views_used": len(result.views),
        "views_rejected": [{"name": one.name, "why": one.why} for one in result.rejected],
        "row_rms_px": result.row_rms_px,
        "board": result.board.name,
        "model": result.rig.left.model,
        "lenses": [
            {"name": one.name, "held_out_px": one.held_out_px, "folds_back": one.folds_back} for one in result.lenses
        ],
        "views": {v.name: float(r) for v, r in zip(result.views, result.fit.view_rms_px(), strict=True)},
        "std": result.std,
        "coverage": {side: result.coverage_share(side) for side in ("left", "right")},
        "files": [str(path) for path in files],
    }
