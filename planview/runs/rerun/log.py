"""A run as a rerun recording: image, foreground, disparity, 3D view, plan-view maps, decisions and time series."""

from __future__ import annotations

import colorsys
import math
import shutil
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import rerun as rr

from calib.errors import WorkError
from calib.images import encode_image
from calib.types import F32, I32, U8
from planview.maps.view import StereoView
from planview.pipeline.engine import Engine, FrameResult
from planview.runs.rerun.blueprint import blueprint, other_heads, shown_floor
from planview.runs.rerun.parts import RrdParts
from planview.tracking.base import Drawing
from planview.trajectories.state import TrackState

JPEG_QUALITY = 80
TRAIL_S = 10.0
"""Length of the trails behind people [s]."""
BODY_M = 0.5
"""Width of the boxes around people [m]."""
CLOUD_POINTS_MAX = 20_000
"""Foreground points logged per frame at most."""
FREE_BYTES_MIN = 64 * 2**20
"""Free disk space for the next frames [bytes]: rerun writes in a thread of its own, which hangs on a full disk."""


class RerunLog:
    """Writes ``run.rrd``, in parts while the run goes on (``planview.runs.rerun.parts``).

    Args:
        engine: whose frames will come.
        path: the file to write.
        position: of ``mark``, to go on from there; what was written after it is dropped.
    Raises:
        InputError: what was written up to the position is not there any more.
        WorkError: too little free disk space.
    """

    def __init__(self, engine: Engine, path: Path, position: Mapping[str, int] | None = None) -> None:
        self._engine, self._path, self._parts = engine, path, RrdParts(path, position)
        self._check_room()
        self._stereo = engine.stereo
        self._trails: dict[int, deque[tuple[float, float, float]]] = {}  # time [s], x and y [m]
        self._shown: set[str] = set()
        self._stream = rr.RecordingStream("planview", recording_id=f"planview-{path.parent.name}")
        self._stream.save(str(self._parts.open_path), default_blueprint=blueprint(engine))
        self._log_static()

    def mark(self) -> dict[str, int]:
        """See ``RunLog``."""
        self._stream.flush()
        return self._parts.position()

    def frame(self, result: FrameResult) -> None:
        """Log one frame, on the timelines ``frame`` and ``time``.

        Raises:
            WorkError: too little free disk space; the file is complete up to the frame before.
        """
        self._check_room()
        self._stream.set_time("frame", sequence=result.frame)
        self._stream.set_time("time", duration=result.timestamp_s)
        self._log_image("image", result.observation.image, result.observation.foreground)
        for head in result.heads[1:]:
            self._log_image(f"{head.name}/image", head.image, head.foreground)
            self._log_boxes(f"{head.name}/image", [t for t in head.tracks if not math.isnan(t.box_px[0])])
        if self._stereo:
            self._log_depth(self._stereo, result)
            self._log_maps(result)
        self._log_people(result.tracks, result.timestamp_s)
        self._log_debug()
        self._log_decisions(result)
        self._log_series(result)

    def close(self) -> None:
        """See ``RunLog``."""
        self._stream.disconnect()
        self._parts.join()

    def finish(self) -> None:
        """See ``RunLog``."""
        self._parts.remove()

    def _check_room(self) -> None:
        free = shutil.disk_usage(self._path.parent).free
        if free < FREE_BYTES_MIN:
            raise WorkError(
                f"{self._path}: expected at least {FREE_BYTES_MIN >> 20} MB of free disk, found {free >> 20}: "
                "the disk is full; earlier frames are kept"
            )

    def _log_static(self) -> None:
        self._stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        labels = [(0, "background", (0, 0, 0, 0)), (255, "foreground", (255, 60, 60))]
        self._stream.log("image", rr.AnnotationContext(labels), static=True)
        if self._stereo is None:
            return
        self._log_camera("world/camera", self._stereo)
        for name, stereo in other_heads(self._engine):
            self._log_camera(f"world/{name}", stereo)
            self._stream.log(f"{name}/image", rr.AnnotationContext(labels), static=True)
        self._stream.log("world/floor", rr.LineStrips3D([_floor_grid(self._stereo)], colors=[90, 90, 90]), static=True)

    def _log_camera(self, path: str, stereo: StereoView) -> None:
        pose, geometry = stereo.floor.world_SE3_left, stereo.geometry
        self._stream.log(path, rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation), static=True)
        self._stream.log(
            path,
            rr.Pinhole(
                image_from_camera=geometry.matrix, resolution=geometry.size, camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=0.4,
            ),
            static=True,
        )  # fmt: skip

    def _log_image(self, path: str, image: U8 | None, foreground: U8 | None) -> None:
        if image is not None:
            encoded = encode_image(image, quality=JPEG_QUALITY)
            self._stream.log(f"{path}/left", rr.EncodedImage(contents=encoded, media_type="image/jpeg"))
        if image is not None and foreground is not None:
            size = image.shape[1], image.shape[0]
            full = np.asarray(cv2.resize(foreground, size, interpolation=cv2.INTER_NEAREST), dtype=np.uint8)
            self._stream.log(f"{path}/foreground", rr.SegmentationImage(full, opacity=0.4))

    def _log_depth(self, stereo: StereoView, result: FrameResult) -> None:
        """Disparity in sixteenths of a pixel at the analysis size, and the foreground cloud in colour."""
        if result.disparity is not None:
            reduced = result.disparity[:: stereo.reduction, :: stereo.reduction]
            sixteenths = np.nan_to_num(reduced * 16.0).astype(np.uint16)
            searched = stereo.disparities
            lowest, highest = 16.0 * searched.first_px, 16.0 * (searched.first_px + searched.count)
            colormap = rr.components.Colormap.Turbo
            shown = rr.DepthImage(sixteenths, meter=16.0, colormap=colormap, depth_range=(lowest, highest))
            self._stream.log("disparity", shown)
        maps = result.observation.maps
        colours = _point_colours(stereo, result)
        if maps is None or colours is None:
            return
        step = max(1, len(maps.points.xyz) // CLOUD_POINTS_MAX)
        cloud = rr.Points3D(maps.points.xyz[::step], colors=colours[::step], radii=0.012)
        self._stream.log("world/foreground", cloud)

    def _log_maps(self, result: FrameResult) -> None:
        maps = result.observation.maps
        if maps is None or self._stereo is None:
            return
        height_max = self._engine.config.maps.height_max_m
        density = maps.occupancy / maps.grid.cell_m**2
        for name, values, largest in (("height", maps.height, height_max), ("occupancy", density, 4.0)):
            levels = np.clip(values * (255.0 / largest), 0, 255).astype(np.uint8)
            grid_map = rr.GridMap(
                # A grid map's first row is its upper one; ours is at y_min.
                data=np.ascontiguousarray(levels[::-1]).tobytes(),
                format=rr.components.ImageFormat(
                    width=maps.grid.n_cols, height=maps.grid.n_rows, color_model="L", channel_datatype="U8"
                ),
                cell_size=maps.grid.cell_m,
                translation=[maps.grid.x_min_m, maps.grid.y_min_m, 0.0],
                colormap=rr.components.Colormap.Inferno,
            )
            self._stream.log(f"plan/{name}", grid_map)

    def _log_people(self, tracks: Sequence[TrackState], now_s: float) -> None:
        for track in tracks:
            trail = self._trails.setdefault(track.track_id, deque())
            if not math.isnan(track.x_m):
                trail.append((now_s, track.x_m, track.y_m))
            while trail and trail[0][0] < now_s - TRAIL_S:
                trail.popleft()
        self._trails = {track.track_id: self._trails[track.track_id] for track in tracks}
        self._log_boxes("image", [track for track in tracks if not math.isnan(track.box_px[0])])
        self._log_bodies([track for track in tracks if not math.isnan(track.x_m)])

    def _log_boxes(self, path: str, tracks: list[TrackState]) -> None:
        boxes = np.array([track.box_px for track in tracks], dtype=np.float32).reshape(-1, 4)
        self._stream.log(
            f"{path}/people",
            rr.Boxes2D(
                array=boxes, array_format=rr.Box2DFormat.XYWH, labels=[_label(track) for track in tracks],
                colors=[colour_of(track) for track in tracks],
            ),
        )  # fmt: skip

    def _log_bodies(self, tracks: list[TrackState]) -> None:
        heights = [1.7 if math.isnan(track.height_m) else track.height_m for track in tracks]
        colours, labels = [colour_of(track) for track in tracks], [_label(track) for track in tracks]
        centres = [(track.x_m, track.y_m, height / 2) for track, height in zip(tracks, heights, strict=True)]
        sizes = [(BODY_M, BODY_M, height) for height in heights]
        self._stream.log("world/people", rr.Boxes3D(centers=centres, sizes=sizes, colors=colours, labels=labels))
        trails = [np.array([(x, y, 0.02) for _, x, y in self._trails[track.track_id]]) for track in tracks]
        self._stream.log("world/trails", rr.LineStrips3D(trails, colors=colours, radii=0.015))
        heads = [(track.x_m, track.y_m, 0.05) for track in tracks]
        self._stream.log("plan/people", rr.Points3D(heads, colors=colours, labels=labels, radii=0.05))

    def _log_debug(self) -> None:
        debug = self._engine.tracker.debug()
        names = set()
        for drawing in debug.drawings:
            path = f"{'plan' if drawing.plane == 'floor' else 'image'}/{drawing.name}"
            names.add(path)
            self._stream.log(path, _shapes(drawing))
        for name, tile in debug.tiles.items():
            names.add(name)
            self._stream.log(name, rr.Image(_grey_tile(tile)))
        for name in self._shown - names:
            self._stream.log(name, rr.Clear(recursive=False))
        self._shown = names

    def _log_decisions(self, result: FrameResult) -> None:
        for decision in result.decisions:
            if decision.kind != "matched":
                level = rr.TextLogLevel.WARN if decision.kind == "lost" else rr.TextLogLevel.INFO
                text = f"{decision.track_id} {decision.kind}: {decision.reason}"
                self._stream.log("decisions", rr.TextLog(text, level=level))

    def _log_series(self, result: FrameResult) -> None:
        for stage, duration in result.stages_ms.items():
            self._stream.log(f"time_ms/{stage}", rr.Scalars(duration))
        people = sum(track.state == "confirmed" for track in result.tracks)
        self._stream.log("people/confirmed", rr.Scalars(people))
        for decision in result.decisions:
            if decision.kind == "matched" and not math.isnan(decision.value):
                self._stream.log(f"score/{decision.track_id}", rr.Scalars(decision.value))


def colour_of(track: TrackState) -> tuple[int, int, int]:
    """One colour per id; grey while tentative, pale while lost."""
    if track.state == "tentative":
        return 150, 150, 150
    saturation = 0.45 if track.state == "lost" else 0.85
    r, g, b = colorsys.hsv_to_rgb(track.track_id * 0.37 % 1.0, saturation, 1.0)
    return round(255 * r), round(255 * g), round(255 * b)


def _label(track: TrackState) -> str:
    height = "" if math.isnan(track.height_m) else f" {track.height_m:.2f} m"
    return f"{track.track_id}{height}" + ("" if track.state == "confirmed" else f" ({track.state})")


def _shapes(drawing: Drawing) -> rr.LineStrips3D | rr.LineStrips2D | rr.Points2D | rr.Points3D:
    labels = list(drawing.labels) or None
    points = drawing.strips and all(len(strip) == 1 for strip in drawing.strips)
    if drawing.plane == "image":
        flat = [np.asarray(strip, dtype=np.float32) for strip in drawing.strips]
        return rr.Points2D(np.concatenate(flat), labels=labels) if points else rr.LineStrips2D(flat, labels=labels)
    raised = [np.column_stack([strip, np.full(len(strip), 0.03)]) for strip in drawing.strips]
    if points:
        return rr.Points3D(np.concatenate(raised), labels=labels, radii=0.01)
    return rr.LineStrips3D(raised, labels=labels, colors=[0, 230, 120], radii=0.01)


def _grey_tile(tile: F32 | U8) -> U8:
    if tile.dtype == np.uint8:
        return np.asarray(tile, dtype=np.uint8)
    return np.clip(tile / max(float(tile.max()), 1e-9) * 255, 0, 255).astype(np.uint8)[::-1]


def _rgb(image: U8) -> U8:
    code = cv2.COLOR_GRAY2RGB if image.ndim == 2 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(image, code), dtype=np.uint8)


