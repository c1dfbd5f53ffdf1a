"""How people, floors and light of random scenes look, and the room of a challenge while it is being filled: what the
camera views, what is free, ways around things."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from benchmarks.random_scenes.tables import Challenge, LightTable, NoPlaceError
from calib.types import F64, Bool
from planview.synthetic.camera import CameraView, camera_view, mount_pose, stereo_rig
from planview.synthetic.room import Obstacles
from planview.synthetic.scene import Furniture, Opening, Panel, Rig, Room, Surface, Triple

SHIRTS = ("#3a5a8a", "#b04838", "#3c6a4a", "#c8b8a0", "#24282c", "#d9a441", "#c05878", "#e0e0d8", "#6a4a8a", "#3878a0",
          "#8a5a3c", "#a8b4c0")  # fmt: skip
TROUSERS = ("#2f3e58", "#3a3a44", "#55504a", "#6a5a44", "#24242a", "#46586e", "#8a7a60", "#403848")
SKIN = ("#d0a080", "#e0b898", "#b98560", "#8a5a3c", "#6a4430")
HAIR = ("#1c1a18", "#3a2a1c", "#6b4423", "#b08848", "#787470", "#c8c4bc")
TEXTURES = ("plain", "plain", "stripes", "checks", "print")
FLOORS = (("tiles", "#a39a8a"), ("wood", "#b98f5f"), ("carpet", "#5c6a78"), ("carpet", "#786858"),
          ("concrete", "#8f959a"))  # fmt: skip
EXPOSURE_DELAY_S = 0.7
"""Time constant with which an automatic exposure follows the light. Webcams take 0.5 to 1 s."""


def clothes(rng: np.random.Generator) -> dict[str, Any]:
    """Shirt and trousers of a person."""
    main, second = (str(c) for c in rng.choice(SHIRTS, 2, replace=False))
    shirt: dict[str, Any] = {"texture": str(rng.choice(TEXTURES)), "colour": main, "colour2": second}
    shirt |= {"scale_m": float(rng.uniform(0.05, 0.12)), "contrast": float(rng.uniform(0.2, 0.35))}
    trousers = {"colour": str(rng.choice(TROUSERS)), "scale_m": 0.05, "contrast": float(rng.uniform(0.15, 0.3))}
    return {"shirt": shirt, "trousers": trousers, "skirt": bool(rng.random() < 0.15)}


def looks(rng: np.random.Generator, height_m: float) -> dict[str, Any]:
    """All of a person but clothes and movement."""
    return {
        "height_m": float(height_m),
        "build": float(rng.uniform(0.88, 1.2)),
        "skin": str(rng.choice(SKIN)),
        "hair": str(rng.choice(HAIR)),
        "hair_style": str(rng.choice(("short", "short", "long", "bald"))) if height_m > 1.3 else "short",
        "sleeves": str(rng.choice(("long", "short"))),
    }


def floor_surface(rng: np.random.Generator, gloss: float) -> dict[str, Any]:
    """A floor that mirrors this share of the light."""
    texture, colour = FLOORS[int(rng.integers(len(FLOORS)))]
    scale_m, contrast = float(rng.uniform(0.15, 0.5)), float(rng.uniform(0.12, 0.38))
    return {"texture": texture, "colour": colour, "scale_m": scale_m, "contrast": contrast, "gloss": gloss}


def lights_and_sensor(
    light: LightTable, room_m: Triple, duration_s: float, rng: np.random.Generator
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Lights of a room of this size and the sensor, as tables of a scene."""
    width, depth, height = room_m
    lamps: list[dict[str, Any]] = []
    for k in range(light.lamps):
        x = width * (k + 0.5) / light.lamps + rng.uniform(-0.4, 0.4)
        # A lamp's level is that 2 m away: high ones are brighter. One lamp throws the shadows that show; those of the
        # others cost as much time and are filled by the first.
        level = float(rng.uniform(0.3, 0.55)) * max(1.0, (height / 2.8) ** 2)
        at_m = (x, depth * rng.uniform(0.35, 0.8), height - 0.1)
        lamps.append({"at_m": at_m, "level": level, "shadows": k == 0})
    if light.sun:
        towards = (float(rng.choice((-1, 1)) * rng.uniform(0.5, 1)), rng.uniform(-0.2, 0.5), -rng.uniform(0.45, 0.8))
        lamps.append({"kind": "sun", "towards": towards, "level": float(rng.uniform(0.6, 0.9)), "softness_deg": 0.6})
    for _ in range(light.changes if lamps else 0):
        lamp = lamps[int(rng.integers(len(lamps)))]
        start = float(rng.uniform(0.15, 0.75) * duration_s)
        ramp, stay, level = float(rng.choice((0.07, 0.5, 2.0))), float(rng.uniform(3, 8)), float(rng.uniform(0.15, 0.6))
        dark, on_again = start + ramp, start + ramp + stay
        lamp.setdefault("dim", ((start, 1.0), (dark, level), (on_again, level), (on_again + ramp, 1.0)))
    lights = {"ambient": light.ambient, "lamps": lamps}
    sensor: dict[str, Any] = {
        "brightness": light.brightness or float(rng.uniform(0.2, 0.3)),
        "full_well_e": light.full_well_e or float(rng.uniform(6000, 16000)),
        "blur_px": light.blur_px,
        "vignetting": float(rng.uniform(0.1, 0.3)),
        "mismatch": float(rng.uniform(0.0, 0.03)),
    }
    if light.automatic_exposure:
        sensor["exposure"] = automatic_exposure(lights, duration_s)
    return lights, sensor


