"""What a user left open about a board, found in the images: a chessboard's counts, a ChArUco board's markers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

import cv2
import numpy as np

from calib.board.detect import Detector, at_detection_width, find_chessboard
from calib.board.pattern import MARKER_SHARES, MIN_CORNERS, Board, dictionaries
from calib.images import as_grey
from calib.types import U8

_TRIAL_IMAGES = 3
_TRIAL_COUNTS = 4
"""Counts that are tried on all images, the most frequent ones."""
_MIN_VOTES = 2
"""A size that is found in a single image is chance: small ones are found in noise."""


def find_counts(images: Iterable[U8]) -> tuple[int, int] | None:
    """Inner corners (more, fewer) of the chessboard in the images, None when none is found.

    A small pattern is grown as far as it goes in each image. Of the sizes so found the largest that is in most images
    wins: parts of a board are found as well, and an edge of the board can look like another row of squares in a few.
    """
    greys = [as_grey(image) for image in images]
    votes = Counter(size for grey in greys if (size := _grown(grey)) is not None)
    tried = [size for size, count in votes.most_common(_TRIAL_COUNTS) if count >= _MIN_VOTES]
    if len(votes) < 2 or not tried:
        return tried[0] if tried else None
    tried.sort(key=lambda size: -size[0] * size[1])
    found = {size: _images_with(greys, size) for size in tried}
    return next((size for size in tried if 2 * found[size] > len(greys)), max(tried, key=lambda size: found[size]))


def larger_counts(images: Iterable[U8], given: tuple[int, int]) -> tuple[int, int] | None:
    """Inner corners (more, fewer) of the chessboard that the given one is only a part of; None when it is whole.

    Left and right images of a part of a board need not show the same part.
    """
    greys = [as_grey(image) for image in images]
    given = max(given), min(given)
    found = find_counts(greys)
    if found is None or found == given or found[0] < given[0] or found[1] < given[1]:
        return None
    # The whole board is found exactly, and at least as often as the part.
    whole, part = (_exactly(greys, size) for size in (found, given))
    return found if whole >= max(1, part) else None


def _grown(grey: U8) -> tuple[int, int] | None:
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    found, _, meta = cv2.findChessboardCornersSBWithMeta(at_detection_width(grey)[0], (MIN_CORNERS, MIN_CORNERS), flags)
    if not found or meta is None or meta.ndim != 2:
        return None
    rows, cols = (int(n) for n in meta.shape)
    return (max(rows, cols), min(rows, cols)) if rows * cols > MIN_CORNERS**2 else None


def _images_with(greys: Sequence[U8], size: tuple[int, int]) -> int:
    return sum(find_chessboard(grey, *size) is not None for grey in greys)


def _exactly(greys: Sequence[U8], size: tuple[int, int]) -> int:
    """Images in which the detector that is not content with parts of a board finds it."""
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE
    return sum(bool(cv2.findChessboardCornersSB(at_detection_width(grey)[0], size, flags=flags)[0]) for grey in greys)


def complete_charuco(board: Board, images: Sequence[U8], *, any_dictionary: bool, any_marker: bool) -> Board:
    """The ChArUco board with the dictionary, marker size and layout that find most in a few images."""
    greys = [as_grey(image) for image in images[:_TRIAL_IMAGES]]
    if any_dictionary:
        wanted = (board.cols + 1) * (board.rows + 1) // 2
        name = max(dictionaries(), key=lambda name: (_markers(name, wanted, greys), -dictionaries()[name]))
        board = replace(board, dictionary=name)
    board = max((replace(board, legacy=legacy) for legacy in (False, True)), key=lambda one: _found(one, greys))
    if not any_marker:
        return board
    sizes = [replace(board, marker_m=share * board.square_m) for share in MARKER_SHARES]
    return max(sizes, key=lambda one: _found(one, greys))


def _markers(dictionary: str, wanted: int, greys: Sequence[U8]) -> int:
    """Markers of a dictionary in the images whose ids a board with so many of them can hold."""
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(dictionaries()[dictionary]))
    found = 0
    for grey in greys:
        _, ids, _ = detector.detectMarkers(grey)
        found += 0 if ids is None else len({int(i) for i in np.asarray(ids).ravel() if i < wanted})
    return found


def _found(board: Board, images: Sequence[U8]) -> int:
    detector = Detector(board)
    return sum(len(corners.ids) for image in images if (corners := detector(image)) is not None)
