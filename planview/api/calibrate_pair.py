"""Calibration of stereo pairs and sensors, and in the browser."""

from __future__ import annotations

import re
import socket
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Generic, Literal, NamedTuple, TypeVar, get_args

from rich.console import Console
from rich.progress import Progress

from calib.board.detect import MARKER_SHARES, MAX_SQUARE_M, MIN_SQUARE_M, Board, dictionaries
from calib.board.solve import BoardCalibration
from calib.camera import LensModel
from calib.errors import InputError, WorkError
from calib.formats import WRITTEN, calibration_files, load_rig, write_rig
from calib.io import parse_length, parse_size
from calib.rig import StereoRig
from calib.world import save_rigs
from planview.api.arguments import Settings, in_range, one_of, path_of, settings
from planview.calibration.align import align_records, record_rig, relative_to, rig_entries
from planview.calibration.board import BoardRequest, calibrate_images, write_report
from planview.evaluation.paths import RigAlignment
from planview.output.progress import PlainConsole
from stereo.rectify import rectified_rig

_Found = TypeVar("_Found")


class Calibrated(NamedTuple, Generic[_Found]):
    """What was found, and the files that hold it."""

    found: _Found
    files: list[Path]


def align(
    *sensors: Path | str,
    out: Path | str | None = None,
    clock: float = 10.0,
    fps: float | None = None,
    config: Settings | None = None,
    set: Sequence[str] = (),
    quiet: bool = False,
) -> Calibrated[list[RigAlignment]]:
    """Find the relative pose of stereo sensors from people who walk where both see them. No board, no markers.

    Every sensor is tracked by itself, above its own floor; heading, place and clock are those at which its people meet
    those of another. Let one to three people walk around for a minute, with turns, in the floor that the
    sensors share: standing people, or one straight line, are not enough, and are refused.

    Example:
        planview calibrate align hall/north hall/south --out hall/rigs.toml
        planview run hall --out out

    Args:
        sensors: Recordings of two or more sensors; world and clock of the first become the common ones, and each
            must share floor with a sensor named before or after it.
        out: rigs.toml to write, in a folder above all sensors; that folder is then a recording of several sensors.
        clock: Largest difference of the times at which the recordings begin [s]; a longer search takes longer.
        fps: Frames per second, where times are missing or wrong.
        config: TOML file with parameters of a run, a table per stage.
        set: One parameter, e.g. ``set`` foreground.learning_rate=0.002; can be repeated.
        quiet: Show no progress.

    Returns:
        The alignment of every sensor but the first, in order.

    Raises:
        InputError: fewer than two recordings, or one that cannot be read.
        WorkError: the sensors share no people, or these do not determine the pose.
    """
    paths = [Path(sensor) for sensor in sensors]
    file = path_of(out)
    in_range("clock", clock, 0, 3600, " s")
    if len(paths) < 2:
        raise InputError(f"calibrate align needs the recordings of two sensors or more, found {len(paths)}")
    if len({sensor.resolve() for sensor in paths}) < len(paths):
        raise InputError(f"expected every sensor once, found {', '.join(map(str, paths))}")
    if file is not None:
        for sensor in paths:
            relative_to(sensor, file.parent)
    parameters = settings(config, set)
    records = []
    for sensor in paths:
        with PlainConsole(stderr=True, quiet=quiet).status(f"tracking {sensor.name}"):
            records.append(record_rig(sensor, parameters, fps))
    alignments = align_records(records, clock)
    if file is not None:
        written = "found by planview calibrate align from people who walked"
        save_rigs(rig_entries(records, alignments, file.parent), file, written)
    return Calibrated(list(alignments), [file] if file else [])