def automatic_exposure(lights: dict[str, Any], duration_s: float) -> tuple[tuple[float, float], ...]:
    """Keyframes of the exposure that holds the room's mean level, following it with EXPOSURE_DELAY_S.

    The mean level is taken to be that of the ambient light and the lamps' levels together.
    """
    times = np.arange(0.0, duration_s, 0.1)
    total = np.full(len(times), float(lights["ambient"]))
    for lamp in lights["lamps"]:
        dim = np.array(lamp.get("dim", ((0.0, 1.0),)))
        total += lamp["level"] * np.interp(times, dim[:, 0], dim[:, 1])
    target, exposure = total[0] / total, np.ones(len(times))
    for k in range(1, len(times)):
        exposure[k] = exposure[k - 1] + 0.1 / EXPOSURE_DELAY_S * (target[k] - exposure[k - 1])
    return tuple((float(t), float(e)) for t, e in zip(times, exposure, strict=True))


CELL_M = 0.15
MIN_RANGE_M = 1.3
"""Horizontal distance that people keep from a camera on the wall [m]."""
APART_M = 0.42
"""Distance of ways and places from walls and furniture: half a shoulder width and a hand."""
MIN_DISPARITY_PX = 4.0
"""People stay near enough for this disparity; farther away stereo of the paper's image size is too coarse."""
POSTERS = ("#7a3030", "#305070", "#28607a", "#5a7a30", "#805a20")
WALLS = ("#d8d4c8", "#cfd6d8", "#dcd2c0")


class FreeFloor:
    """Cells of a floor that are free to walk on, by their centres (N, 2) [m]."""

    def __init__(self, points: F64, cell_m: float) -> None:
        self._points, self._cell_m, self._tree = points, cell_m, cKDTree(points)

    def is_clear(self, a: F64, b: F64) -> bool:
        """Whether the straight way from a to b is free, but for its last 0.5 m at both ends."""
        length = float(np.linalg.norm(b - a))
        along = np.arange(0.5, length - 0.5, self._cell_m / 2)[:, None] / max(length, 1e-9)
        away = self._tree.query(a + along * (b - a))[0] if len(along) else np.zeros(1)
        return bool(away.max() < 0.75 * self._cell_m)

    def route(self, a: F64, b: F64) -> list[F64]:
        """Points after a, the last one b, of a short free way. Raises NoPlaceError: there is none."""
        if self.is_clear(a, b):
            return [b]
        neighbours = self._tree.sparse_distance_matrix(self._tree, 1.5 * self._cell_m, output_type="coo_matrix")
        start, cell = (int(nearest) for nearest in self._tree.query([a, b])[1])
        before = dijkstra(neighbours.tocsr(), indices=start, return_predecessors=True)[1]
        points = [b, self._points[cell]]
        while cell != start:
            cell = int(before[cell])
            if cell < 0:
                raise NoPlaceError("no way")
            points.append(self._points[cell])
        points, corners = [a, *points[::-1]], []
        # Corners only: from each point straight to the farthest one that is in sight.
        while len(points) > 1:
            ahead = next(k for k in range(len(points) - 1, 0, -1) if k == 1 or self.is_clear(points[0], points[k]))
            points = points[ahead:]
            corners.append(points[0])
        return corners


