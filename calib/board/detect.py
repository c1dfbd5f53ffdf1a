"""Where the corners of a board are in an image."""

from __future__ import annotations

import math

import cv2
import numpy as np

from calib.board.model import Corners
from calib.board.pattern import Board, dictionaries
from calib.images import as_grey
from calib.types import F64, I64, U8

_MIN_WIDTH, _MAX_WIDTH = 640, 1280
"""Boards are looked for in images of such widths [px], smaller ones enlarged and larger ones reduced: OpenCV's
detectors want squares of some 20 pixels, and take seconds for large images. Corners are refined at full size."""
_WINDOW_SHARE = 0.25
"""Half the refinement window as a share of the corner distance: no other corner may reach into the window, and
larger windows average more noise. Measured on OpenCV's pairs: 0.25 gives 0.20 px, 0.4 already 0.24 px."""
_MAX_WINDOW_PX = 15
_MIN_CORNERS = 8


class Detector:
    """Finds one board in images.

    Attributes:
        board: what to look for.
        thorough: take the slow detector before the quick one; for images that were taken to show the board.
    """

    def __init__(self, board: Board, *, thorough: bool = True) -> None:
        self.board = board
        self.thorough = thorough
        self._charuco = _charuco_detector(board) if board.dictionary else None

    def __call__(self, image: U8) -> Corners | None:
        """Corners of the board with sub-pixel accuracy.

        Args:
            image: (H, W) or (H, W, 3) uint8.
        Returns:
            Corners; all of a chessboard's or the visible ones of a ChArUco board; None when the board is not there.
        """
        grey = as_grey(image)
        return self._find_chessboard(grey) if self._charuco is None else self._find_charuco(grey)

    def _find_chessboard(self, grey: U8) -> Corners | None:
        pixels = find_chessboard(grey, self.board.cols, self.board.rows, thorough=self.thorough)
        if pixels is None:
            return None
        return Corners(np.arange(len(pixels)), refine(grey, pixels, self.board.cols))

    def _find_charuco(self, grey: U8) -> Corners | None:
        corners, ids, _, _ = self._charuco.detectBoard(grey)  # type: ignore[union-attr]
        if ids is None:
            return None
        found = np.asarray(ids, dtype=np.int64).reshape(-1)
        if not spans_a_plane(self.board, found):
            return None
        return Corners(found, np.asarray(corners, dtype=np.float64).reshape(-1, 2))


def spans_a_plane(board: Board, ids: I64) -> bool:
    """Whether these corners are enough of the board to tell its pose: several, and not all in one line."""
    lines = ids // board.cols, ids % board.cols
    return len(ids) >= _MIN_CORNERS and all(len(set(line)) > 1 for line in lines)


def find_chessboard(grey: U8, cols: int, rows: int, *, thorough: bool = True) -> F64 | None:
    """(cols * rows, 2) corners, coarse, in rows of ``cols``, in the order of a board viewed from its front.

    OpenCV's sector-based detector comes first where time allows: it finds blurred boards, and is not content with a
    part of a larger board, which the older one is.
    """
    sized, scale = at_detection_width(grey)
    found, pixels = False, None
    if thorough:
        found, pixels = cv2.findChessboardCornersSB(sized, (cols, rows), flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        quick = 0 if thorough else cv2.CALIB_CB_FAST_CHECK
        found, pixels = cv2.findChessboardCorners(sized, (cols, rows), flags=flags | quick)
    if not found or pixels is None:
        return None
    corners = (np.asarray(pixels, dtype=np.float64).reshape(-1, 2) + 0.5) / scale - 0.5
    return _facing(corners, cols)


def at_detection_width(grey: U8) -> tuple[U8, float]:
    """The image at a width that OpenCV's detectors like, and how many times larger it is now."""
    width = grey.shape[1]
    if _MIN_WIDTH <= width <= _MAX_WIDTH:
        return grey, 1.0
    scale = float(math.ceil(_MIN_WIDTH / width)) if width < _MIN_WIDTH else _MAX_WIDTH / width
    how = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    return np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=how), dtype=np.uint8), scale


def _facing(corners: F64, cols: int) -> F64:
    """Order without mirroring: rows must follow columns clockwise in the image, as on the board."""
    grid = corners.reshape(-1, cols, 2)
    along = (grid[:, -1] - grid[:, 0]).mean(axis=0)
    down = (grid[-1] - grid[0]).mean(axis=0)
    turned = grid if along[0] * down[1] - along[1] * down[0] > 0 else grid[:, ::-1]
    return np.ascontiguousarray(turned.reshape(-1, 2))


def refine(grey: U8, corners: F64, cols: int) -> F64:
    """Sub-pixel corners, the window following the size of the squares."""
    grid = corners.reshape(-1, cols, 2)
    apart = min(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1))
    half = int(np.clip(_WINDOW_SHARE * apart, 2, _MAX_WINDOW_PX))
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    start = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    moved = cv2.cornerSubPix(grey, start.copy(), (half, half), (-1, -1), criteria)
    return np.asarray(moved, dtype=np.float64).reshape(-1, 2)


def same_order(board: Board, left: Corners, right: Corners) -> Corners:
    """The right corners in the order of the left ones.

    A chessboard looks the same when turned by half (a square one by a quarter), so that each image's order is a guess;
    in two cameras side by side it is turned nearly alike.
    """
    if board.dictionary:
        return right
    grid = right.pixels.reshape(board.rows, board.cols, 2)
    turns = [grid, grid[::-1, ::-1]]
    if board.rows == board.cols:
        turns += [np.rot90(grid, 1), np.rot90(grid, 3)]
    centred = left.pixels - left.pixels.mean(axis=0)
    away = [np.linalg.norm(t.reshape(-1, 2) - grid.mean(axis=(0, 1)) - centred) for t in turns]
    return Corners(right.ids, np.ascontiguousarray(turns[int(np.argmin(away))].reshape(-1, 2)))


def _charuco_detector(board: Board) -> cv2.aruco.CharucoDetector:
    dictionary = cv2.aruco.getPredefinedDictionary(dictionaries()[board.dictionary])
    squares = (board.cols + 1, board.rows + 1)
    if len(dictionary.bytesList) < squares[0] * squares[1] // 2:
        raise ValueError(f"expected a dictionary with {squares[0] * squares[1] // 2} markers, found {board.dictionary}")
    made = cv2.aruco.CharucoBoard(squares, board.square_m, board.marker_m, dictionary)
    made.setLegacyPattern(board.legacy)
    return cv2.aruco.CharucoDetector(made)
