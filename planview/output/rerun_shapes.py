"""Shapes and layout of a rerun recording."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from calib.floor_camera import FloorCamera
from calib.images import as_colour, encode_image
from calib.types import F32, U8, AnyArray, Bool
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
    """Disparity with near red, far blue and invalid black (as ``planview check`` shows it)."""
    first = stereo.disparities.first_px
    return photo(disparity_colours(disparity, first, first + stereo.disparities.count), 40)


def outlines(foreground: U8, size: tuple[int, int]) -> rr.LineStrips2D:
    """Outlines of the foreground in an image of (width, height) pixels; its mask takes fifty times their room."""
    mask = (foreground > 0).astype(np.uint8)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_TC89_L1)
    scale = size[0] / foreground.shape[1]
    strips = []
    for contour in contours:
        if len(contour) > 2:
            closed = np.vstack([contour, contour[:1]])
            strips.append(closed.reshape(-1, 2).astype(np.float32) * scale)
    return rr.LineStrips2D(strips, colors=[255, 60, 60], radii=-1.0)


def strips_of(drawing: Drawing) -> rr.LineStrips3D | rr.LineStrips2D | rr.Points2D | rr.Points3D:
    """A tracker's drawing; labels in the image show under the pointer, those on the floor would hide the maps."""
    strips = drawing.strips
    are_points = strips and all(len(strip) == 1 for strip in strips)
    if drawing.plane == "image":
        flat = [np.asarray(strip, dtype=np.float32) for strip in strips]
        labels = list(drawing.labels) or None
        if are_points:
            return rr.Points2D(np.concatenate(flat), labels=labels, show_labels=False)
        return rr.LineStrips2D(flat, labels=labels, show_labels=False)
    raised = [np.column_stack([strip, np.full(len(strip), 0.03)]) for strip in strips]
    if are_points:
        return rr.Points3D(np.concatenate(raised), radii=0.01)
    return rr.LineStrips3D(raised, colors=[0, 230, 120], radii=0.01)