def board(
    images: Path | str,
    square: str,
    *,
    out: Path | str = Path("rig.toml"),
    board: str | None = None,
    marker: str | None = None,
    dictionary: str | None = None,
    model: Literal["auto", "brown", "rational", "fisheye"] = "auto",
    quiet: bool = False,
) -> Calibrated[BoardCalibration]:
    """Calibrate a stereo rig from chessboard or ChArUco images.

    Writes the rig (OUT), the same for OpenCV (.yml) and a report page (.html) next to it.

    Example: planview calibrate board photos/ --square 24.23mm --out rig.toml

    Args:
        images: Folder with left/ and right/, with names that distinguish left and right, with images side by side, or a
            video.
        square: Side of a square with its unit, e.g. 24.23mm; a bare number is refused. When it is not known, give any
            size: the baseline is also printed in squares, but distances measured with the rig are as wrong as the size.
        out: Rig to write.
        board: Inner corners of a chessboard, 9x6, found by itself when not given (give it for small or blurred images);
            or charuco:8x6, the squares of a ChArUco board.
        marker: Side of a ChArUco marker, e.g. 18mm; usual sizes are tried when not given.
        dictionary: ArUco dictionary, e.g. DICT_4X4_50; all are tried when not given.
        model: Lens model; auto judges brown and fisheye on views left out of the fit.
        quiet: Show no progress.

    Returns:
        The rig with the deviation of every value, and the files.

    Raises:
        InputError: images that cannot be read, or a board that is described wrongly.
        WorkError: too few images show the board.
    """
    one_of("model", model, ("auto", *get_args(LensModel)))
    square_m = parse_square(str(square))
    file = Path(out)
    request = BoardRequest(
        parse_board(board, square_m, marker, dictionary),
        square_m,
        any_dictionary=dictionary is None,
        any_marker=marker is None,
        model=None if model == "auto" else model,
    )
    if file.suffix.lower() != ".toml":
        raise InputError(f"expected a name that ends in .toml, found {file.name!r}", argument="out")
    file.parent.mkdir(parents=True, exist_ok=True)
    console = PlainConsole(stderr=True)
    with Progress(console=console, transient=True, disable=quiet or not shows_progress(console)) as bar:
        task = bar.add_task("detecting the board", total=None)

        def progress(done: int, total: int) -> None:
            text = "calibrating" if done == total else "detecting the board"
            bar.update(task, completed=done, total=total, description=text)

        result = calibrate_images(Path(images), request, progress)
    files = [*write_rig(result.rig, file, "rig"), *write_rig(result.rig, file.with_suffix(".yml"), "opencv")]
    return Calibrated(result, [*files, write_report(result, Path(images), file.with_suffix(".html"))])


def shows_progress(console: Console) -> bool:
    """Whether somebody looks: at a terminal or in a notebook."""
    return console.is_jupyter or sys.stderr.isatty()


def parse_square(text: str) -> float:
    """Side of a square [m]. Raises InputError: a bare number, which could be millimetres as well as metres, or what is
    no length at all."""
    if re.fullmatch(r"\s*\d+([.,]\d*)?\s*", text):
        raise InputError(
            f"expected the side of a square with its unit, found {text!r} without one: "
            f"{text.strip()}mm if these are millimetres", argument="square",
        )  # fmt: skip
    return parse_length(text, "square=")


def parse_board(text: str | None, square_m: float, marker: str | None, dictionary: str | None) -> Board | None:
    """A board from what the user typed: ``9x6`` (inner corners) or ``charuco:8x6`` (squares), with the marker and the
    dictionary where they are known (``complete_charuco`` finds the others); None where the counts are to be found too.
    Raises InputError: text that describes no board."""
    if not MIN_SQUARE_M <= square_m <= MAX_SQUARE_M:
        raise InputError(
            f"expected the side of one square, {1000 * MIN_SQUARE_M:g} mm to {100 * MAX_SQUARE_M:g} cm, "
            f"found {1000 * square_m:g} mm",
            argument="square",
        )
    if text is None:
        if marker or dictionary:
            raise InputError("a marker and a dictionary need charuco:COLSxROWS, found no board", argument="board")
        return None
    match = re.fullmatch(r"\s*(charuco)?[\s:]*(\d{1,3})\s*[xX×]\s*(\d{1,3})\s*", text)
    if match is None:
        raise InputError(f"expected 9x6 (inner corners) or charuco:8x6 (squares), found {text!r}", argument="board")
    cols = int(match[2])
    rows = int(match[3])
    try:
        if not match[1]:
            return Board(cols, rows, square_m)
        marker_m = parse_length(marker, "marker=") if marker else MARKER_SHARES[0] * square_m
        names = dictionaries()
        chosen = dictionary or next(iter(names))
        chosen = chosen if chosen.startswith("DICT_") else f"DICT_{chosen}"
        one_of("dictionary", chosen, names)
        return Board(cols - 1, rows - 1, square_m, chosen, marker_m)
    except ValueError as error:
        raise InputError(str(error), argument="board") from error


