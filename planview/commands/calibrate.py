"""``planview calibrate align``, ``board``, ``convert`` and ``ui``."""

from __future__ import annotations

import json
import math
import re
import socket
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter
from rich.progress import Progress
from rich.table import Table

from calib.board.detect import MARKER_SHARES, MAX_SQUARE_M, MIN_SQUARE_M, Board, dictionaries
from calib.board.solve import BoardCalibration
from calib.errors import InputError, WorkError
from calib.formats import WRITTEN, calibration_files, load_rig, write_rig
from calib.io import parse_length, parse_size
from calib.world import save_rigs
from planview.calibration.align import RigAlignment, align_records, record_rig, relative_to, rig_entries
from planview.calibration.board import BoardRequest, calibrate_images, write_report
from planview.commands.options import Flag, FrameRate, JsonFlag, OneSetting, Settings, in_range, say
from planview.engine.config import load_config
from planview.output.progress import PlainConsole


@Parameter(name="*")
@dataclass(frozen=True)
class AlignOptions:
    """Where the result is written, and how far clocks may be apart."""

    out: Path | None = None
    """rigs.toml to write, in a folder above all heads; that folder is then a recording of several heads."""
    clock: float = 10.0
    """Largest difference of the times at which the recordings begin [s]; a longer search takes longer."""
    fps: FrameRate = None
    config: Settings = None
    set_: OneSetting = ()
    json_output: JsonFlag = False


def calibrate_align(first: Path, second: Path, /, *others: Path, options: AlignOptions = AlignOptions()) -> None:
    """Find the relative pose of stereo heads from people who walk where both see them. No board, no markers.

    Every head is tracked by itself, above its own floor; heading, place and clock are those at which the people of one
    head meet those of the other. Let one to three people walk around for a minute, with turns, in the floor that the
    heads share: standing people, or one straight line, are not enough, and are refused.

    Example:
        planview calibrate align hall/north hall/south --out hall/rigs.toml
        planview run hall --out out

    Parameters
    ----------
    first
        Recording of the head whose world and clock become the common ones.
    second
        Recording of the next head.
    others
        Recordings of further heads; each must share floor with a head named before or after it.
    """
    heads = (first, second, *others)
    in_range("--clock", options.clock, 0, 3600, " s")
    if len({head.resolve() for head in heads}) < len(heads):
        raise InputError(f"expected every head once, found {', '.join(map(str, heads))}")
    if options.out is not None:
        for head in heads:
            relative_to(head, options.out.parent)
    config, records = load_config(options.config, options.set_), []
    for head in heads:
        with PlainConsole(stderr=True).status(f"tracking {head.name}"):
            records.append(record_rig(head, config, options.fps))
    alignments = align_records(records, options.clock)
    for record, alignment in zip(records[1:], alignments, strict=True):
        say(sentence(record.path.name, alignment))
    if options.out is not None:
        written = "found by planview calibrate align from people who walked"
        save_rigs(rig_entries(records, alignments, options.out.parent), options.out, written)
        say(f"wrote {options.out}")
    else:
        say("no rigs.toml written: --out FILE keeps the result")
    if options.json_output:
        print(json.dumps({"heads": [report(r.path, a) for r, a in zip(records[1:], alignments, strict=True)]}))


def sentence(name: str, a: RigAlignment) -> str:
    """One alignment with the deviation of each value."""
    return (
        f"{name}: heading {math.degrees(a.heading_rad):.2f} ± {math.degrees(a.heading_std_rad):.2f} degrees, "
        f"camera at x {a.x_m:.3f}, y {a.y_m:.3f} m (± {a.position_std_m:.3f} m where people met), "
        f"clock {a.clock_s:+.3f} ± {a.clock_std_s:.3f} s; people met for {a.shared_s:.0f} s, "
        f"{100 * a.residual_m:.1f} cm apart"
    )


def report(path: Path, a: RigAlignment) -> dict[str, Any]:
    """One alignment for ``--json``."""
    values = {name: getattr(a, name) for name in ("x_m", "y_m", "position_std_m", "residual_m", "shared_s")}
    heading = {"heading_deg": math.degrees(a.heading_rad), "heading_std_deg": math.degrees(a.heading_std_rad)}
    return {"head": str(path), **heading, **values, "start_s": a.clock_s, "start_std_s": a.clock_std_s}


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
    """Lens model; auto judges brown and fisheye on views left out of the fit."""
    json_: JsonFlag = False