def _point_colours(stereo: StereoView, result: FrameResult) -> U8 | None:
    """(N, 3) RGB of the maps' points, each from its head's image; None without an image."""
    maps, image = result.observation.maps, result.observation.image
    if maps is None:
        return None
    pixels = maps.points.pixels
    if not result.heads:
        return None if image is None else _colours_at(image, pixels, stereo.shape[1], stereo.reduction)
    parts, start = [np.empty((0, 3), dtype=np.uint8)], 0
    for head in result.heads:
        mine = pixels[start : start + head.n_points]
        if head.image is not None and head.foreground is not None:
            width = head.foreground.shape[1]
            parts.append(_colours_at(head.image, mine, width, -(-head.image.shape[1] // width)))
        start += head.n_points
    return np.concatenate(parts)


def _colours_at(image: U8, pixels: I32, width: int, reduction: int) -> U8:
    rows, cols = np.divmod(pixels, width)
    return np.asarray(_rgb(image)[rows * reduction, cols * reduction], dtype=np.uint8)


def _floor_grid(stereo: StereoView) -> F32:
    """Outline of the floor in view."""
    x_min, y_min, x_max, y_max = shown_floor(stereo)
    corners = [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max), (x_min, y_min)]
    return np.array([(*corner, 0.0) for corner in corners], dtype=np.float32)