def convert(
    source: Path | str,
    target: Path | str,
    *,
    to: str | None = None,
    size: str | None = None,
    unit: str | None = None,
    cameras: str | None = None,
    swap: bool = False,
    rectified: bool = False,
) -> Calibrated[StereoRig]:
    """Convert a calibration from one format to another.

    Reads OpenCV, Kalibr, ROS, ZED, DepthAI, KITTI, EuRoC and Middlebury, and writes planview's own format, OpenCV,
    Kalibr and ROS.

    Example: planview calibrate convert intrinsics.yml rig.toml --size 640x480 --unit 24.23mm

    Args:
        source: Calibration file (either one of a pair) or a folder that holds one; the format is recognised by its
            content.
        target: File or folder to write.
        to: Format to write: rig, opencv, kalibr or ros; else taken from the suffix.
        size: Image size WxH: selects a resolution, supplies one the file lacks, or scales.
        unit: Length of the file's unit of translation, e.g. mm, or 24.23mm for a file in chessboard squares.
        cameras: Left and right camera of a file with more than two, e.g. cam1,cam2.
        swap: The file calls the right camera left.
        rectified: Write the calibration of rectified images: P1 and P2 of the file, else OpenCV's for alpha 0.

    Raises:
        InputError: a calibration that cannot be read, or a format that is not known.
    """
    source = Path(source)
    target = Path(target)
    if to is None and target.suffix.lower() not in {one.suffix for one in WRITTEN if one.suffix}:
        keys = ", ".join(one.key for one in WRITTEN)
        problem = f"expected {keys} for {target}, because no format has the suffix of {target.name!r}"
        raise InputError(problem, argument="to")
    rig = load_rig(
        source,
        None if size is None else parse_size(size, "size="),
        cameras=None if cameras is None else _pair(cameras),
        unit_m=None if unit is None else parse_length(unit, "unit="),
        swap=swap,
        rectified=rectified or None,
    )
    if rectified:
        rig = rectified_rig(rig)
    return Calibrated(rig, list(write_rig(rig, target, to, calibration_files(source))))


def _pair(text: str) -> tuple[str, str]:
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise InputError(f"expected two different names such as cam0,cam1, found {text!r}", argument="cameras")
    return names[0], names[1]


def ui(
    recording: Path | str,
    *,
    out: Path | str = Path("."),
    calibration: Path | str | None = None,
    port: int = 8600,
) -> None:
    """Calibrate in the browser: draw standing people or floor points, see the fit and how well it is known, export.

    Example: planview calibrate ui street.mp4 --out calibration

    The page shows where the next person would help most, takes values that are known (focal length or field of view,
    also from a phone's photo, camera height, people's height), and loads and saves samples.

    Args:
        recording: Video of one camera (draw people: samples.json, camera.toml), or a stereo recording (click floor
            points: world.toml).
        out: Folder that Export writes to.
        calibration: Calibration of a stereo recording, if it is not in it.
        port: Port on 127.0.0.1; other machines cannot connect.

    Raises:
        InputError: a recording that cannot be read, or a port in use.
        WorkError: the extra "ui" is not installed.
    """
    in_range("port", port, 1024, 65535)
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            problem = f"{port} is in use by another program; choose another, e.g. {port + 1}"
            raise InputError(problem, argument="port") from error
    try:
        from planview.calibration.page.page import serve
    except ImportError as error:
        raise WorkError(f'the page needs the extra "ui" (pip install "planview[ui]"): {error}') from error
    from planview.calibration.page.session import open_session

    session = open_session(Path(recording), path_of(calibration))
    console = PlainConsole(stderr=True, soft_wrap=True, highlight=False)
    console.print(f"open http://127.0.0.1:{port}/ in a browser; Ctrl-C ends")
    serve(session, Path(out), port)