def parse_square(text: str) -> float:
    """Side of a square [m]. Raises InputError: a bare number, which could be millimetres as well as metres, or what is
    no length at all."""
    if re.fullmatch(r"\s*\d+([.,]\d*)?\s*", text):
        raise InputError(
            f"--square: expected the side of a square with its unit, found {text!r} without one: "
            f"type --square {text.strip()}mm if these are millimetres"
        )
    return parse_length(text, "--square")


def parse_board(text: str | None, square_m: float, marker: str | None, dictionary: str | None) -> Board | None:
    """A board from what the user typed: ``9x6`` (inner corners) or ``charuco:8x6`` (squares), with the marker and the
    dictionary where they are known (``complete_charuco`` finds the others); None where the counts are to be found too.
    Raises InputError: text that describes no board."""
    if not MIN_SQUARE_M <= square_m <= MAX_SQUARE_M:
        raise InputError(
            f"--square: expected the side of one square, {1000 * MIN_SQUARE_M:g} mm to {100 * MAX_SQUARE_M:g} cm, "
            f"found {1000 * square_m:g} mm"
        )
    if text is None:
        if marker or dictionary:
            raise InputError("--marker, --dictionary: expected --board charuco:COLSxROWS with them, found no --board")
        return None
    match = re.fullmatch(r"\s*(charuco)?[\s:]*(\d{1,3})\s*[xX×]\s*(\d{1,3})\s*", text)
    if match is None:
        raise InputError(f"--board: expected 9x6 (inner corners) or charuco:8x6 (squares), found {text!r}")
    cols, rows = int(match[2]), int(match[3])
    try:
        if not match[1]:
            return Board(cols, rows, square_m)
        marker_m = parse_length(marker, "--marker") if marker else MARKER_SHARES[0] * square_m
        names = dictionaries()
        chosen = dictionary or next(iter(names))
        chosen = chosen if chosen.startswith("DICT_") else f"DICT_{chosen}"
        if chosen not in names:
            raise InputError(f"--dictionary: expected one of {', '.join(names)}, found {dictionary!r}")
        return Board(cols - 1, rows - 1, square_m, chosen, marker_m)
    except ValueError as error:
        raise InputError(f"--board: {error}") from error


