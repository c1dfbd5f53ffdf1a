"""From board images on disk to a rig and a page about it: pairs in any layout, detection, choice of frames, checks."""

from __future__ import annotations

import base64
import io
import logging
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from calib.board import detect
from calib.board.detect import SIDES, Board, BoardView
from calib.board.fit import MAX_VIEWS, rig_parameters, rms, select_views, sharpness
from calib.board.solve import FOLDS, BoardCalibration, RejectedView, solve_board
from calib.camera import LensModel
from calib.errors import InputError
from calib.formats import write_rig
from calib.images import as_colour, as_grey, encode_image
from calib.io import entries, parse_length, refuse_missing, size_text, write_whole
from calib.types import U8
from planview.drawing.style import page_of
from planview.progress import Progress, unseen
from stereo.readers.images import bits_of, frame_number, image_files, read_image
from stereo.readers.pairing import split_sides
from stereo.readers.video import SUFFIXES as VIDEO_SUFFIXES
from stereo.readers.video import VideoFile, video_files
from stereo.rectify import Rectifier, RectifyParams

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class BoardPair:
    """Two images taken together; without images ``why`` names what is wrong."""

    name: str
    left: U8 | None = None
    right: U8 | None = None
    why: str = ""


Files = Sequence[Path | None]
"""A file of each camera, None where there is none, or one that holds both images."""


class BoardImages:
    """The pairs at a path, named in order; iterating reads them one by one."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._files = list[Files]()
        self._frames = list[int]()
        if path.is_file() and path.suffix.lower() in VIDEO_SUFFIXES:
            self._videos: Sequence[Path] = (path,)
        elif path.is_dir():
            self._files, self._videos = _in_folder(path)
        else:
            refuse_missing(path)
            raise InputError(f"{path}: expected a folder of board images or a video, found another file")
        self.is_video = bool(self._videos)
        if self.is_video:
            n_frames = min(VideoFile(video).n_frames for video in self._videos)
            if n_frames < 1:
                raise InputError(f"{path}: expected a video with a known number of frames, found none")
            # Frames of a video that are searched for the board: enough to choose 40 good views from.
            self._frames = _spread(n_frames, 240)
        self.names = [_name(files) for files in self._files] + [f"frame {index}" for index in self._frames]

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[BoardPair]:
        return self.at(range(len(self)))

    def sample(self, pairs: int) -> list[U8]:
        """Images of a few pairs, to find or check the board's counts."""
        images = []
        for pair in self.at(_spread(len(self), pairs)):
            images += [image for image in (pair.left, pair.right) if image is not None]
        return images

    def at(self, indices: Sequence[int]) -> Iterator[BoardPair]:
        """Only these pairs, in ascending order."""
        if self.is_video:
            streams = [VideoFile(path).at([self._frames[i] for i in indices]) for path in self._videos]
            for frames in zip(*streams, strict=False):
                yield _pair(f"frame {frames[0].index}", [frame.image for frame in frames])
            return
        for index in indices:
            yield _read_pair(self._files[index])


def _spread(total: int, count: int) -> list[int]:
    """Up to n indices, evenly spread."""
    return sorted({int(index) for index in np.linspace(0, total - 1, min(total, count))})


def _read_pair(files: Files) -> BoardPair:
    images = []
    broken = ""
    for file in files:
        if file is None:
            return BoardPair(_name(files), why="has no mate from the other camera")
        image = read_image(file, bits_of([file]))
        images.append(image)
        if image is None and len(files) == 2 and not broken:
            broken = f"{file.parent.name}/{file.name} "
    return _pair(_name(files), images, broken)


def _name(files: Files) -> str:
    return " ".join(dict.fromkeys(file.name for file in files if file is not None))


