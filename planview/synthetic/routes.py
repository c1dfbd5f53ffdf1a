"""Shortest ways over the floor around furniture and walls."""

from __future__ import annotations

import heapq

import numpy as np

from calib.types import F64, Bool

_MOVES = [(i, j, float(np.hypot(i, j))) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]


class FloorGrid:
    """Cells of a floor of which some are free to walk on.

    Attributes:
        low: (2,) centre of the first cell [m].
        cell_m: side of a cell.
        free: (X, Y), first index along x.
    """

    def __init__(self, low: F64, cell_m: float, free: Bool) -> None:
        self.low, self.cell_m, self.free = low, cell_m, free

    def index(self, point: F64) -> tuple[int, int]:
        """Cell of a point (2,), the nearest one when it is outside."""
        i, j = np.clip(np.round((np.asarray(point) - self.low) / self.cell_m), 0, np.array(self.free.shape) - 1)
        return int(i), int(j)

    def point(self, cell: tuple[int, int]) -> F64:
        """Centre (2,) of a cell."""
        return np.asarray(self.low + np.array(cell) * self.cell_m)

    def is_clear(self, a: F64, b: F64) -> bool:
        """Whether the straight way from a to b is free, but for its last 0.5 m at both ends."""
        length = float(np.linalg.norm(b - a))
        n = int(length / self.cell_m * 2)
        ts = [k / n for k in range(n + 1) if 0.5 < k / n * length < length - 0.5] if n else []
        return all(self.free[self.index(a + t * (b - a))] for t in ts)

    def route(self, a: F64, b: F64) -> list[F64] | None:
        """Points after a, the last one b, of a short free way; None when there is none (Dijkstra 1959)."""
        if self.is_clear(a, b):
            return [b]
        cells = self._search(self._nearest_free(a), self._nearest_free(b))
        return None if cells is None else self._straightened([a, *(self.point(c) for c in cells), b])

    def _nearest_free(self, point: F64) -> tuple[int, int]:
        cells = np.argwhere(self.free)
        i, j = cells[int(np.argmin(((cells - self.index(point)) ** 2).sum(axis=1)))]
        return int(i), int(j)

    def _search(self, start: tuple[int, int], goal: tuple[int, int]) -> list[tuple[int, int]] | None:
        before: dict[tuple[int, int], tuple[int, int]] = {}
        best, queue, done = {start: 0.0}, [(0.0, start)], set()
        while queue:
            far, cell = heapq.heappop(queue)
            if cell == goal:
                return self._back(before, start, goal)
            if cell in done:
                continue
            done.add(cell)
            for i, j, step in _MOVES:
                other = (cell[0] + i, cell[1] + j)
                if self._is_free(other) and far + step < best.get(other, np.inf):
                    best[other], before[other] = far + step, cell
                    heapq.heappush(queue, (far + step, other))
        return None

    def _is_free(self, cell: tuple[int, int]) -> bool:
        i, j = cell
        return 0 <= i < self.free.shape[0] and 0 <= j < self.free.shape[1] and bool(self.free[i, j])

    @staticmethod
    def _back(
        before: dict[tuple[int, int], tuple[int, int]], start: tuple[int, int], goal: tuple[int, int]
    ) -> list[tuple[int, int]]:
        cells = [goal]
        while cells[-1] != start:
            cells.append(before[cells[-1]])
        return cells[::-1]

    def _straightened(self, points: list[F64]) -> list[F64]:
        """Corners only: from each point straight to the farthest one that is in sight."""
        kept, at = [], 0
        while at < len(points) - 1:
            ahead = len(points) - 1
            while ahead > at + 1 and not self.is_clear(points[at], points[ahead]):
                ahead -= 1
            kept.append(points[ahead])
            at = ahead
        return kept