def mosaic(tiles: Mapping[str, F32 | U8]) -> U8:
    """Small images side by side in the order of their names; one by one they would take ten times the room."""
    height = max(tile.shape[0] for tile in tiles.values())
    columns = []
    for _, tile in sorted(tiles.items()):
        grey: AnyArray = tile
        if tile.dtype != np.uint8:  # numbers get the full range of grey, with their first row below
            grey = np.clip(tile / max(float(tile.max()), 1e-9) * 255, 0, 255)[::-1]
        scale = max(1, height // tile.shape[0] // 2)
        enlarged = np.kron(grey.astype(np.uint8), np.ones((scale, scale), np.uint8))
        columns.append(np.pad(enlarged, ((0, height - enlarged.shape[0]), (0, 1))))
    return np.hstack(columns)


def templates(result: FrameResult) -> dict[str, F32 | U8]:
    """T_H and T_O of everybody, by name."""
    tiles: dict[str, F32 | U8] = {}
    for track in result.tracks:
        template = result.template(track)
        if template is not None:
            height, occupancy = template
            tiles[f"template/{track.track_id}/height"] = height
            tiles[f"template/{track.track_id}/occupancy"] = occupancy
    return tiles


def facing_shapes(tracks: Sequence[TrackState], camera: FloorCamera | None) -> tuple[list[Any], list[Any]]:
    """Directions in which people face, on the floor [m] and in the image of a camera [px]: arrows, and lines without a
    head where front and back may be confused."""
    facing = []
    lines = []
    for track in tracks:
        line = facing_line(track)
        if line is not None:
            facing.append(track)
            lines.append(np.column_stack([line, [0.05, 0.05]]))
    ends = np.array(lines).reshape(-1, 2, 3)
    colours = np.array([person_rgb(track.track_id, track.state) for track in facing], np.uint8).reshape(-1, 3)
    is_sure = np.array([faces_surely(track) for track in facing], np.bool_)
    ahead = ends[:, 1] - ends[:, 0]
    floor = [
        rr.Arrows3D(origins=ends[is_sure, 0], vectors=ahead[is_sure], colors=colours[is_sure], radii=0.03),
        rr.LineStrips3D(ends[~is_sure], colors=colours[~is_sure], radii=0.03),
    ]
    pixels = np.full((len(ends), 2, 2), np.nan)
    if camera is not None:
        pixels = camera.project(ends.reshape(-1, 3)).reshape(-1, 2, 2)
    is_seen = np.isfinite(pixels).all(axis=(1, 2))
    arrows = pixels[is_sure & is_seen]
    image = [
        rr.Arrows2D(
            origins=arrows[:, 0], vectors=arrows[:, 1] - arrows[:, 0], colors=colours[is_sure & is_seen], radii=-2.5
        ),
        rr.LineStrips2D(pixels[~is_sure & is_seen], colors=colours[~is_sure & is_seen], radii=-2.5),
    ]
    return floor, image


POINTS_PER_FRAME = 1500
"""Foreground points of a frame at most: enough to recognise five people, in 24 kB."""


def foreground_points(result: FrameResult) -> rr.Points3D:
    """Foreground points of all rigs [m], each in the colour of its rig's image."""
    places = [np.empty((0, 3), np.float32)]
    colours = [np.empty((0, 3), np.uint8)]
    for view in result.views:
        if view.image is not None:
            places.append(view.points.xyz)
            colours.append(_rgb(view.image).reshape(-1, 3)[view.points.pixels])
    xyz = np.concatenate(places)
    step = max(1, math.ceil(len(xyz) / POINTS_PER_FRAME))
    return rr.Points3D(xyz[::step], colors=np.concatenate(colours)[::step], radii=0.018)


UNDER = -50.0
OVER = 10.0
"""Order of drawing of floor and maps: both lie in one plane, since what is transparent hides what lies below it."""
LOWEST_SHOWN_M = -0.5
HIGHEST_SHOWN_M = 3.5
"""Points that lie lower or higher are noise or hide the view."""
POINTS_MAX = 60_000


def scene_cloud(depth: Depth, view: View, stereo: FloorRig) -> rr.Points3D:
    """Coloured points of a frame besides people, up to 1 m beyond the grid."""
    geometry = stereo.geometry
    pose = stereo.floor.world_SE3_left
    grid = stereo.grid
    seen = back_project(geometry.depth(depth.disparity), geometry, depth.step).reshape(-1, 3)
    points = np.asarray(seen @ pose.rotation.T + pose.translation, dtype=np.float32)
    x, y, z = points.T
    is_shown = (x > grid.x_min_m - 1) & (x < grid.x_max_m + 1)
    is_shown &= (y > grid.y_min_m - 1) & (y < grid.y_max_m + 1)
    is_shown &= (z > LOWEST_SHOWN_M) & (z < HIGHEST_SHOWN_M)
    if view.foreground is not None:
        is_shown &= view.foreground.reshape(-1) == 0
    rows = np.flatnonzero(is_shown)
    rows = rows[:: max(1, math.ceil(len(rows) / POINTS_MAX))]
    return rr.Points3D(points[rows], colors=_rgb(depth.image).reshape(-1, 3)[rows], radii=0.012)  # [m]


FLOOR_LIGHT = 0.55
"""Share of its light that the image on the floor keeps, so that the maps on it stand out."""


def floor_image(image: U8, stereo: FloorRig) -> rr.GridMap:
    """The image laid on the floor, under the maps."""
    grid = stereo.grid
    rows, cols = np.indices(grid.shape)
    x_m, y_m = grid.centre_of(0, 0)
    seen = from_above(_rgb(image), stereo.camera, x_m + cols * grid.cell_m, y_m + rows * grid.cell_m)
    dimmed = np.asarray(seen * FLOOR_LIGHT, dtype=np.uint8)
    return _grid_map(dimmed, np.asarray(dimmed.any(axis=2)), stereo, UNDER)


def metre_grid(bounds: PlanBounds) -> rr.LineStrips3D:
    """Lines every metre of a part of the floor, every five metres where these would be more than 40."""
    x_min = math.floor(bounds.x_min_m)
    y_min = math.floor(bounds.y_min_m)
    x_max = math.ceil(bounds.x_max_m)
    y_max = math.ceil(bounds.y_max_m)
    step = 1
    if max(x_max - x_min, y_max - y_min) > 40:
        step = 5
    lines = [[(x, y_min, 0.01), (x, y_max, 0.01)] for x in range(x_min, x_max + 1, step)]
    lines += [[(x_min, y, 0.01), (x_max, y, 0.01)] for y in range(y_min, y_max + 1, step)]
    return rr.LineStrips3D(lines, colors=[90, 90, 90], radii=-0.5)


def map_image(values: F32, largest: float, stereo: FloorRig) -> rr.GridMap:
    """A plan-view map (n_rows, n_cols), row 0 at y_min, in colours up to ``largest``; transparent where it is empty."""
    levels = np.clip(values * (255.0 / largest), 0, 255).astype(np.uint8)
    colours = _rgb(cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO))
    return _grid_map(colours, levels > 0, stereo, OVER)