def _pair(name: str, images: Sequence[U8 | None], which: str = "") -> BoardPair:
    """A pair of an image of each camera, or of one that holds both side by side."""
    left = images[0]
    right = images[-1]
    if left is None or right is None:
        return BoardPair(name, why=f"{which}cannot be decoded")
    if len(images) == 2:
        return BoardPair(name, left, right)
    height, width = left.shape[:2]
    # Wider images are two pictures side by side: no single sensor is that wide.
    if width < 2.0 * height or width % 2:
        expected = "a left and a right image side by side (an even width, at least twice the height)"
        raise InputError(f"{name}: expected {expected}, found {width}x{height}")
    return BoardPair(name, left[:, : width // 2], left[:, width // 2 :])


def _in_folder(folder: Path) -> tuple[list[Files], Sequence[Path]]:
    """Images, or videos; those of the two cameras are distinguished by the names of their folders or their own."""
    folders = [path for path in entries(folder) if path.is_dir() and image_files(path)]
    sides = split_sides([path.name for path in folders])
    if sides is not None:
        if len(sides.left) != 1 or len(sides.right) != 1:
            raise InputError(f"{folder}: expected one folder of left and one of right images, found {len(folders)}")
        left = image_files(folders[sides.left[0]])
        right = image_files(folders[sides.right[0]])
        return _pair_files(left, right), ()
    images = image_files(folder)
    videos = video_files(folder)
    files = images or videos
    left = []
    right = []
    sides = split_sides([file.stem for file in files])
    if sides is not None:
        left = [files[index] for index in sides.left]
        right = [files[index] for index in sides.right]
    if images and left:
        return _pair_files(left, right), ()
    if images:
        return [(file,) for file in images], ()
    if len(left) == len(right) == 1:
        return [], [*left, *right]
    if len(videos) == 1:
        return [], videos
    needed = "left and right images or videos, or images or a video side by side"
    raise InputError(f"{folder}: expected {needed}, found {len(videos) or 'no images or'} videos")


def _pair_files(left: Sequence[Path], right: Sequence[Path]) -> list[Files]:
    """Mates by name without the word for the side, else by number, else in order."""
    for key in (_plain_name, frame_number):
        lefts = {key(file): file for file in left}
        rights = {key(file): file for file in right}
        is_unique = len(lefts) == len(left) and len(rights) == len(right)
        n_common = len(lefts.keys() & rights.keys())
        if is_unique and None not in lefts and n_common * 2 >= min(len(left), len(right)):
            return [(lefts.get(name), rights.get(name)) for name in {**lefts, **rights}]
    if len(left) != len(right):
        found = f"found {len(left)} and {len(right)}"
        raise InputError(f"{left[0].parent}: expected as many left as right images, or names that pair up, {found}")
    return list(zip(left, right, strict=True))


def _plain_name(file: Path) -> str:
    name = re.sub(r"left|right|cam(era)?_?[01](?!\d)", "*", file.stem.lower())
    return re.sub(r"(?<![a-z])[lr](?![a-z])", "*", name)


@dataclass(frozen=True, eq=False)
class BoardRequest:
    """A board as given: None finds a chessboard's counts; its square's side [m]; parts of a ChArUco board that
    were left open; the lens model, None to choose."""

    board: Board | None
    square_m: float
    any_dictionary: bool = False
    any_marker: bool = False
    model: LensModel | None = None


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
    if not detect.MIN_SQUARE_M <= square_m <= detect.MAX_SQUARE_M:
        sizes = f"{1000 * detect.MIN_SQUARE_M:g} mm to {100 * detect.MAX_SQUARE_M:g} cm"
        raise InputError(f"expected the side of one square, {sizes}, found {1000 * square_m:g} mm", argument="square")
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
        marker_m = parse_length(marker, "marker=") if marker else detect.MARKER_SHARES[0] * square_m
        names = detect.dictionaries()
        name = dictionary or next(iter(names))
        if not name.startswith("DICT_"):
            name = f"DICT_{name}"
        if name not in names:
            raise InputError(f"expected one of {', '.join(names)}, found {name!r}", argument="dictionary")
        return Board(cols - 1, rows - 1, square_m, name, marker_m)
    except ValueError as error:
        raise InputError(str(error), argument="board") from error


def calibrate_board(
    path: Path, request: BoardRequest, file: Path, progress: Progress = unseen
) -> tuple[BoardCalibration, list[Path]]:
    """Calibrate a rig from a folder or video (errors of ``solve_board``) and write it, next to it the same for OpenCV
    and a page about it; returns the files, too. Raises InputError: a file that does not end in .toml."""
    if file.suffix.lower() != ".toml":
        raise InputError(f"expected a name that ends in .toml, found {file.name!r}", argument="out")
    file.parent.mkdir(parents=True, exist_ok=True)
    images = BoardImages(path)
    board = _board(images, request)
    log.debug("detecting the board")
    detected = _detect(images, board, progress)
    views = detected.views
    rejected = detected.rejected
    if images.is_video or len(views) > 2 * MAX_VIEWS:
        views = [views[index] for index in select_views(views, board.points, detected.sharpness, detected.size)]
    if images.is_video:
        rejected = []
    elif not views:
        raise InputError(f"{path}: expected images of a {board.name}, found it in none of {len(rejected)} pairs")
    log.debug("calibrating")
    result = solve_board(views, board, detected.size, model=request.model, rejected=rejected, source=str(path))
    files = write_rig(result.rig, file, "rig")
    files += write_rig(result.rig, file.with_suffix(".yml"), "opencv")
    files.append(write_report(result, path, file.with_suffix(".html")))
    return result, files


def _board(images: BoardImages, request: BoardRequest) -> Board:
    """The board, its counts searched for or checked."""
    sample = images.sample(4)
    board = request.board
    if board is not None and board.dictionary:
        return detect.complete_charuco(
            board, sample, any_dictionary=request.any_dictionary, any_marker=request.any_marker
        )
    if board is None:
        counts = detect.find_counts(sample) or detect.find_counts(images.sample(20))
        if counts is None:
            raise InputError(
                f"{images.path}: expected images of a chessboard, found none in {len(sample)} of them: "
                "name its inner corners (COLSxROWS) or a ChArUco board's squares (charuco:COLSxROWS)"
            )
        return Board(*counts, request.square_m)
    counts = detect.larger_counts(sample, (board.cols, board.rows))
    if counts is not None:
        expected = f"a board of {board.cols}x{board.rows} inner corners"
        raise InputError(f"{images.path}: expected {expected}, found one of {counts[0]}x{counts[1]}")
    return board


class _Detected(NamedTuple):
    """The pairs that show the board, how sharp each is, the others, and the size of all images (width, height)."""

    views: list[BoardView]
    sharpness: list[float]
    rejected: list[RejectedView]
    size: tuple[int, int]


def _detect(images: BoardImages, board: Board, progress: Progress) -> _Detected:
    """Detect the corners that both images of a pair show, and how sharp the lesser image is; name the pairs that are of
    no use, and why."""
    detector = detect.Detector(board, thorough=not images.is_video)
    detected = _Detected([], [], [], (0, 0))
    size: tuple[int, int] | None = None
    for done, pair in enumerate(images, 1):
        progress(done, len(images))
        if pair.left is None or pair.right is None:
            detected.rejected.append(RejectedView(pair.name, pair.why))
            continue
        for side, image in (("left", pair.left), ("right", pair.right)):
            image_size = (image.shape[1], image.shape[0])
            size = size or image_size
            if size != image_size:
                sizes = f"{size_text(size)}, found {size_text(image_size)} in {pair.name} ({side})"
                raise InputError(f"{images.path}: expected images of one size, {sizes}")
        left = detector(pair.left)
        right = detector(pair.right)
        if left is None or right is None:
            lacking = [side for side, corners in (("left", left), ("right", right)) if corners is None]
            why = f"no {board.name} found in the {' and '.join(lacking)} image"
            detected.rejected.append(RejectedView(pair.name, why))
            continue
        view = detect.common_view(pair.name, left, detect.same_order(board, left, right))
        if not detect.spans_a_plane(board, view.ids):
            why = f"only {len(view.ids)} corners of the {board.name} are in both images"
            detected.rejected.append(RejectedView(pair.name, why))
            continue
        detected.views.append(view)
        left_sharpness = sharpness(as_grey(pair.left), left)
        right_sharpness = sharpness(as_grey(pair.right), right)
        detected.sharpness.append(min(left_sharpness, right_sharpness))
    if size is None:
        first = detected.rejected[:1]
        why = "".join(f", e.g. {view.name}: {view.why}" for view in first)
        raise InputError(f"{images.path}: expected pairs of images, found none that can be read{why}")
    return detected._replace(size=size)


def write_report(result: BoardCalibration, images: Path, path: Path) -> Path:
    """Write the page and return its path; one of the pairs in ``images`` is read again and shown rectified."""
    name, picture = _rectified_pair(result, images)
    rig = result.rig
    used = len(result.views)
    page = page_of(
        "planview.calibration", "board_report.html.j2", source=images.name or str(images), board=result.board.name,
        size=f"{rig.left.width}x{rig.left.height}", pair_name=name, rejected=result.rejected, lenses=result.lenses,
        chosen=result.chosen_lens, folds=min(FOLDS, used), parameters=_parameters(result),
        rectified=base64.b64encode(encode_image(picture)).decode("ascii"),
        errors=base64.b64encode(_figure(result)).decode("ascii"),
        figures=[
            ("stereo rms", f"{result.fit.rms_px:.3f} px"),
            ("rows after rectification, rms", f"{result.row_rms_px:.3f} px"),
            ("baseline", f"{1000 * rig.baseline_m:.2f} ± {1000 * result.std['baseline']:.2f} mm"),
            ("baseline in squares", f"{result.baseline_squares:.3f}"),
            ("between the cameras", f"{math.degrees(rig.right_SE3_left.angle_rad):.2f}°"),
            ("pairs used", f"{used} of {used + len(result.rejected)}"),
            ("lens", rig.left.model),
        ],
    )  # fmt: skip
    write_whole(path, page)
    return path


def _parameters(result: BoardCalibration) -> list[tuple[str, str, str]]:
    rows = []
    for name, value in rig_parameters(result.rig).items():
        scale = 1.0
        unit = ""
        digits = 6
        if name.startswith("rotation"):
            scale = math.degrees(1)
            unit = "°"
            digits = 4
        elif name.startswith("translation") or name == "baseline":
            scale = 1000.0
            unit = " mm"
            digits = 3
        elif name.split()[1] in {"fx", "fy", "cx", "cy"}:
            unit = " px"
            digits = 3
        shown = f"{scale * value:.{digits}f}{unit}"
        deviation = f"{scale * result.std[name]:.{digits}f}{unit}"
        rows.append((name, shown, deviation))
    return rows


def _rectified_pair(result: BoardCalibration, images: Path) -> tuple[str, U8]:
    """The pair with the median error, rectified side by side with lines across both."""
    by_error = np.argsort(result.fit.view_rms_px())
    median = int(by_error[len(by_error) // 2])
    name = result.views[median].name
    source = BoardImages(images)
    pair = next(source.at([source.names.index(name)]))
    if pair.left is None or pair.right is None:
        raise ValueError(f"expected {name} to be readable as before")
    rectified = Rectifier(result.rig, RectifyParams(working_px=720))(pair.left, pair.right)
    colour = as_colour(np.hstack([rectified.left_grey, rectified.right_grey]))
    height, width = colour.shape[:2]
    rows = np.linspace(0, height - 1, 18 + 2).astype(int)
    for row in rows[1:-1].tolist():
        cv2.line(colour, (0, row), (width - 1, row), (60, 200, 60), 1)
    return name, colour


def _figure(result: BoardCalibration) -> bytes:
    """PNG: the error of each view, and of each corner as an arrow where it was found."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8), dpi=110, layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=(1.0, 1.4))
    bars = figure.add_subplot(grid[0, :])
    places = np.arange(len(result.views))
    width, height = result.rig.left.size
    colours = ("tab:blue", "tab:orange")
    for column, side in enumerate(SIDES):
        errors = [error[column] for error in result.fit.errors]
        heights = [rms([error]) for error in errors]
        bars.bar(places + 0.4 * column - 0.2, heights, 0.4, color=colours[column], label=side)
        axes = figure.add_subplot(grid[1, column])
        u, v = np.concatenate([view.image_points(side) for view in result.views]).T
        right, down = -60.0 * np.concatenate(errors).T
        size = np.hypot(right, down)
        axes.quiver(u, v, right, down, size, angles="xy", scale_units="xy", scale=1, cmap="viridis", width=0.002)
        title = f"{side}: errors x 60, {100 * result.coverage_share(side):.0f} % of the image covered"
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", title=title)
    bars.axhline(result.fit.rms_px, color="black", lw=0.8, ls="--", label="all")
    bars.set_xticks(places, [view.name.split()[0] for view in result.views], rotation=90, fontsize=7)
    bars.set(ylabel="rms error [px]", title="per view")
    bars.legend(loc="upper right")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