class Stage:
    """A room, its rig, and what has been put into it so far.

    Attributes:
        rng: decides everything.
        room, rig: as they go into the scene.
        furniture: put so far.
        floor: where it is free, corridors behind the openings included.
    """

    def __init__(self, challenge: Challenge, rng: np.random.Generator) -> None:
        self.challenge, self.rng = challenge, rng
        self.room, self.rig = _room(challenge, rng), _rig(challenge, rng)
        self.is_overhead = self.rig.tilt_deg < 20
        self.camera_xy = np.array(self.rig.at_m[:2])
        self.furniture: list[Furniture] = []
        self._view: CameraView = camera_view(stereo_rig(self.rig).left, mount_pose(self.rig))
        self._lanes = {"west": 0, "east": 0}
        self._reserved: list[tuple[F64, float]] = []
        self._prepare()

    def _prepare(self) -> None:
        """Free cells and the ones in view, after walls, furniture and reserved places."""
        sx, sy, _ = self.room.size_m
        cells = np.meshgrid(np.arange(-2.25, sx + 2.25, CELL_M), np.arange(0.3, sy, CELL_M), indexing="ij")
        points = np.stack(cells, -1).reshape(-1, 2)
        free = Obstacles(self.room, self.furniture).distance(points) > APART_M
        for centre, radius in self._reserved:
            free &= np.linalg.norm(points - centre, axis=1) > radius
        if not self.is_overhead:
            free &= np.linalg.norm(points - self.camera_xy, axis=1) > MIN_RANGE_M - 0.3
        inside = ((points > 0.3) & (points < [sx - 0.3, sy - 0.3])).all(axis=1)
        self.floor = FreeFloor(points[free], CELL_M)
        self._points, self._spots = points, free & self.in_view(points) & inside

    def in_view(self, points: F64) -> Bool:
        """(N,) whether people at points (N, 2) are in the left image and near enough for stereo."""
        border, size = 0.04 * self.rig.width, np.array([self.rig.width, self.rig.height])
        result = np.ones(len(points), np.bool_)
        for z in (0.9, 1.75):  # both heights of a place must be in the image
            camera = self._view.room_SE3_camera.inverse() @ np.column_stack([points, np.full(len(points), z)])
            with np.errstate(all="ignore"):
                uv = self._view.project(camera)
                result &= ((uv > border) & (uv < size - 1 - border)).all(axis=1) & (camera[:, 2] > 0.3)
            result &= camera[:, 2] < self.rig.focal_px * self.rig.baseline_m / MIN_DISPARITY_PX
        if not self.is_overhead:
            result &= np.linalg.norm(points - self.camera_xy, axis=1) > MIN_RANGE_M
        return result

    def spots(self, radius_m: float = 0.0) -> F64:
        """(N, 2) places in view around which a disc is free and in view. Raises NoPlaceError: there is none."""
        good, bad = self._points[self._spots], self._points[~self._spots]
        if radius_m > 0 and len(good):
            good = good[cKDTree(bad).query(good)[0] > radius_m]
        if len(good) == 0:
            raise NoPlaceError(f"no place of {radius_m} m in view")
        return np.asarray(good)

    def spot(self, radius_m: float = 0.0, *, reserve: bool = True) -> F64:
        """A random place (2,) of that radius; others keep out of it unless ``reserve`` is false."""
        place = np.asarray(self.rng.choice(self.spots(radius_m)))
        if reserve:
            self._reserved.append((place, radius_m))
            self._prepare()
        return place

    def put(self, **values: Any) -> Furniture:
        """Furniture from its table, as ``[[furniture]]`` of a scene."""
        item = Furniture.model_validate(values)
        self.furniture.append(item)
        self._prepare()
        return item

    def door(self, side: str) -> tuple[F64, F64, F64]:
        """A hidden place (2,) outside an opening, a place behind it and one in it, in a lane of its own."""
        opening = next(o for o in self.room.openings if o.wall == side)
        lane = opening.from_m + opening.width_m * (0.25, 0.75, 0.5)[self._lanes[side] % 3]
        self._lanes[side] += 1
        points = [np.array(p) for p in ((-2.1, opening.from_m - 0.9), (-0.9, lane), (0.35, lane))]
        if side == "east":
            points = [np.array([self.room.size_m[0] - x, y]) for x, y in points]
        return points[0], points[1], points[2]

    def side(self) -> str:
        """The opening for the next person."""
        return str(self.rng.choice(("west", "east")))

    def rectangle(self) -> tuple[float, float, float, float]:
        """A large rectangle x_min, y_min, x_max, y_max of the floor that is nearly all in view."""
        good, largest, found = self.spots(), 0.0, None
        for _ in range(400):
            a, b = good[self.rng.integers(len(good), size=2)]
            low, high = np.minimum(a, b), np.maximum(a, b)
            n = float(np.prod(np.round((high - low) / CELL_M) + 1))
            inside = ((good >= low - 1e-6) & (good <= high + 1e-6)).all(axis=1).sum()
            if inside >= 0.9 * n > 0.9 * largest:
                largest, found = n, (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
        if found is None:
            raise NoPlaceError("no floor in view")
        return found


def _room(challenge: Challenge, rng: np.random.Generator) -> Room:
    size, openings, panels = challenge.room, [], []
    for wall in ("west", "east"):
        width = float(rng.uniform(2.2, 2.8))
        at = float(np.clip(rng.uniform(0.3, 0.6) * size.depth_m - width / 2 + 0.4, 1.1, size.depth_m - width - 0.5))
        openings.append(Opening(wall=wall, from_m=at, width_m=width))
    for x in rng.uniform((0.05, 0.55), (0.35, 0.8)):
        colour2, scale_m = str(rng.choice(POSTERS)), float(rng.uniform(0.12, 0.25))
        poster = Surface(texture="poster", colour="#e0d8c8", colour2=colour2, scale_m=scale_m)
        width_m = float(rng.uniform(0.7, 1.3))
        panels.append(Panel(wall="north", from_m=float(x * size.width_m), width_m=width_m, surface=poster))
    return Room(
        size_m=(size.width_m, size.depth_m, size.height_m),
        floor=Surface.model_validate(floor_surface(rng, float(rng.choice((0.0, 0.0, 0.06))))),
        walls=Surface(colour=str(rng.choice(WALLS)), scale_m=0.8, contrast=0.06),
        openings=tuple(openings),
        panels=tuple(panels),
    )


def _rig(challenge: Challenge, rng: np.random.Generator) -> Rig:
    camera, room = challenge.camera, challenge.room
    y = room.depth_m * 0.5 if camera.tilt_deg < 20 else 0.2
    x = room.width_m * 0.5 + rng.uniform(-0.1, 0.1) * room.width_m
    k1 = -0.12 * rng.uniform(0.3, 1.2)
    values = camera.model_dump(exclude={"lens_deg", "height_m", "grey"}) | {
        "at_m": (x, y, camera.height_m),
        "heading_deg": 90.0 + rng.uniform(-10, 10),
        "focal_px": camera.focal_px,
        "right_rotation_deg": tuple(rng.uniform(-0.3, 0.3, 3)),
        "centre_offset_px": tuple(rng.uniform(-4, 4, 2)),
        "distortion": (k1, -0.25 * k1, *rng.uniform(-5e-4, 5e-4, 2), 0.0),
    }
    return Rig.model_validate(values)
