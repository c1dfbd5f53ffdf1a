"""The room of a random scene while it is being filled: what the camera views, what is free, ways around things."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from benchmarks.random_scenes.challenge import Challenge
from calib.types import F64, Bool
from planview.synthetic.camera import View, camera_view, mount_pose, stereo_rig
from planview.synthetic.motion import Obstacles
from planview.synthetic.scene import Furniture, Opening, Panel, Rig, Room, Surface

CELL_M = 0.15
MIN_RANGE_M = 1.3
"""Horizontal distance that people keep from a camera on the wall [m]."""
_FLOORS = (
    ("tiles", "#a39a8a"),
    ("wood", "#b98f5f"),
    ("carpet", "#5c6a78"),
    ("carpet", "#786858"),
    ("concrete", "#8f959a"),
)


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
        """Points after a, the last one b, of a short free way; None when there is none."""
        if self.is_clear(a, b):
            return [b]
        cells = self._cells_between(self._nearest_free(a), self._nearest_free(b))
        if not cells:
            return None
        # Corners only: from each point straight to the farthest one that is in sight.
        points, corners, at = [a, *(self.point(c) for c in cells), b], [], 0
        while at < len(points) - 1:
            ahead = len(points) - 1
            while ahead > at + 1 and not self.is_clear(points[at], points[ahead]):
                ahead -= 1
            corners.append(points[ahead])
            at = ahead
        return corners

    def _nearest_free(self, point: F64) -> tuple[int, int]:
        cells = np.argwhere(self.free)
        i, j = cells[int(np.argmin(((cells - self.index(point)) ** 2).sum(axis=1)))]
        return int(i), int(j)

    def _cells_between(self, start: tuple[int, int], goal: tuple[int, int]) -> list[tuple[int, int]]:
        """The cells of the shortest way over free cells (Dijkstra 1959), empty when there is none."""
        shape = self.free.shape
        numbers = np.arange(self.free.size).reshape(shape)
        edges: list[F64] = []
        for i, j in ((0, 1), (1, 0), (1, 1), (1, -1)):
            here = slice(None, shape[0] - i), slice(max(0, -j), shape[1] - max(0, j))
            there = slice(i, None), slice(max(0, j), shape[1] + min(0, j))
            free = self.free[here] & self.free[there]
            pairs = numbers[here][free], numbers[there][free]
            edges.append(np.stack([*pairs, np.full(len(pairs[0]), math.hypot(i, j))]))
        one, other, length = np.concatenate(edges, axis=1)
        graph = coo_array((length, (one.astype(int), other.astype(int))), shape=(self.free.size,) * 2).tocsr()
        _, before = dijkstra(graph, directed=False, indices=numbers[start], return_predecessors=True)
        cells, at = [goal], int(numbers[goal])
        while at != numbers[start]:
            at = int(before[at])
            if at < 0:
                return []
            cells.append((at // shape[1], at % shape[1]))
        return cells[::-1]


_POSTERS = ("#7a3030", "#305070", "#28607a", "#5a7a30", "#805a20")


class NoPlaceError(Exception):
    """The random room, camera and people do not fit; another draw may."""


class Stage:
    """A room, its rig, and what has been put into it so far.

    Attributes:
        rng: decides everything.
        room, rig: as they go into the scene.
        furniture: put so far.
        grid: free floor, corridors behind the openings included.
    """

    def __init__(self, challenge: Challenge, rng: np.random.Generator) -> None:
        self.challenge, self.rng = challenge, rng
        self.room, self.rig = _room(challenge, rng), _rig(challenge, rng)
        self.furniture: list[Furniture] = []
        self._view: View = camera_view(stereo_rig(self.rig).left, mount_pose(self.rig))
        self._lanes = {"west": 0, "east": 0}
        self._reserved: list[tuple[F64, float]] = []
        self._prepare()

    def _prepare(self) -> None:
        """Free cells and the ones in view, after walls, furniture and reserved places."""
        sx, sy, _ = self.room.size_m
        low = np.array([-2.25, 0.3])
        shape = int((sx + 4.5) / CELL_M) + 1, int((sy - 0.3) / CELL_M) + 1
        cells = low + CELL_M * np.stack(np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij"), -1)
        points = cells.reshape(-1, 2)
        # Distance of ways and places from walls and furniture [m]: half a shoulder width and a hand.
        free = Obstacles(self.room, self.furniture).distance(points) > 0.42
        for centre, radius in self._reserved:
            free &= np.linalg.norm(points - centre, axis=1) > radius
        if not self.is_overhead:
            free &= np.linalg.norm(points - self.camera_xy, axis=1) > MIN_RANGE_M - 0.3
        inside = ((points > 0.3) & (points < [sx - 0.3, sy - 0.3])).all(axis=1)
        self.grid = FloorGrid(low, CELL_M, free.reshape(shape))
        self._points, self._spots = points, free & self.in_view(points) & inside

    @property
    def is_overhead(self) -> bool:
        return self.rig.tilt_deg < 20

    @property
    def camera_xy(self) -> F64:
        return np.array(self.rig.at_m[:2])

    def in_view(self, points: F64) -> Bool:
        """(N,) whether people at points (N, 2) are in the left image and near enough for stereo."""
        result = np.ones(len(points), np.bool_)
        # Share of the image's width that does not count as in view.
        border = 0.04 * self.rig.width
        # Both these heights of a place must be in the image for the place to count as in view.
        for z in (0.9, 1.75):
            room = np.column_stack([points, np.full(len(points), z)])
            camera = self._view.room_SE3_camera.inverse() @ room
            with np.errstate(all="ignore"):
                uv = self._view.project(camera)
            size = np.array([self.rig.width, self.rig.height])
            with np.errstate(invalid="ignore"):
                result &= ((uv > border) & (uv < size - 1 - border)).all(axis=1) & (camera[:, 2] > 0.3)
            # People stay near enough for this disparity; farther away stereo of the paper's image size is too coarse.
            result &= camera[:, 2] < self.rig.focal_px * self.rig.baseline_m / 4.0
        if not self.is_overhead:
            result &= np.linalg.norm(points - self.camera_xy, axis=1) > MIN_RANGE_M
        return result

    def spots(self, radius_m: float = 0.0) -> F64:
        """(N, 2) places in view around which a disc is free and in view. Raises NoPlaceError: there is none."""
        good, bad = self._points[self._spots], self._points[~self._spots]
        if radius_m > 0 and len(good):
            gap = np.array([np.min(((bad - p) ** 2).sum(axis=1)) for p in good])
            good = good[gap > radius_m**2]
        if len(good) == 0:
            raise NoPlaceError(f"no place of {radius_m} m in view")
        return np.asarray(good)

    def spot(self, radius_m: float = 0.0, *, reserve: bool = True) -> F64:
        """A random place (2,) of that radius, reserved unless ``reserve`` is false."""
        good = self.spots(radius_m)
        place = good[int(self.rng.integers(len(good)))]
        if reserve:
            self.reserve(place, radius_m)
        return np.asarray(place)

    def reserve(self, place: F64, radius_m: float) -> None:
        """Keep others' ways and places out of a disc."""
        self._reserved.append((np.asarray(place), radius_m))
        self._prepare()

    def put(self, **values: Any) -> Furniture:
        """Furniture from its table, as ``[[furniture]]`` of a scene."""
        item = Furniture.model_validate(values)
        self.furniture.append(item)
        self._prepare()
        return item

    def route(self, a: F64, b: F64) -> list[F64]:
        """A way around walls, furniture and reserved places (``FloorGrid.route``)."""
        way = self.grid.route(np.asarray(a, np.float64), np.asarray(b, np.float64))
        if way is None:
            raise NoPlaceError("no way")
        return way

    def door(self, side: str) -> tuple[F64, F64, F64]:
        """A hidden place (2,) outside an opening, a place behind it and one in it, in a lane of its own."""
        opening = next(o for o in self.room.openings if o.wall == side)
        k = self._lanes[side]
        self._lanes[side] += 1
        lane = opening.from_m + opening.width_m * (0.25, 0.75, 0.5)[k % 3]
        sx = self.room.size_m[0]
        hidden, behind, inside = (-2.1, opening.from_m - 0.9), (-0.9, lane), (0.35, lane)
        points = [np.array(p) for p in (hidden, behind, inside)]
        if side == "east":
            points = [np.array([sx - x, y]) for x, y in points]
        return points[0], points[1], points[2]

    def side(self) -> str:
        """The opening for the next person."""
        return str(self.rng.choice(("west", "east")))

    def rectangle(self) -> tuple[float, float, float, float]:
        """A large rectangle x_min, y_min, x_max, y_max of the floor that is nearly all in view."""
        good, best = self.spots(), None
        for _ in range(400):
            a, b = good[self.rng.integers(len(good), size=2)]
            low, high = np.minimum(a, b), np.maximum(a, b)
            n = np.prod(np.round((high - low) / CELL_M) + 1)
            inside = ((good >= low - 1e-6) & (good <= high + 1e-6)).all(axis=1).sum()
            if inside >= 0.9 * n and (best is None or n > best[0]):
                best = (n, low, high)
        if best is None:
            raise NoPlaceError("no floor in view")
        return (*map(float, best[1]), *map(float, best[2]))  # type: ignore[return-value]


