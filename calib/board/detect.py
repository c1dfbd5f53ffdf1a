"""Calibration boards: what they look like, where their corners are in images, and what a user left open about them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import cv2
import numpy as np

from calib.images import as_grey
from calib.types import F64, I64, U8

MIN_SQUARE_M = 0.002
MAX_SQUARE_M = 0.5
"""Squares outside this range are a slip of the unit: boards are held in a hand or stood in a room."""
MIN_CORNERS = 3
MAX_CORNERS = 60
"""Inner corners along a side."""
MARKER_SHARES = (0.75, 0.7, 0.8, 0.6, 0.5)
"""Usual sides of a ChArUco marker as shares of its square, the most usual first."""


@dataclass(frozen=True)
class Board:
    """A printed board. Raises ValueError: counts or sizes that no board has.

    Attributes:
        cols, rows: inner corners along a row and a column.
        square_m: side of a square [m].
        dictionary: ArUco dictionary of a ChArUco board; empty for a chessboard.
        marker_m: side of a marker [m].
        legacy: ChArUco layout of OpenCV before 4.6.
    """

    cols: int
    rows: int
    square_m: float
    dictionary: str = ""
    marker_m: float = 0.0
    legacy: bool = False

    def __post_init__(self) -> None:
        if min(self.cols, self.rows) < MIN_CORNERS or max(self.cols, self.rows) > MAX_CORNERS:
            actual = f"{self.cols}x{self.rows}"
            raise ValueError(f"expected {MIN_CORNERS} to {MAX_CORNERS} inner corners a side, found {actual}")
        if not MIN_SQUARE_M <= self.square_m <= MAX_SQUARE_M:
            raise ValueError(f"expected squares of {MIN_SQUARE_M} to {MAX_SQUARE_M} m, found {self.square_m:g} m")
        if self.dictionary and not 0 < self.marker_m < self.square_m:
            raise ValueError(f"expected markers smaller than the squares, found {self.marker_m:g} m")

    @property
    def points(self) -> F64:
        """(cols * rows, 3) corners on the board [m], row by row, z = 0."""
        col, row = np.meshgrid(np.arange(self.cols), np.arange(self.rows))
        points = np.stack([col.ravel(), row.ravel(), np.zeros(col.size)], axis=-1)
        return np.asarray(points * self.square_m)

    @property
    def name(self) -> str:
        """For messages."""
        kind = f"ChArUco ({self.dictionary})" if self.dictionary else "chessboard"
        return f"{kind} of {self.cols}x{self.rows} inner corners, {1000 * self.square_m:g} mm squares"


def dictionaries() -> dict[str, int]:
    """Names of the ArUco dictionaries of this OpenCV, with their numbers."""
    numbers = {}
    for name in dir(cv2.aruco):
        # Aliases differ in case only; keep one name for each.
        is_alias = name != name.upper() and hasattr(cv2.aruco, name.upper())
        if name.startswith("DICT_") and not is_alias:
            numbers[name] = int(getattr(cv2.aruco, name))
    return numbers


Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")


class Corners(NamedTuple):
    """Corners of the board in one image: (n,) ids into the board's points and (n, 2) pixels."""

    ids: I64
    pixels: F64


@dataclass(frozen=True, eq=False)
class BoardView:
    """Corners of the board that both images of a named pair show: (n,) ids into the board's points and (n, 2) image
    points of each camera [px]."""

    name: str
    ids: I64
    left: F64
    right: F64

    def image_points(self, side: Side) -> F64:
        """(n, 2) image points of one camera [px]."""
        return self.left if side == "left" else self.right


def common_view(name: str, left: Corners, right: Corners) -> BoardView:
    """The corners that are in both images."""
    ids, i, j = np.intersect1d(left.ids, right.ids, return_indices=True)
    return BoardView(name, np.asarray(ids, dtype=np.int64), left.pixels[i], right.pixels[j])


