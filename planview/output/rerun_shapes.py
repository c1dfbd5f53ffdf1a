"""Shapes and layout of a rerun recording."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from calib.floor_camera import FloorCamera
from calib.images import as_colour, encode_image
from calib.types import F32, U8, Bool
from planview.drawing.people import faces_surely, facing_line
from planview.drawing.plan import PlanBounds, from_above
from planview.drawing.style import disparity_colours
from planview.engine.engine import Engine, FrameResult
from planview.maps.grid import FloorRig
from planview.maps.view import View
from planview.tracking.base import Drawing
from planview.trajectories.plot import person_rgb
from planview.trajectories.state import TrackState
from stereo.depth import Depth, back_project

LABEL_M = 0.45
"""Distance of ids from people in plan views, where they hide no peak of the maps [m]."""


def photo(image: U8, quality: int = 50) -> rr.EncodedImage:
    """A JPEG of a BGR image; of this quality it takes .6 of the room of 80, and people are as well recognised."""
    return rr.EncodedImage(contents=encode_image(image, quality=quality), media_type="image/jpeg")


def disparity_photo(disparity: F32, stereo: FloorRig) -> rr.EncodedImage:
    """Near red, far blue, invalid black (as ``planview check`` shows it)."""
    first = stereo.disparities.first_px
    return photo(disparity_colours(disparity, first, first + stereo.disparities.count), 40)


def outlines(foreground: U8, size: tuple[int, int]) -> rr.LineStrips2D:
    """People of the foreground in an image of (width, height) pixels; its mask takes fifty times their room."""
    found, _ = cv2.findContours((foreground > 0).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_TC89_L1)
    scale = size[0] / foreground.shape[1]
    strips = [np.vstack([c, c[:1]]).reshape(-1, 2).astype(np.float32) * scale for c in found if len(c) > 2]
    return rr.LineStrips2D(strips, colors=[255, 60, 60], radii=-1.0)


def strips_of(drawing: Drawing) -> rr.LineStrips3D | rr.LineStrips2D | rr.Points2D | rr.Points3D:
    """A tracker's drawing; labels in the image show under the pointer, those on the floor would hide the maps."""
    are_points = drawing.strips and all(len(strip) == 1 for strip in drawing.strips)
    if drawing.plane == "image":
        flat = [np.asarray(strip, dtype=np.float32) for strip in drawing.strips]
        shown: dict[str, Any] = {"labels": list(drawing.labels) or None, "show_labels": False}
        return rr.Points2D(np.concatenate(flat), **shown) if are_points else rr.LineStrips2D(flat, **shown)
    raised = [np.column_stack([strip, np.full(len(strip), 0.03)]) for strip in drawing.strips]
    if are_points:
        return rr.Points3D(np.concatenate(raised), radii=0.01)
    return rr.LineStrips3D(raised, colors=[0, 230, 120], radii=0.01)


