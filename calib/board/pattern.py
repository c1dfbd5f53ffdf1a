"""Calibration boards: what they look like, and how a user names them."""

from __future__ import annotations

import re
from dataclasses import dataclass

import cv2
import numpy as np

from calib.errors import InputError
from calib.length import parse_length
from calib.types import F64

MIN_SQUARE_M, MAX_SQUARE_M = 0.002, 0.5
"""Squares outside this range are a slip of the unit: boards are held in a hand or stood in a room (our choice)."""
MIN_CORNERS, MAX_CORNERS = 3, 60
"""Inner corners along a side."""
MARKER_SHARES = (0.75, 0.7, 0.8, 0.6, 0.5)
"""Usual sides of a ChArUco marker as shares of its square, the most usual first."""
_BARE_NUMBER = re.compile(r"\s*\d+([.,]\d*)?\s*")


@dataclass(frozen=True)
class Board:
    """A printed board.

    Attributes:
        cols, rows: inner corners along a row and a column.
        square_m: side of a square [m].
        dictionary: ArUco dictionary of a ChArUco board; empty for a chessboard.
        marker_m: side of a marker [m].
        legacy: ChArUco layout of OpenCV before 4.6.
    Raises:
        ValueError: counts or sizes that no board has.
    """

    cols: int
    rows: int
    square_m: float
    dictionary: str = ""
    marker_m: float = 0.0
    legacy: bool = False

    def __post_init__(self) -> None:
        if not all(MIN_CORNERS <= n <= MAX_CORNERS for n in (self.cols, self.rows)):
            raise ValueError(
                f"expected {MIN_CORNERS} to {MAX_CORNERS} inner corners a side, found {self.cols}x{self.rows}"
            )
        if not MIN_SQUARE_M <= self.square_m <= MAX_SQUARE_M:
            raise ValueError(f"expected squares of {MIN_SQUARE_M} to {MAX_SQUARE_M} m, found {self.square_m:g} m")
        if self.dictionary and not 0 < self.marker_m < self.square_m:
            raise ValueError(f"expected markers smaller than the squares, found {self.marker_m:g} m")

    @property
    def points(self) -> F64:
        """(cols * rows, 3) corners on the board [m], row by row, z = 0."""
        col, row = np.meshgrid(np.arange(self.cols), np.arange(self.rows))
        points = np.stack([col.ravel(), row.ravel(), np.zeros(col.size)], axis=-1)
        return np.asarray(points * self.square_m, dtype=np.float64)

    @property
    def name(self) -> str:
        """For messages."""
        kind = f"ChArUco ({self.dictionary})" if self.dictionary else "chessboard"
        return f"{kind} of {self.cols}x{self.rows} inner corners, {1000 * self.square_m:g} mm squares"


def parse_square(text: str) -> float:
    """Side of a square [m].

    Raises:
        InputError: a bare number, which could be millimetres as well as metres, or what is no length at all.
    """
    if _BARE_NUMBER.fullmatch(text):
        raise InputError(
            f"--square: expected the side of a square with its unit, found {text!r} without one: "
            f"type --square {text.strip()}mm if these are millimetres"
        )
    return parse_length(text, "--square")


def parse_board(text: str | None, square_m: float, marker: str | None, dictionary: str | None) -> Board | None:
    """A board from what the user typed.

    Args:
        text: ``9x6`` (inner corners), ``charuco:8x6`` (squares), or None to find a chessboard's counts in the images.
        square_m: side of a square [m].
        marker: side of a ChArUco marker with its unit, None to try usual ones.
        dictionary: e.g. ``DICT_4X4_50``; None to try all.
    Returns:
        The board; None when the counts are to be found. A ChArUco board with an empty dictionary or marker size 0 is
        completed by ``complete_charuco``.
    Raises:
        InputError: text that describes no board.
    """
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


def dictionaries() -> dict[str, int]:
    """Names of the ArUco dictionaries this OpenCV knows, with their numbers."""
    found = {name: int(getattr(cv2.aruco, name)) for name in dir(cv2.aruco) if name.startswith("DICT_")}
    # Aliases differ in case only; keep one name for each.
    return {name: number for name, number in found.items() if name.upper() == name or name.upper() not in found}