class Detector:
    """Finds one board in images; ``thorough`` takes the slow detector before the quick one, for images that were taken
    to show the board."""

    def __init__(self, board: Board, *, thorough: bool = True) -> None:
        self.board = board
        self.thorough = thorough
        self._charuco = None
        if board.dictionary:
            dictionary = cv2.aruco.getPredefinedDictionary(dictionaries()[board.dictionary])
            cols = board.cols + 1
            rows = board.rows + 1
            if len(dictionary.bytesList) < cols * rows // 2:
                raise ValueError(f"expected a dictionary with {cols * rows // 2} markers, found {board.dictionary}")
            charuco_board = cv2.aruco.CharucoBoard((cols, rows), board.square_m, board.marker_m, dictionary)
            charuco_board.setLegacyPattern(board.legacy)
            self._charuco = cv2.aruco.CharucoDetector(charuco_board)

    def __call__(self, image: U8) -> Corners | None:
        """All corners of a chessboard or the visible ones of a ChArUco board, to sub-pixels; None without the board."""
        grey = as_grey(image)
        if self._charuco is None:
            coarse = find_chessboard(grey, self.board.cols, self.board.rows, thorough=self.thorough)
            if coarse is None:
                return None
            return Corners(np.arange(len(coarse)), refine(grey, coarse, self.board.cols))
        pixels, numbers, _, _ = self._charuco.detectBoard(grey)
        if numbers is None:
            return None
        ids = np.asarray(numbers, dtype=np.int64).reshape(-1)
        if not spans_a_plane(self.board, ids):
            return None
        return Corners(ids, np.asarray(pixels, dtype=np.float64).reshape(-1, 2))


def spans_a_plane(board: Board, ids: I64) -> bool:
    """True if these corners show enough of the board to determine its pose: several, and not all in one line."""
    if len(ids) < 8:
        return False
    return bool(np.ptp(ids // board.cols) > 0 and np.ptp(ids % board.cols) > 0)


def find_chessboard(grey: U8, cols: int, rows: int, *, thorough: bool = True) -> F64 | None:
    """(cols * rows, 2) corners, coarse, in rows of ``cols``, in the order of a board viewed from its front. OpenCV's
    sector-based detector comes first where time allows: it finds blurred boards, and no part of a larger board."""
    image, scale = at_detection_width(grey)
    is_shown = False
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE
    if thorough:
        is_shown, pixels = cv2.findChessboardCornersSB(image, (cols, rows), flags=flags)
    if not is_shown:
        flags |= cv2.CALIB_CB_ADAPTIVE_THRESH
        if not thorough:
            flags |= cv2.CALIB_CB_FAST_CHECK
        is_shown, pixels = cv2.findChessboardCorners(image, (cols, rows), flags=flags)
    if not is_shown:
        return None
    corners = (np.asarray(pixels, dtype=np.float64).reshape(-1, 2) + 0.5) / scale - 0.5
    grid = corners.reshape(-1, cols, 2)
    along = (grid[:, -1] - grid[:, 0]).mean(axis=0)
    down = (grid[-1] - grid[0]).mean(axis=0)
    # Order without mirroring: rows must follow columns clockwise in the image, as on the board.
    is_mirrored = along[0] * down[1] - along[1] * down[0] <= 0
    if is_mirrored:
        grid = grid[:, ::-1]
    return np.ascontiguousarray(grid.reshape(-1, 2))


def at_detection_width(grey: U8) -> tuple[U8, float]:
    """The image at a width at which OpenCV's detectors find squares of some 20 pixels in good time, and its scale
    against the original. Corners are refined at full size."""
    width = grey.shape[1]  # [px]
    low = 640
    high = 1280
    if width < low:
        scale = float(math.ceil(low / width))
        interpolation = cv2.INTER_CUBIC
    elif width > high:
        scale = high / width
        interpolation = cv2.INTER_AREA
    else:
        return grey, 1.0
    resized = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=interpolation)
    return np.asarray(resized, dtype=np.uint8), scale


def refine(grey: U8, corners: F64, cols: int) -> F64:
    """Sub-pixel corners, the window following the size of the squares."""
    grid = corners.reshape(-1, cols, 2)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=2).min()
    down = np.linalg.norm(np.diff(grid, axis=0), axis=2).min()
    # Half the refinement window as a share of the corner distance: no other corner may reach into the window, and
    # larger windows average more noise. Measured on OpenCV's pairs: 0.25 gives 0.20 px, 0.4 already 0.24 px.
    half = int(np.clip(0.25 * min(across, down), 2, 15))
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    start = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    moved = cv2.cornerSubPix(grey, start.copy(), (half, half), (-1, -1), criteria)
    return np.asarray(moved, dtype=np.float64).reshape(-1, 2)


