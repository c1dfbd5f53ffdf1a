"""From board images on disk to a rig: detection, choice of frames, checks of what the user said, solve."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.board.detect import Board, Detector, better_counts, complete_charuco, find_counts, same_order
from calib.board.model import View
from calib.board.select import MAX_VIEWS, select_views, sharpness
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
    views, sharp, rejected, size = _detect(images, board, progress)
    if images.is_video or len(views) > 2 * MAX_VIEWS:
        whole = [i for i, view in enumerate(views) if view.left is not None and view.right is not None]
        taken = select_views([views[i] for i in whole], [sharp[i] for i in whole], size)
        views = [views[whole[i]] for i in taken]
        rejected = [] if images.is_video else rejected
    if images.is_video is False and not views:
        _refuse_unseen(images, board, rejected)
    return solve_board(views, board, size, model=request.model, rejected=rejected, source=str(path))


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
    counts = better_counts(sample, (request.board.cols, request.board.rows))
    if counts is not None:
        raise InputError(
            f"{images.path}: expected a board of {request.board.cols}x{request.board.rows} inner corners (--board), "
            f"found one of {counts[0]}x{counts[1]}"
        )
    return request.board


def _detect(
    images: BoardImages, board: Board, progress: Callable[[int, int], None]
) -> tuple[list[View], list[float], list[RejectedView], tuple[int, int]]:
    detector = Detector(board, thorough=not images.is_video)
    views: list[View] = []
    sharp: list[float] = []
    rejected: list[RejectedView] = []
    size: tuple[int, int] | None = None
    for done, pair in enumerate(images, 1):
        progress(done, len(images))
        if pair.left is None or pair.right is None:
            rejected.append(RejectedView(pair.name, pair.why))
            continue
        size = _same_size(images.path, pair, size)
        view, value = _look(pair, detector, board)
        missing = [side for side in ("left", "right") if getattr(view, side) is None]
        if missing:
            rejected.append(RejectedView(pair.name, f"no {board.name} found in the {' and '.join(missing)} image"))
        if len(missing) < 2:
            views.append(view)
            sharp.append(value)
    if size is None:
        why = f", e.g. {rejected[0].name}: {rejected[0].why}" if rejected else ""
        raise InputError(f"{images.path}: expected pairs of images, found none that can be read{why}")
    return views, sharp, rejected, size


def _same_size(path: Path, pair: BoardPair, size: tuple[int, int] | None) -> tuple[int, int]:
    for side, image in (("left", pair.left), ("right", pair.right)):
        if image is None:
            continue
        found = (image.shape[1], image.shape[0])
        if size is not None and found != size:
            raise InputError(
                f"{path}: expected images of one size, {size[0]}x{size[1]}, "
                f"found {found[0]}x{found[1]} in {pair.name} ({side})"
            )
        size = found
    if size is None:
        raise ValueError("expected a pair with images")
    return size


def _look(pair: BoardPair, detector: Detector, board: Board) -> tuple[View, float]:
    if pair.left is None or pair.right is None:
        raise ValueError("expected a pair with images")
    left, right = detector(pair.left), detector(pair.right)
    if left is not None and right is not None:
        right = same_order(board, left, right)
    seen = [(image, corners) for image, corners in ((pair.left, left), (pair.right, right)) if corners is not None]
    value = min((sharpness(as_grey(image), corners) for image, corners in seen), default=0.0)
    return View(pair.name, left, right), value


def _refuse_unseen(images: BoardImages, board: Board, rejected: Sequence[RejectedView]) -> None:
    raise InputError(f"{images.path}: expected images of a {board.name}, found it in none of {len(rejected)} pairs")
