"""Frames as rerun shows them: images, clouds, maps, people, curves and decisions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import rerun as rr

from calib.types import U8
from planview.engine.engine import Engine, FrameResult
from planview.maps.grid import FloorRig
from planview.output import rerun_shapes as shapes
from planview.tracking.base import person_boxes
from planview.trajectories.plot import person_rgb
from planview.trajectories.state import TrackState

BOX_WIDTH_M = 0.5
"""Width of the boxes around people [m]."""


class RerunFrames:
    """Logs the frames of a run to a stream.

    Args:
        has_scene: log what the scene holds besides people, too.
    """

    def __init__(self, engine: Engine, stream: rr.RecordingStream, *, has_scene: bool = True) -> None:
        self._engine = engine
        self._layout = shapes.layout_of(engine)
        self._stream = stream
        self._shown: set[str] = set()
        self._curves: set[str] = set()
        # Of the first frame, then three seconds later, when the foreground shows people.
        self._scenes_at_s = [-math.inf] if has_scene else []
        self.keep("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        names = ["camera", *[*engine.rigs][1:]]
        for name, rig in zip(names, engine.rigs.values(), strict=False):
            pose = rig.floor.world_SE3_left
            lens = rr.Pinhole(
                image_from_camera=rig.geometry.matrix,
                resolution=rig.geometry.size,
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=0.4,
            )
            self.keep(f"world/{name}", rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation), lens)
        for rig in [*engine.rigs.values()][:1]:
            self.keep("world/floor", shapes.metre_grid(shapes.shown_floor(rig)))

    def keep(self, path: str, *things: rr.AsComponents) -> None:
        """Log what holds for all frames."""
        self._stream.log(path, *things, static=True)

    def log(self, result: FrameResult, *, has_images: bool) -> None:
        """Log one frame, on the timelines ``frame`` and ``time``; people, decisions and curves alone without images."""
        self._stream.set_time("frame", sequence=result.frame)
        self._stream.set_time("time", duration=result.timestamp_s)
        self._log_scene(result)
        if has_images:
            self._log_images(result)
        places = [(track.x_m, track.y_m, track.height_m) for track in result.tracks]
        for name, rig in list(self._engine.rigs.items())[1:]:
            boxes = person_boxes(rig.camera, places)
            tracks = [replace(track, box_px=box) for track, box in zip(result.tracks, boxes, strict=True)]
            self._log_boxes(f"{name}/image", tracks)
        self._log_boxes("image", result.tracks)
        self._log_bodies([t for t in result.tracks if t.state != "tentative" and not math.isnan(t.x_m)])
        self._log_decisions(result)
        self._log_series(result)

    def _log_scene(self, result: FrameResult) -> None:
        if result.depth is None or not self._scenes_at_s:
            return
        stereo = self._engine.stereo
        due_s = self._scenes_at_s[0]
        if result.timestamp_s >= due_s:
            self.keep("world/scene", shapes.scene_cloud(result.depth, result.views[0], stereo))
            self.keep("plan/floor", shapes.floor_image(result.depth.picture(), stereo))
            self._scenes_at_s = [result.timestamp_s + 3.0] if math.isinf(due_s) else []

    def _log_images(self, result: FrameResult) -> None:
        """Log what takes room: images, cloud, maps and what the tracker looked at."""
        path = "image"
        for sensor, view in zip(self._engine.sensors, result.views, strict=True):
            if sensor is not self._engine.sensors[0]:
                path = f"{sensor.name}/image"
            image = view.image if view.depth is None else view.depth.picture()
            if image is not None:
                self._log_image(path, image, view.foreground)
        for rig in [*self._engine.rigs.values()][:1]:
            self._log_depth(rig, result)
        self._log_drawings(result)

    def _log_image(self, path: str, image: U8, foreground: U8 | None) -> None:
        self._stream.log(f"{path}/left", shapes.photo(image))
        mask = np.zeros((1, 1), np.uint8) if foreground is None else foreground
        self._stream.log(f"{path}/foreground", shapes.outlines(mask, (image.shape[1], image.shape[0])))

    def _log_depth(self, stereo: FloorRig, result: FrameResult) -> None:
        """Disparity, the foreground cloud in colour, and the maps."""
        if result.depth is not None:
            self._stream.log("disparity", shapes.disparity_photo(result.depth.disparity, stereo))
        if any(view.depth is not None for view in result.views):
            self._stream.log("world/foreground", shapes.foreground_points(result))
        maps = result.observation.maps
        if maps is not None:
            density = maps.occupancy / maps.grid.cell_m**2
            self._stream.log(
                "plan/height", shapes.map_image(maps.height, self._engine.config.maps.height_max_m, stereo)
            )
            self._stream.log("plan/occupancy", shapes.map_image(density, 4.0, stereo))

    def _log_drawings(self, result: FrameResult) -> None:
        """Log what the tracker draws, and clear what it drew before and draws no more."""
        debug = self._engine.tracker.debug()
        names = set[str]()
        for drawing in debug.drawings:
            plane = "plan" if drawing.plane == "floor" else "image"
            names.add(f"{plane}/{drawing.name}")
            self._stream.log(f"{plane}/{drawing.name}", shapes.strips_of(drawing))
        tiles = shapes.templates(result) | debug.tiles
        if tiles:
            names.add("templates")
            self._stream.log("templates", rr.Image(shapes.mosaic(tiles)))
        for name in self._shown - names:
            self._stream.log(name, rr.Clear(recursive=False))
        self._shown = names

    def _log_boxes(self, path: str, people: Sequence[TrackState]) -> None:
        tracks = [t for t in people if t.state != "tentative" and not math.isnan(t.box_px[0])]
        boxes = rr.Boxes2D(
            array=np.array([track.box_px for track in tracks], dtype=np.float32).reshape(-1, 4),
            array_format=rr.Box2DFormat.XYWH,
            labels=list(map(_label, tracks)),
            colors=_colours(tracks),
        )
        self._stream.log(f"{path}/people", boxes)

    def _log_bodies(self, tracks: list[TrackState]) -> None:
        colours = _colours(tracks)
        centres = []
        sizes = []
        feet = []
        label_places = []
        for track in tracks:
            height_m = 1.7 if math.isnan(track.height_m) else track.height_m
            centres.append((track.x_m, track.y_m, height_m / 2))
            sizes.append((BOX_WIDTH_M, BOX_WIDTH_M, height_m))
            feet.append((track.x_m, track.y_m, 0.05))
            label_places.append((track.x_m + shapes.LABEL_M, track.y_m, 0.06))
        boxes = rr.Boxes3D(centers=centres, sizes=sizes, colors=colours, labels=list(map(_label, tracks)))
        self._stream.log("world/people", boxes)
        # The blueprint shows those of some seconds together.
        self._stream.log(self._layout.trails, rr.Points3D(feet, colors=colours, radii=0.03))
        self._stream.log("plan/people", rr.Points3D(feet, colors=colours, radii=0.05))
        floor, image = shapes.facing_shapes(tracks, self._engine.camera)
        self._stream.log("world/facing", *floor)
        self._stream.log("plan/facing", *floor)
        self._stream.log("image/facing", *image)
        ids = [str(track.track_id) for track in tracks]
        self._stream.log("plan/labels", rr.Points3D(label_places, colors=colours, labels=ids, radii=0.001))

    def _log_decisions(self, result: FrameResult) -> None:
        for decision in result.decisions:
            if decision.kind != "matched":
                level = rr.TextLogLevel.WARN if decision.kind == "lost" else rr.TextLogLevel.INFO
                text = f"{decision.track_id} {decision.kind}: {decision.reason}"
                self._stream.log(f"decisions/{decision.track_id}", rr.TextLog(text, level=level))

    def _log_series(self, result: FrameResult) -> None:
        for stage, duration_ms in result.stages_ms.items():
            self._stream.log(f"time_ms/{stage}", rr.Scalars(duration_ms))
        confirmed = sum(track.state == "confirmed" for track in result.tracks)
        self._stream.log("people/confirmed", rr.Scalars(float(confirmed)))
        for decision in result.decisions:
            if decision.kind != "matched" or math.isnan(decision.value):
                continue
            path = f"score/{decision.track_id}"
            if path not in self._curves:  # the curve has the person's colour
                self._curves.add(path)
                colour = person_rgb(decision.track_id)
                self.keep(path, rr.SeriesLines(colors=[colour], names=[str(decision.track_id)]))
            self._stream.log(path, rr.Scalars(decision.value))


def _label(track: TrackState) -> str:
    """Id, height and state of a person."""
    label = str(track.track_id)
    if not math.isnan(track.height_m):
        label += f" {track.height_m:.2f} m"
    if track.state != "confirmed":
        label += f" ({track.state})"
    return label


def _colours(tracks: Sequence[TrackState]) -> list[tuple[int, int, int]]:
    return [person_rgb(track.track_id, track.state) for track in tracks]