def calibrate_board(images: Path, /, *, square: str, options: BoardOptions = BoardOptions()) -> None:
    """Calibrate a stereo rig from chessboard or ChArUco images.

    Writes the rig (OUT), the same for OpenCV (.yml) and a report page (.html) next to it.

    Example: planview calibrate board photos/ --square 24.23mm --out rig.toml

    Parameters
    ----------
    images
        Folder with left/ and right/, with names that distinguish left and right, with images side by side, or a video.
    square
        Side of a square with its unit, e.g. 24.23mm; a bare number is refused. When it is not known, give any size: the
        baseline is also printed in squares, but distances measured with the rig are as wrong as the size.
    """
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
    with Progress(console=PlainConsole(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("detecting the board", total=None)

        def progress(done: int, total: int) -> None:
            text = "calibrating" if done == total else "detecting the board"
            bar.update(task, completed=done, total=total, description=text)

        result = calibrate_images(images, request, progress)
    out = options.out
    files = [*write_rig(result.rig, out, "rig"), *write_rig(result.rig, out.with_suffix(".yml"), "opencv")]
    files.append(write_report(result, images, out.with_suffix(".html")))
    _print_summary(result)
    say(f"wrote {', '.join(map(str, files))}")
    if options.json_:
        print(json.dumps(_as_json(result, files)))


def _print_summary(result: BoardCalibration) -> None:
    rig, std = result.rig, result.std
    for one in result.rejected:
        say(f"not used: {one.name}: {one.why}")
    title = f"{result.board.name}, {len(result.views)} pairs, {rig.left.width}x{rig.left.height}"
    table = Table("", "left", "right", title=title)
    for key in ("fx", "fy", "cx", "cy"):
        cells = [f"{getattr(getattr(rig, s), key):.2f} ± {std[f'{s} {key}']:.2f} px" for s in ("left", "right")]
        table.add_row(key, *cells)
    table.add_row("image covered", *(f"{100 * result.coverage_share(s):.0f} %" for s in ("left", "right")))
    PlainConsole(stderr=True).print(table)
    for lens in result.lenses:
        chosen = "  <- chosen" if lens is result.chosen_lens else ""
        say(f"{lens.name}: {lens.held_out_px:.4f} px on views left out{chosen}")
    say(
        f"baseline {1000 * rig.baseline_m:.2f} ± {1000 * std['baseline']:.2f} mm "
        f"({result.baseline_squares:.3f} squares), stereo rms {result.fit.rms_px:.3f} px, "
        f"rows after rectification {result.row_rms_px:.3f} px"
    )


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
        "lenses": [{"name": one.name, "held_out_px": one.held_out_px} for one in result.lenses],
        "views": {v.name: float(r) for v, r in zip(result.views, result.fit.view_rms_px(), strict=True)},
        "std": result.std,
        "coverage": {side: result.coverage_share(side) for side in ("left", "right")},
        "files": [str(path) for path in files],
    }


def calibrate_convert(
    source: Annotated[Path, Parameter(name="IN")],
    target: Annotated[Path, Parameter(name="OUT")],
    /,
    *,
    to: str | None = None,
    size: str | None = None,
    unit: str | None = None,
    cameras: str | None = None,
    swap: Flag = False,
    json_: JsonFlag = False,
) -> None:
    """Convert a calibration from one format to another.

    Reads OpenCV, Kalibr, ROS, ZED, DepthAI, KITTI, EuRoC and Middlebury, and writes planview's own format, OpenCV,
    Kalibr and ROS.

    Example: planview calibrate convert intrinsics.yml rig.toml --size 640x480 --unit 24.23mm

    Parameters
    ----------
    source
        Calibration file (either one of a pair) or a folder that holds one; the format is recognised by its content.
    target
        File or folder to write.
    to
        Format to write: rig, opencv, kalibr or ros; else taken from the suffix.
    size
        Image size WxH: selects a resolution, supplies one the file lacks, or scales.
    unit
        Length of the file's unit of translation, e.g. mm, or 24.23mm for a file in chessboard squares.
    cameras
        Left and right camera of a file with more than two, e.g. cam1,cam2.
    swap
        The file calls the right camera left.
    """
    if to is None and target.suffix.lower() not in {one.suffix for one in WRITTEN if one.suffix}:
        keys = ", ".join(one.key for one in WRITTEN)
        raise InputError(f"{target}: expected --to {keys}, because no format has the suffix of {target.name!r}")
    rig = load_rig(
        source,
        None if size is None else parse_size(size, "--size"),
        cameras=None if cameras is None else _pair(cameras),
        unit_m=None if unit is None else parse_length(unit, "--unit"),
        swap=swap,
    )
    written = write_rig(rig, target, to, calibration_files(source))
    say(f"{rig.source}: baseline {rig.baseline_m:.4f} m, {rig.left.width}x{rig.left.height}")
    say(f"wrote {', '.join(map(str, written))}")
    if json_:
        found = {"source": rig.source, "baseline_m": rig.baseline_m, "width": rig.left.width, "height": rig.left.height}
        print(json.dumps(found | {"model": rig.left.model, "files": [str(path) for path in written]}))


def _pair(text: str) -> tuple[str, str]:
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise InputError(f"--cameras: expected two different names such as cam0,cam1, found {text!r}")
    return names[0], names[1]


def calibrate_ui(
    recording: Path, /, *, out: Path = Path("."), calibration: Path | None = None, port: int = 8600
) -> None:
    """Calibrate in the browser: draw standing people or floor points, see the fit and how well it is known, export.

    Example: planview calibrate ui street.mp4 --out calibration

    The page shows where the next person would help most, takes values that are known (focal length or field of view,
    also from a phone's photo, camera height, people's height), and loads and saves samples.

    Parameters
    ----------
    recording
        Video of one camera (draw people: samples.json, camera.toml), or a stereo recording (click floor points:
        world.toml).
    out
        Folder that Export writes to.
    calibration
        Calibration of a stereo recording, if it is not in it.
    port
        Port on 127.0.0.1; other machines cannot connect.
    """
    in_range("--port", port, 1024, 65535)
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise InputError(f"--port: {port} is in use by another program; choose another, e.g. {port + 1}") from error
    try:
        from planview.calibration.page.page import serve
    except ImportError as error:
        raise WorkError(f'planview calibrate ui needs the extra "ui" (pip install "planview[ui]"): {error}') from error
    from planview.calibration.page.session import open_session

    session = open_session(recording, calibration)
    say(f"open http://127.0.0.1:{port}/ in a browser; Ctrl-C ends")
    serve(session, out, port)
