"""The floor divided into cells."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pydantic import Field

from calib.params import Params

MAX_CELLS = 4_000_000
"""Largest map that is accepted; 4 million cells of 3 cm are a hall of 60 m x 60 m."""


class GridParams(Params):
    """Cells on the world floor."""

    cell_m: float = Field(0.04, ge=0.005, le=0.5)
    """Side of a cell [m]. Harville 2002, section 3: 2-4 cm; positions are finer, since heads are located by points;
    below 5 mm the cells of a head hold no points."""


@dataclass(frozen=True)
class Grid:
    """A rectangle of the floor in square cells: row follows y, column follows x, row 0 at y_min.

    A cell owns its lower edges: column = floor((x - x_min_m) / cell_m).

    Attributes:
        x_min_m, y_min_m: lower corner [m].
        cell_m: side of a cell [m].
        n_rows, n_cols: size of every map on this grid.
    Raises:
        ValueError: not positive, or more than MAX_CELLS cells.
    """

    x_min_m: float
    y_min_m: float
    cell_m: float
    n_rows: int
    n_cols: int

    def __post_init__(self) -> None:
        if self.cell_m <= 0 or self.n_rows < 1 or self.n_cols < 1:
            raise ValueError(f"expected positive cells and sizes, got {self.cell_m} m, {self.n_rows}x{self.n_cols}")
        if self.n_rows * self.n_cols > MAX_CELLS:
            found = f"{self.n_rows}x{self.n_cols} of {self.cell_m:g} m"
            raise ValueError(f"expected at most {MAX_CELLS} cells, got {found}: a larger maps.cell_m has fewer")

    @staticmethod
    def covering(x_min_m: float, y_min_m: float, x_max_m: float, y_max_m: float, cell_m: float) -> Grid:
        """The smallest grid from the lower corner that covers the rectangle."""
        return Grid(
            x_min_m,
            y_min_m,
            cell_m,
            max(1, math.ceil((y_max_m - y_min_m) / cell_m)),
            max(1, math.ceil((x_max_m - x_min_m) / cell_m)),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(n_rows, n_cols)."""
        return self.n_rows, self.n_cols

    @property
    def x_max_m(self) -> float:
        return self.x_min_m + self.n_cols * self.cell_m

    @property
    def y_max_m(self) -> float:
        return self.y_min_m + self.n_rows * self.cell_m

    def centre_of(self, row: float, col: float) -> tuple[float, float]:
        """World (x, y) [m] of the centre of a (fractional) cell."""
        return self.x_min_m + (col + 0.5) * self.cell_m, self.y_min_m + (row + 0.5) * self.cell_m

    def index_of(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Fractional (row, col) at which ``centre_of`` gives (x, y)."""
        return (y_m - self.y_min_m) / self.cell_m - 0.5, (x_m - self.x_min_m) / self.cell_m - 0.5

    def nearest(self, x_m: float, y_m: float) -> tuple[int, int]:
        """(row, col) of the cell at or nearest to a place."""
        row, col = self.index_of(x_m, y_m)
        return min(max(round(row), 0), self.n_rows - 1), min(max(round(col), 0), self.n_cols - 1)