def _grid_map(rgb: U8, is_shown: Bool, stereo: FloorRig, order: float) -> rr.GridMap:
    """(n_rows, n_cols, 3) pixels of the grid, row 0 at y_min, where a grid map has its upper row first."""
    grid = stereo.grid
    mask = np.where(is_shown, 255, 0).astype(np.uint8)
    pixels = np.dstack([cv2.bitwise_and(rgb, rgb, mask=mask), mask])
    return rr.GridMap(
        data=np.ascontiguousarray(pixels[::-1]).tobytes(),
        cell_size=grid.cell_m,
        draw_order=order,
        translation=[grid.x_min_m, grid.y_min_m, 0.0],
        format=rr.components.ImageFormat(
            width=grid.n_cols, height=grid.n_rows, color_model="RGBA", channel_datatype="U8"
        ),
    )


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
        layout_of(engine).views(engine, people),
        rrb.TimePanel(state="collapsed", timeline="frame"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _views_of_depth(engine: Engine, people: PlanBounds | None) -> rrb.Vertical:
    bounds = people or shown_floor(engine.stereo)
    first = rrb.Spatial2DView(origin="image", name="people (arrow: faces there, bar: along it) and foreground (red)")
    others = [rrb.Spatial2DView(origin=f"{name}/image", name=name) for name in [*engine.rigs][1:]]
    image = rrb.Tabs(first, *others, active_tab=0) if others else first
    world = _floor_view("3D", bounds, (0.0, -0.75, 0.55), "world")
    disparity = rrb.Tabs(
        rrb.Spatial2DView(origin="disparity", name="disparity"),
        rrb.Spatial2DView(origin="templates", name="owners of pixels, templates"),
        active_tab=0,
    )
    height = _floor_view("height from above", bounds, DOWN, "plan", ["plan/height", *MAP_LAYERS])
    occupancy = _floor_view("occupancy from above", bounds, DOWN, "plan", ["plan/occupancy", *MAP_LAYERS])
    above = rrb.Horizontal(image, world)
    below = rrb.Horizontal(disparity, height, occupancy, _series())
    return rrb.Vertical(above, below, row_shares=[3, 2])


def _views_of_one_camera(engine: Engine, people: PlanBounds | None) -> rrb.Horizontal:
    right: list[rrb.View | rrb.Container] = []
    if engine.camera is not None:
        bounds = people or PlanBounds(-8.0, 0.0, 8.0, 16.0)
        right.append(_floor_view("floor from above", bounds, DOWN, "plan", ["plan/trails", *MAP_LAYERS]))
    # Number of people, which every tracker of one camera gives; not all have match scores.
    right.append(_series(active_tab=2))
    image = rrb.Spatial2DView(origin="image", name="image, people")
    return rrb.Horizontal(image, rrb.Vertical(*right), column_shares=[3, 2])


class ViewerLayout(NamedTuple):
    """Layout in which the viewer shows a kind of recording: as which application, where people's paths are, and all
    views."""

    application: str
    trails: str
    views: Callable[[Engine, PlanBounds | None], rrb.Container]


DEPTH_LAYOUT = ViewerLayout("planview", "world/trails", _views_of_depth)
ONE_CAMERA_LAYOUT = ViewerLayout("planview-single", "plan/trails", _views_of_one_camera)


def layout_of(engine: Engine) -> ViewerLayout:
    """Layout of rigs, or of one camera."""
    return DEPTH_LAYOUT if engine.rigs else ONE_CAMERA_LAYOUT


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


Direction = tuple[float, float, float]
DOWN: Direction = (0.0, -0.001, 0.9)


def _floor_view(
    name: str, bounds: PlanBounds, direction: Direction, origin: str, layers: Sequence[str] = ("$origin/**",)
) -> rrb.Spatial3DView:
    """The middle of a part of the floor, seen from a direction, the way the camera looks upwards."""
    centre = np.array([(bounds.x_min_m + bounds.x_max_m) / 2, (bounds.y_min_m + bounds.y_max_m) / 2, 0.0])
    distance = max(1.1 * (bounds.x_max_m - bounds.x_min_m), 1.25 * (bounds.y_max_m - bounds.y_min_m), 3.0)
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=centre + distance * np.array(direction),
        look_target=centre,
        eye_up=(0.0, 1.0, 0.0) if direction is DOWN else (0.0, 0.0, 1.0),
    )
    return rrb.Spatial3DView(
        origin=origin,
        contents=layers,
        name=name,
        eye_controls=eye,
        line_grid=False,
        overrides={f"{origin}/trails": _TRAILS},
    )


def shown_floor(stereo: FloorRig) -> PlanBounds:
    """Bounds of the visible floor, else of the grid, with the place below the camera [m]."""
    grid = stereo.grid
    x_min, y_min, x_max, y_max = stereo.floor.extent_m or (grid.x_min_m, grid.y_min_m, grid.x_max_m, grid.y_max_m)
    return PlanBounds(min(x_min, 0.0), min(y_min, 0.0), max(x_max, 0.0), max(y_max, 0.0))