def _room(challenge: Challenge, rng: np.random.Generator) -> Room:
    size = challenge.room
    walls = []
    for wall in ("west", "east"):
        width = float(rng.uniform(2.2, 2.8))
        at = float(np.clip(rng.uniform(0.3, 0.6) * size.depth_m - width / 2 + 0.4, 1.1, size.depth_m - width - 0.5))
        walls.append(Opening(wall=wall, from_m=at, width_m=width))
    texture, colour = _FLOORS[int(rng.integers(len(_FLOORS)))]
    panels = []
    for x in rng.uniform((0.05, 0.55), (0.35, 0.8)):
        width_m, colour2 = float(rng.uniform(0.7, 1.3)), str(rng.choice(_POSTERS))
        scale_m = float(rng.uniform(0.12, 0.25))
        poster = Surface(texture="poster", colour="#e0d8c8", colour2=colour2, scale_m=scale_m)
        panels.append(Panel(wall="north", from_m=float(x * size.width_m), width_m=width_m, surface=poster))
    return Room(
        size_m=(size.width_m, size.depth_m, size.height_m),
        floor=Surface(texture=texture, colour=colour, scale_m=float(rng.uniform(0.15, 0.5)),
                      contrast=float(rng.uniform(0.15, 0.4)), gloss=float(rng.choice((0.0, 0.0, 0.06)))),
        walls=Surface(colour=str(rng.choice(("#d8d4c8", "#cfd6d8", "#dcd2c0"))), scale_m=0.8, contrast=0.06),
        openings=tuple(walls),
        panels=tuple(panels),
    )  # fmt: skip


def _rig(challenge: Challenge, rng: np.random.Generator) -> Rig:
    camera, room = challenge.camera, challenge.room
    is_overhead = camera.tilt_deg < 20
    y = room.depth_m * 0.5 if is_overhead else 0.2
    x = room.width_m * 0.5 + rng.uniform(-0.1, 0.1) * room.width_m
    k1 = -0.12 * rng.uniform(0.3, 1.2)
    small = rng.uniform(-0.3, 0.3, 3)
    return Rig(
        at_m=(float(x), float(y), camera.height_m),
        heading_deg=90.0 + float(rng.uniform(-10, 10)),
        tilt_deg=camera.tilt_deg,
        roll_deg=camera.roll_deg,
        width=camera.width,
        height=camera.height,
        focal_px=camera.focal_px,
        baseline_m=camera.baseline_m,
        right_rotation_deg=(float(small[0]), float(small[1]), float(small[2])),
        centre_offset_px=(float(rng.uniform(-4, 4)), float(rng.uniform(-4, 4))),
        distortion=(
            float(k1),
            float(-0.25 * k1),
            float(rng.uniform(-5e-4, 5e-4)),
            float(rng.uniform(-5e-4, 5e-4)),
            0.0,
        ),
    )
