"""From board images on disk to a rig: detection, choice of frames, checks of what the user said, solve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.board.detect import (
    Board,
    BoardView,
    Detector,
    common_view,
    complete_charuco,
    find_counts,
    larger_counts,
    same_order,
    spans_a_plane,
)
from calib.board.fit import MAX_VIEWS, select_views, sharpness
from calib.board.solve import BoardCalibration, RejectedView, solve_board
from calib.camera import LensModel
from calib.errors import InputError
from calib.images import as_grey
from calib.types import U8
from planview.calibration.board_images import BoardImages, BoardPair

_SAMPLE_PAIRS = 4
"""Pairs looked at to find or check the board's counts."""


@dataclass(frozen=True, eq=False)
class BoardRequest:
    """What the user said.

    Attributes:
        board: None to find a chessboard's counts.
        square_m: side of a square [m].
        any_dictionary, any_marker: parts of a ChArUco board that were left open.
        model: lens model; None to choose.
    """

    board: Board | None
    square_m: float
    any_dictionary: bool = False
    any_marker: bool = False
    model: LensModel | None = None


def calibrate_images(
    path: Path, request: BoardRequest, progress: Callable[[int, int], None] = lambda done, total: None
) -> BoardCalibration:
    """Calibrate a rig from the images at a path.

    Args:
        path: folder or video.
        request: the board and options.
        progress: called with pairs done and in all.
    Raises:
        InputError: unusable images or views (see ``solve_board``).
    """
    images = BoardImages(path)
    board = _board(images, request)
    found = _detect(images, board, progress)
    views, rejected = found.views, found.rejected
    if images.is_video or len(views) > 2 * MAX_VIEWS:
        views = [views[i] for i in select_views(views, found.sharpness, found.size)]
        rejected = [] if images.is_video else rejected
    if not images.is_video and not views:
        raise InputError(f"{path}: expected images of a {board.name}, found it in none of {len(rejected)} pairs")
    return solve_board(views, board, found.size, model=request.model, rejected=rejected, source=str(path))


def _sample(images: BoardImages, pairs: int = _SAMPLE_PAIRS) -> list[U8]:
    indices = sorted({int(i) for i in np.linspace(0, len(images) - 1, min(len(images), pairs))})
    return [image for pair in images.at(indices) for image in (pair.left, pair.right) if image is not None]


def _board(images: BoardImages, request: BoardRequest) -> Board:
    """The board, its counts found or checked."""
    sample = _sample(images)
    if request.board is not None and request.board.dictionary:
        return complete_charuco(
            request.board, sample, any_dictionary=request.any_dictionary, any_marker=request.any_marker
        )
    if request.board is None:
        counts = find_counts(sample) or find_counts(_sample(images, 5 * _SAMPLE_PAIRS))
        if counts is None:
            raise InputError(
                f"{images.path}: expected images of a chessboard, found none in {len(sample)} of them "
                "(give --board COLSxROWS inner corners, or --board charuco:COLSxROWS squares)"
            )
        return Board(*counts, request.square_m)
    counts = larger_counts(sample, (request.board.cols, request.board.rows))
    if counts is not None:
        raise InputError(
            f"{images.path}: expected a board of {request.board.cols}x{request.board.rows} inner corners (--board), "
            f"found one of {counts[0]}x{counts[1]}"
        )
    return request.board


@dataclass(frozen=True, eq=False)
class _Detected:
    """The pairs that show the board, how sharp each is, the others, and the size of all images (width, height)."""

    views: list[BoardView]
    sharpness: list[float]
    rejected: list[RejectedView]
    size: tuple[int, int]


def _detect(images: BoardImages, board: Board, progress: Callable[[int, int], None]) -> _Detected:
    detector = Detector(board, thorough=not images.is_video)
    found = _Detected([], [], [], (0, 0))
    for done, pair in enumerate(images, 1):
        progress(done, len(images))
        if pair.left is None or pair.right is None:
            found.rejected.append(RejectedView(pair.name, pair.why))
            continue
        found = replace(found, size=_same_size(images.path, pair, found.size))
        result = _look(pair, detector, board)
        if isinstance(result, RejectedView):
            found.rejected.append(result)
        else:
            found.views.append(result[0])
            found.sharpness.append(result[1])
    if found.size == (0, 0):
        why = f", e.g. {found.rejected[0].name}: {found.rejected[0].why}" if found.rejected else ""
        raise InputError(f"{images.path}: expected pairs of images, found none that can be read{why}")
    return found


def _same_size(path: Path, pair: BoardPair, size: tuple[int, int]) -> tuple[int, int]:
    """The size of the pair's images, which is that of the earlier ones (0, 0 before the first)."""
    for side, image in (("left", pair.left), ("right", pair.right)):
        if image is None:
            continue
        found = (image.shape[1], image.shape[0])
        if size not in {(0, 0), found}:
            raise InputError(
                f"{path}: expected images of one size, {size[0]}x{size[1]}, "
                f"found {found[0]}x{found[1]} in {pair.name} ({side})"
            )
        size = found
    return size


def _look(pair: BoardPair, detector: Detector, board: Board) -> tuple[BoardView, float] | RejectedView:
    """The corners that both images show and how sharp the lesser image is, or why the pair is of no use."""
    if pair.left is None or pair.right is None:
        raise ValueError("expected a pair with images")
    left, right = detector(pair.left), detector(pair.right)
    if left is None or right is None:
        missing = " and ".join(side for side, corners in (("left", left), ("right", right)) if corners is None)
        return RejectedView(pair.name, f"no {board.name} found in the {missing} image")
    view = common_view(pair.name, left, same_order(board, left, right))
    if not spans_a_plane(board, view.ids):
        return RejectedView(pair.name, f"only {len(view.ids)} corners of the {board.name} are in both images")
    sharp = [sharpness(as_grey(image), corners) for image, corners in ((pair.left, left), (pair.right, right))]
    return view, min(sharp)