def same_order(board: Board, left: Corners, right: Corners) -> Corners:
    """The right corners in the order of the left ones: a chessboard looks the same when turned by half (a square one by
    a quarter), and in two cameras side by side it is turned nearly alike."""
    if board.dictionary:
        return right
    grid = right.pixels.reshape(board.rows, board.cols, 2)
    turns = [grid, grid[::-1, ::-1]]
    if board.rows == board.cols:
        turns += [np.rot90(grid, 1), np.rot90(grid, 3)]
    left_shape = left.pixels - left.pixels.mean(axis=0)
    orders = [turn.reshape(-1, 2) for turn in turns]
    distances = [np.linalg.norm(order - grid.mean(axis=(0, 1)) - left_shape) for order in orders]
    nearest = int(np.argmin(distances))
    return Corners(right.ids, np.ascontiguousarray(orders[nearest]))


def find_counts(images: Iterable[U8]) -> tuple[int, int] | None:
    """Inner corners (more, fewer) of the chessboard in the images, None without one.

    A small pattern is grown as far as it goes in each image, and the largest size that is in most images wins, since
    parts of a board are found as well, and an edge of the board can look like another row of squares in a few.
    """
    greys = [as_grey(image) for image in images]
    votes = Counter[tuple[int, int]]()
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    for grey in greys:
        image = at_detection_width(grey)[0]
        is_shown, _, meta = cv2.findChessboardCornersSBWithMeta(image, (MIN_CORNERS, MIN_CORNERS), flags)
        if is_shown and meta is not None and meta.ndim == 2 and meta.size > MIN_CORNERS**2:
            votes[max(meta.shape), min(meta.shape)] += 1
    # The most frequent sizes. One in a single image is chance: small ones are found in noise.
    candidates = [size for size, count in votes.most_common(4) if count >= 2]
    if not candidates:
        return None
    if len(votes) < 2:
        return candidates[0]
    candidates.sort(key=lambda size: -size[0] * size[1])
    counts = {}
    for size in candidates:
        counts[size] = sum(find_chessboard(grey, *size) is not None for grey in greys)
        if 2 * counts[size] > len(greys):
            return size
    return max(candidates, key=lambda size: counts[size])


def larger_counts(images: Iterable[U8], given: tuple[int, int]) -> tuple[int, int] | None:
    """Inner corners (more, fewer) of the chessboard that the given one is only a part of; None when it is whole."""
    greys = [as_grey(image) for image in images]
    given = max(given), min(given)
    counts = find_counts(greys)
    if counts is None or counts == given or counts[0] < given[0] or counts[1] < given[1]:
        return None
    # The detector that is not content with parts of a board must show the whole one at least as often as the part.
    whole = 0
    part = 0
    for grey in greys:
        image = at_detection_width(grey)[0]
        whole += cv2.findChessboardCornersSB(image, counts, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)[0]
        part += cv2.findChessboardCornersSB(image, given, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)[0]
    return counts if whole >= max(1, part) else None


def complete_charuco(board: Board, images: Sequence[U8], *, any_dictionary: bool, any_marker: bool) -> Board:
    """The ChArUco board with the dictionary, marker size and layout that find most in a few images."""
    greys = [as_grey(image) for image in images[:3]]

    def count_corners(candidate: Board) -> int:
        detector = Detector(candidate)
        count = 0
        for grey in greys:
            corners = detector(grey)
            if corners is not None:
                count += len(corners.ids)
        return count

    if any_dictionary:
        n_markers = (board.cols + 1) * (board.rows + 1) // 2
        numbers = dictionaries()
        # Of the dictionaries of a family, which begin with the same markers, the first.
        names = sorted(numbers, key=lambda name: numbers[name])
        best = max(names, key=lambda name: _count_markers(numbers[name], greys, n_markers))
        board = replace(board, dictionary=best)
    board = max(replace(board, legacy=False), replace(board, legacy=True), key=count_corners)
    if not any_marker:
        return board
    sizes = [replace(board, marker_m=share * board.square_m) for share in MARKER_SHARES]
    return max(sizes, key=count_corners)


def _count_markers(dictionary: int, greys: Sequence[U8], n_markers: int) -> int:
    """Number of markers of a dictionary in the images, of those that the board can hold."""
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(dictionary))
    count = 0
    for grey in greys:
        ids = detector.detectMarkers(grey)[1]
        if ids is not None:
            unique = np.unique(ids)
            count += int((unique < n_markers).sum())
    return count