def mosaic(tiles: Mapping[str, F32 | U8]) -> U8:
    """Small images side by side in the order of their names; one by one they would take ten times the room."""
    grey: list[U8] = []
    for _, tile in sorted(tiles.items()):  # numbers with the full range of grey, their first row below
        light = np.clip(tile / max(float(tile.max()), 1e-9) * 255, 0, 255)[::-1]
        grey.append(np.asarray(tile if tile.dtype == np.uint8 else light, dtype=np.uint8))
    height = max(tile.shape[0] for tile in grey)
    grey = [np.kron(tile, np.ones([max(1, height // tile.shape[0] // 2)] * 2, np.uint8)) for tile in grey]
    return np.hstack([np.pad(tile, ((0, height - tile.shape[0]), (0, 1))) for tile in grey])


def templates(result: FrameResult) -> dict[str, F32 | U8]:
    """T_H and T_O of everybody, by name."""
    tiles: dict[str, F32 | U8] = {}
    for track in result.tracks:
        if (template := result.template(track)) is not None:
            names = (f"template/{track.track_id}/{part}" for part in ("height", "occupancy"))
            tiles |= zip(names, template, strict=True)
    return tiles


def facing_shapes(tracks: Sequence[TrackState], camera: FloorCamera | None) -> tuple[list[Any], list[Any]]:
    """Where people face, on the floor [m] and in the image of a camera [px]: arrows, and lines without a head where
    front and back may be confused."""
    known = [(track, line) for track in tracks if (line := facing_line(track)) is not None]
    colours = np.array([person_rgb(track.track_id, track.state) for track, _ in known], np.uint8).reshape(-1, 3)
    sure = np.array([faces_surely(track) for track, _ in known], np.bool_)
    ends = np.array([np.column_stack([line, [0.05, 0.05]]) for _, line in known]).reshape(-1, 2, 3)
    pixels = np.full((len(ends), 2, 2), np.nan)
    if camera is not None:
        pixels = camera.project(ends.reshape(-1, 3)).reshape(-1, 2, 2)
    ahead, seen = ends[:, 1] - ends[:, 0], np.isfinite(pixels).all(axis=(1, 2))
    arrows, lines = sure & seen, ~sure & seen
    floor = [
        rr.Arrows3D(origins=ends[sure, 0], vectors=ahead[sure], colors=colours[sure], radii=0.03),
        rr.LineStrips3D(ends[~sure], colors=colours[~sure], radii=0.03),
    ]
    forward = pixels[arrows, 1] - pixels[arrows, 0]
    image = [
        rr.Arrows2D(origins=pixels[arrows, 0], vectors=forward, colors=colours[arrows], radii=-2.5),
        rr.LineStrips2D(pixels[lines], colors=colours[lines], radii=-2.5),
    ]
    return floor, image


def foreground_points(result: FrameResult) -> rr.Points3D:
    """Foreground points of all rigs [m], each in the colour of its rig's image."""
    shown = [(view.points, _rgb(view.image).reshape(-1, 3)) for view in result.views if view.image is not None]
    xyz = np.concatenate([np.empty((0, 3), np.float32), *(points.xyz for points, _ in shown)])
    colours = np.concatenate([np.empty((0, 3), np.uint8), *(image[points.pixels] for points, image in shown)])
    # Points logged per frame at most: enough to recognise five people, in 24 kB.
    step = -(-len(xyz) // 1500) or 1
    return rr.Points3D(xyz[::step], colors=colours[::step], radii=0.018)


UNDER, OVER = -50.0, 10.0
"""Order of drawing of floor and maps: both lie in one plane, since what is transparent hides what lies below it."""
HEIGHT_SHOWN_M = (-0.5, 3.5)
"""What lies lower or higher is noise or hides the view."""
POINTS_MAX = 60_000


def scene_cloud(depth: Depth, view: View, stereo: FloorRig) -> rr.Points3D:
    """What a frame shows besides people, in colour."""
    geometry, pose, grid = stereo.geometry, stereo.floor.world_SE3_left, stereo.grid
    seen = back_project(geometry.depth(depth.disparity), geometry, depth.step).reshape(-1, 3)
    points = np.asarray(seen @ pose.rotation.T + pose.translation, dtype=np.float32)
    x, y, z = points.T
    near = (x > grid.x_min_m - 1) & (x < grid.x_max_m + 1) & (y > grid.y_min_m - 1) & (y < grid.y_max_m + 1)
    near &= (z > HEIGHT_SHOWN_M[0]) & (z < HEIGHT_SHOWN_M[1])
    keep = np.flatnonzero(near if view.foreground is None else near & (view.foreground.reshape(-1) == 0))
    keep = keep[:: max(1, -(-len(keep) // POINTS_MAX))]
    return rr.Points3D(points[keep], colors=_rgb(depth.image).reshape(-1, 3)[keep], radii=0.012)  # [m]


def floor_image(image: U8, stereo: FloorRig) -> rr.GridMap:
    """The image laid on the floor, under the maps."""
    grid = stereo.grid
    rows, cols = np.indices(grid.shape)
    x, y = grid.centre_of(0, 0)
    shown = from_above(_rgb(image), stereo.camera, x + cols * grid.cell_m, y + rows * grid.cell_m)
    # The image on the floor is darkened by this, so that the maps on it stand out.
    dimmed = np.asarray(shown * 0.55, dtype=np.uint8)
    return _grid_map(dimmed, np.asarray(dimmed.any(axis=2)), stereo, UNDER)


def metre_grid(bounds: PlanBounds) -> rr.LineStrips3D:
    """Lines every metre of a part of the floor, every five metres of a large one."""
    x_min, y_min = math.floor(bounds.x_min_m), math.floor(bounds.y_min_m)
    x_max, y_max = math.ceil(bounds.x_max_m), math.ceil(bounds.y_max_m)
    # Lines of a metre, at most 40.
    step = 1 if max(x_max - x_min, y_max - y_min) <= 40 else 5
    lines = [[(x, y_min, 0.01), (x, y_max, 0.01)] for x in range(x_min, x_max + 1, step)]
    lines += [[(x_min, y, 0.01), (x_max, y, 0.01)] for y in range(y_min, y_max + 1, step)]
    return rr.LineStrips3D(lines, colors=[90, 90, 90], radii=-0.5)


def map_image(values: F32, largest: float, stereo: FloorRig) -> rr.GridMap:
    """A plan-view map (n_rows, n_cols), row 0 at y_min, in colours up to ``largest``; transparent where it is empty."""
    levels = np.clip(values * (255.0 / largest), 0, 255).astype(np.uint8)
    return _grid_map(_rgb(cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO)), levels > 0, stereo, OVER)


def _grid_map(rgb: U8, is_shown: Bool, stereo: FloorRig, order: float) -> rr.GridMap:
    """(n_rows, n_cols, 3) pixels of the grid, row 0 at y_min, where a grid map has its upper row first."""
    grid, mask = stereo.grid, np.where(is_shown, 255, 0).astype(np.uint8)
    pixels = np.dstack([cv2.bitwise_and(rgb, rgb, mask=mask), mask])
    size = {"width": grid.n_cols, "height": grid.n_rows}
    return rr.GridMap(
        data=np.ascontiguousarray(pixels[::-1]).tobytes(), cell_size=grid.cell_m, draw_order=order,
        translation=[grid.x_min_m, grid.y_min_m, 0.0],
        format=rr.components.ImageFormat(**size, color_model="RGBA", channel_datatype="U8"),
    )  # fmt: skip


def _rgb(image: cv2.typing.MatLike) -> U8:
    return np.ascontiguousarray(as_colour(np.asarray(image, dtype=np.uint8))[..., ::-1])


_AGO = rrb.TimeRangeBoundary.cursor_relative
_TRAILS = rrb.VisibleTimeRanges([
    rrb.VisibleTimeRange("time", start=_AGO(seconds=-10.0), end=_AGO(seconds=0.0)),
    rrb.VisibleTimeRange("frame", start=_AGO(seq=-150), end=_AGO(seq=0)),
])  # fmt: skip
"""Trails behind people: ten seconds, which are 150 frames at 15 Hz."""
MAP_LAYERS = [
    "plan/floor", "plan/grid", "plan/people", "plan/facing", "plan/labels", "plan/bodies", "plan/footprints",
    "plan/search", "plan/template", "plan/ellipses", "plan/truth",
]  # fmt: skip


def blueprint(engine: Engine, people: PlanBounds | None = None) -> rrb.Blueprint:
    """Image and disparity, 3D view, both maps, decisions and series; of one camera its image large, and the floor from
    above where it is known. The views show where people were, else the visible floor."""
    return rrb.Blueprint(
        _of_one_camera(engine, people) if engine.stereo is None else _of_depth(engine, engine.stereo, people),
        rrb.TimePanel(state="collapsed", timeline="frame"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _of_depth(engine: Engine, stereo: FloorRig, people: PlanBounds | None) -> rrb.Vertical:
    bounds, names = people or shown_floor(stereo), list(engine.rigs)
    images = [rrb.Spatial2DView(origin="image", name="image, foreground, people")]
    images += [rrb.Spatial2DView(origin=f"{name}/image", name=name) for name in names[1:]]
    world = _view("3D", bounds, (0.0, -0.75, 0.55), "world")
    maps = [
        _view(f"{name} from above", bounds, DOWN, "plan", [f"plan/{name}", *MAP_LAYERS])
        for name in ("height", "occupancy")
    ]
    disparity = rrb.Tabs(
        rrb.Spatial2DView(origin="disparity", name="disparity"),
        rrb.Spatial2DView(origin="templates", name="owners of pixels, templates"),
        active_tab=0,
    )
    image = rrb.Tabs(*images, active_tab=0) if len(images) > 1 else images[0]
    return rrb.Vertical(rrb.Horizontal(image, world), rrb.Horizontal(disparity, *maps, _series()), row_shares=[3, 2])


def _of_one_camera(engine: Engine, people: PlanBounds | None) -> rrb.Horizontal:
    right: list[rrb.View | rrb.Container] = []
    if engine.camera is not None:
        bounds = people or PlanBounds(-8.0, 0.0, 8.0, 16.0)
        right.append(_view("floor from above", bounds, DOWN, "plan", ["plan/trails", *MAP_LAYERS]))
    # Number of people, which every tracker of one camera gives; not all have match scores.
    right.append(_series(active_tab=2))
    image = rrb.Spatial2DView(origin="image", name="image, people")
    return rrb.Horizontal(image, rrb.Vertical(*right), column_shares=[3, 2])


def _series(active_tab: int = 0) -> rrb.Tabs:
    """Curves and decisions; ``errors`` are the significant ones, where there is truth."""
    return rrb.Tabs(
        rrb.TimeSeriesView(origin="score", name="match score"),
        rrb.TextLogView(origin="decisions", name="decisions"),
        rrb.TimeSeriesView(origin="people", name="people"),
        rrb.TimeSeriesView(origin="time_ms", name="stage times [ms]"),
        rrb.TextLogView(origin="errors", name="significant errors"),
        active_tab=active_tab,
    )


DOWN = (0.0, -0.001, 0.9)


def _view(
    name: str,
    bounds: PlanBounds,
    direction: tuple[float, float, float],
    origin: str,
    layers: Sequence[str] = ("$origin/**",),
) -> rrb.Spatial3DView:
    """Looking at the middle of a part of the floor, from a direction, the way the camera looks upwards."""
    centre = np.array([(bounds.x_min_m + bounds.x_max_m) / 2, (bounds.y_min_m + bounds.y_max_m) / 2, 0.0])
    distance = max(1.1 * (bounds.x_max_m - bounds.x_min_m), 1.25 * (bounds.y_max_m - bounds.y_min_m), 3.0)
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=centre + distance * np.array(direction), look_target=centre,
        eye_up=(0.0, 1.0, 0.0) if direction is DOWN else (0.0, 0.0, 1.0),
    )  # fmt: skip
    return rrb.Spatial3DView(
        origin=origin, contents=layers, name=name, eye_controls=eye, line_grid=False,
        overrides={f"{origin}/trails": _TRAILS},
    )  # fmt: skip


def shown_floor(stereo: FloorRig) -> PlanBounds:
    """Bounds of the visible floor, else of the grid; the place below the camera included [m]."""
    grid = stereo.grid
    x_min, y_min, x_max, y_max = stereo.floor.extent_m or (grid.x_min_m, grid.y_min_m, grid.x_max_m, grid.y_max_m)
    return PlanBounds(min(x_min, 0.0), min(y_min, 0.0), max(x_max, 0.0), max(y_max, 0.0))
