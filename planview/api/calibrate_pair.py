"""Calibration of stereo pairs and sensors, and in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

from calib.board.detect import SIDES
from calib.board.solve import BoardCalibration
from calib.camera import LensModel
from calib.errors import InputError, WorkError
from calib.formats import calibration_files, load_rig, write_rig
from calib.io import parse_length
from calib.rig import StereoRig
from planview.api.arguments import Settings, in_range, one_of, path_of, settings, size_of
from planview.api.result import Result, plain_values
from planview.calibration.align import align_recordings
from planview.calibration.board import BoardRequest, calibrate_board, parse_board, parse_square
from planview.evaluation.paths import RigAlignment
from planview.progress import Progress, unseen
from stereo.rectify import rectified_rig


def align(
    *sensors: Path | str,
    out: Path | str | None = None,
    clock: float = 10.0,
    fps: float | None = None,
    config: Settings | None = None,
) -> Result[list[RigAlignment]]:
    """Find the relative pose of stereo sensors from people who walk.

    They walk where both see them; no board, no markers. Every sensor is tracked by itself, above its own floor;
    heading, place and clock are those at which its people meet those of another. Let one to three people walk around
    for a minute, with turns, in the floor that the sensors share: standing people, or one straight line, are not
    enough, and are refused.

    ```python
    planview.calibrate.align("hall/north", "hall/south", out="hall/rigs.toml")
    planview.run("hall", out="out")
    ```

    Args:
        sensors: Recordings of two or more sensors; world and clock of the first become the common ones, and each
            must share floor with a sensor named before or after it.
        out: rigs.toml to write, in a folder above all sensors; that folder is then a recording of several sensors.
        clock: Largest difference of the times at which the recordings begin [s]; a longer search takes longer.
        fps: Frames per second, where times are missing or wrong.
        config: TOML file with parameters of a run, a table per stage. In Python also a dict of those that differ, or a
            Config.

    Returns:
        The alignment of every sensor but the first, in order.

    Raises:
        InputError: fewer than two recordings, or one that cannot be read.
        WorkError: the sensors share no people, or these do not determine the pose.
    """
    in_range("clock", clock, 0, 3600, " s")
    file = path_of(out)
    paths = [Path(sensor) for sensor in sensors]
    alignments = align_recordings(paths, file, settings(config), fps, clock)
    rows = []
    for path, alignment in zip(paths[1:], alignments, strict=True):
        values = plain_values(
            alignment, "heading_rad", "heading_std_rad", "x_m", "y_m", "position_std_m", "clock_s", "clock_std_s",
            "residual_m", "shared_s",
        )  # fmt: skip
        rows.append({"sensor": str(path)} | values)
    return Result(alignments, {"sensors": rows}, rows, [file] if file else [])


def board(
    images: Path | str,
    square: float | str,
    *,
    out: Path | str = Path("rig.toml"),
    board: str | None = None,
    marker: str | None = None,
    dictionary: str | None = None,
    model: Literal["auto", "brown", "rational", "fisheye"] = "auto",
    progress: Progress = unseen,
) -> Result[BoardCalibration]:
    """Calibrate a stereo rig from chessboard or ChArUco images.

    Writes the rig, the same for OpenCV (.yml) and a report page (.html) next to it.

    ```python
    rig = planview.calibrate.board("photos", 0.02423, out="rig.toml").value.rig  # squares of 24.23 mm
    ```

    Args:
        images: Folder with left/ and right/, with names that distinguish left and right, with images side by side, or a
            video.
        square: Side of a square with its unit, e.g. 24.23mm; a bare number is refused. When it is not known, give any
            size: the baseline is also printed in squares, but distances measured with the rig are as wrong as the size.
            In Python also a float, in metres.
        out: Rig to write.
        board: Inner corners of a chessboard, 9x6, found by itself when not given (give it for small or blurred images);
            or charuco:8x6, the squares of a ChArUco board.
        marker: Side of a ChArUco marker, e.g. 18mm; usual sizes are tried when not given.
        dictionary: ArUco dictionary, e.g. DICT_4X4_50; all are tried when not given.
        model: Lens model; auto judges brown and fisheye on views left out of the fit.
        progress: Called after every pair of images.

    Returns:
        The rig with the deviation of every value.

    Raises:
        InputError: images that cannot be read, or a board that is described wrongly.
        WorkError: too few images show the board.
    """
    one_of("model", model, ("auto", *get_args(LensModel)))
    square_m = square if isinstance(square, float) else parse_square(str(square))
    known = parse_board(board, square_m, marker, dictionary)
    lens = None if model == "auto" else model
    request = BoardRequest(known, square_m, dictionary is None, marker is None, lens)
    found, files = calibrate_board(Path(images), request, Path(out), progress)
    errors = zip(found.views, found.fit.view_rms_px().tolist(), strict=True)
    views = [{"view": view.name, "rms_px": rms_px} for view, rms_px in errors]
    rejected = [{"name": view.name, "why": view.why} for view in found.rejected]
    values = {
        "board": found.board.name,
        "model": found.rig.left.model,
        "stereo_rms_px": found.fit.rms_px,
        **plain_values(found, "row_rms_px", "baseline_squares"),
        "baseline_m": found.rig.baseline_m,
        "baseline_std_m": found.std["baseline"],
        "views_used": len(views),
        "views_rejected": rejected,
        "held_out_px": {lens.name: lens.held_out_px for lens in found.lenses},
        "coverage": {side: found.coverage_share(side) for side in SIDES},
        "views": views,
    }
    return Result(found, values, views, files)


def convert(
    source: Path | str,
    out: Path | str,
    *,
    to: str | None = None,
    size: tuple[int, int] | str | None = None,
    unit: float | str | None = None,
    cameras: tuple[str, str] | str | None = None,
    swap: bool = False,
    rectified: bool = False,
) -> Result[StereoRig]:
    """Convert a calibration from one format to another.

    Reads OpenCV, Kalibr, ROS, ZED, DepthAI, KITTI, EuRoC and Middlebury, and writes planview's own format, OpenCV,
    Kalibr and ROS.

    ```python
    planview.calibrate.convert("intrinsics.yml", "rig.toml", size=(640, 480), unit=0.001)  # a file in millimetres
    ```

    Args:
        source: Calibration file (either one of a pair) or a folder that holds one; the format is recognised by its
            content.
        out: File or folder to write.
        to: Format to write: rig, opencv, kalibr or ros; else taken from the suffix.
        size: Image size WxH: selects a resolution, supplies one the file lacks, or scales. In Python also (width,
            height).
        unit: Length of the file's unit of translation, e.g. mm, or 24.23mm for a file in chessboard squares. In Python
            also a float, in metres.
        cameras: Left and right camera of a file with more than two, e.g. cam1,cam2. In Python also a tuple of both.
        swap: The file calls the right camera left.
        rectified: Write the calibration of rectified images: P1 and P2 of the file, else OpenCV's for alpha 0.

    Raises:
        InputError: a calibration that cannot be read, or a format that is not known.
    """
    source = Path(source)
    out = Path(out)
    rig = load_rig(
        source,
        size_of(size, "size"),
        cameras=None if cameras is None else _two_names(cameras),
        unit_m=parse_length(unit, "unit=") if isinstance(unit, str) else unit,
        swap=swap,
        rectified=rectified or None,
    )
    if rectified:
        rig = rectified_rig(rig)
    files = write_rig(rig, out, to, calibration_files(source))
    values = {"source": rig.source, "baseline_m": rig.baseline_m, **plain_values(rig.left, "width", "height", "model")}
    return Result(rig, values, files=files)


def _two_names(cameras: tuple[str, str] | str) -> tuple[str, str]:
    names = cameras.replace(" ", "").split(",") if isinstance(cameras, str) else cameras
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise InputError(f"expected two different names such as cam0,cam1, found {cameras!r}", argument="cameras")
    return names[0], names[1]


def ui(
    recording: Path | str,
    *,
    out: Path | str = Path("."),
    calibration: Path | str | None = None,
    port: int = 8600,
) -> None:
    """Calibrate in the browser.

    Draw standing people or floor points, see the fit and how well it is known, and export it. The page shows where the
    next person would help most, takes values that are known (focal length or field of view, also from a phone's photo,
    camera height, people's height), and loads and saves samples.

    ```python
    planview.calibrate.ui("street.mp4", out="calibration")  # until Ctrl-C
    ```

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
    try:
        from planview.calibration.page.page import refuse_used, serve
        from planview.calibration.page.session import open_session
    except ImportError as error:
        raise WorkError(f'the page needs the extra "ui" (pip install "planview[ui]"): {error}') from error
    refuse_used(port)
    serve(open_session(Path(recording), path_of(calibration)), Path(out), port)
