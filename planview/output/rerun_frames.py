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
        self._engine, self._stereo, self._stream = engine, engine.stereo, stream
        self._shown: set[str] = set()
        self._curves: set[str] = set()
        # Of the first frame, then three seconds later, when the foreground knows people.
        self._scenes_at_s = [-math.inf] if self._stereo and has_scene else []
        self.keep("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        for n, (name, stereo) in enumerate(engine.rigs.items()):
            pose, geometry = stereo.floor.world_SE3_left, stereo.geometry
            place = rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation)
            lens = rr.Pinhole(
                image_from_camera=geometry.matrix, resolution=geometry.size, camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=0.4,
            )  # fmt: skip
            self.keep(f"world/{name}" if n else "world/camera", place, lens)
        if self._stereo:
            self.keep("world/floor", shapes.metre_grid(shapes.shown_floor(self._stereo)))

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
        for decision in result.decisions:
            if decision.kind != "matched":
                level = rr.TextLogLevel.WARN if decision.kind == "lost" else rr.TextLogLevel.INFO
                text = f"{decision.track_id} {decision.kind}: {decision.reason}"
                self._stream.log(f"decisions/{decision.track_id}", rr.TextLog(text, level=level))
        self._log_series(result)

    def _log_scene(self, result: FrameResult) -> None:
        due_s, depth = self._scenes_at_s, result.depth
        if due_s and result.timestamp_s >= due_s[0] and self._stereo is not None and depth is not None:
            self.keep("world/scene", shapes.scene_cloud(depth, result.views[0], self._stereo))
            self.keep("plan/floor", shapes.floor_image(depth.picture(), self._stereo))
            self._scenes_at_s = [result.timestamp_s + 3.0] if math.isinf(due_s[0]) else []

    def _log_images(self, result: FrameResult) -> None:
        """What takes room: images, cloud, maps and what the tracker looked at."""
        for n, (head, view) in enumerate(zip(self._engine.heads, result.views, strict=True)):
            image = view.image if view.depth is None else view.depth.picture()
            self._log_image(f"{head.name}/image" if n else "image", image, view.foreground)
        if self._stereo:
            self._log_depth(self._stereo, result)
        debug = self._engine.tracker.debug()
        names = set[str]()
        for drawing in debug.drawings:
            path = f"{'plan' if drawing.plane == 'floor' else 'image'}/{drawing.name}"
            names.add(path)
            self._stream.log(path, shapes.strips_of(drawing))
        if tiles := shapes.templates(result) | debug.tiles:
            names.add("templates")
            self._stream.log("templates", rr.Image(shapes.mosaic(tiles)))
        for name in self._shown - names:
            self._stream.log(name, rr.Clear(recursive=False))
        self._shown = names

    def _log_image(self, path: str, image: U8 | None, foreground: U8 | None) -> None:
        if image is None:
            return
        self._stream.log(f"{path}/left", shapes.photo(image))
        mask = np.zeros((1, 1), np.uint8) if foreground is None else foreground
        self._stream.log(f"{path}/foreground", shapes.outlines(mask, (image.shape[1], image.shape[0])))

    def _log_depth(self, stereo: FloorRig, result: FrameResult) -> None:
        """Disparity, the foreground cloud in colour, and the maps."""
        if result.depth is not None:
            self._stream.log("disparity", shapes.disparity_photo(result.depth.disparity, stereo))
        if any(view.depth is not None for view in result.views):
            self._stream.log("world/foreground", shapes.foreground_points(result))
        if (maps := result.observation.maps) is not None:
            highest, density = self._engine.config.maps.height_max_m, maps.occupancy / maps.grid.cell_m**2
            self._stream.log("plan/height", shapes.map_image(maps.height, highest, stereo))
            self._stream.log("plan/occupancy", shapes.map_image(density, 4.0, stereo))

    def _log_boxes(self, path: str, people: Sequence[TrackState]) -> None:
        tracks = [t for t in people if t.state != "tentative" and not math.isnan(t.box_px[0])]
        boxes = np.array([track.box_px for track in tracks], dtype=np.float32).reshape(-1, 4)
        labels, colours = _labels_and_colours(tracks)
        shown = rr.Boxes2D(array=boxes, array_format=rr.Box2DFormat.XYWH, labels=labels, colors=colours)
        self._stream.log(f"{path}/people", shown)

    def _log_bodies(self, tracks: list[TrackState]) -> None:
        labels, colours = _labels_and_colours(tracks)
        places = [(track.x_m, track.y_m, 1.7 if math.isnan(track.height_m) else track.height_m) for track in tracks]
        boxes = rr.Boxes3D(
            centers=[(x, y, z / 2) for x, y, z in places], sizes=[(BOX_WIDTH_M, BOX_WIDTH_M, z) for *_, z in places],
            colors=colours, labels=labels,
        )  # fmt: skip
        self._stream.log("world/people", boxes)
        feet = [(x, y, 0.05) for x, y, _ in places]
        # The blueprint shows those of some seconds together.
        trails = "world/trails" if self._stereo else "plan/trails"
        self._stream.log(trails, rr.Points3D(feet, colors=colours, radii=0.03))
        self._stream.log("plan/people", rr.Points3D(feet, colors=colours, radii=0.05))
        floor, image = shapes.facing_shapes(tracks, self._engine.camera)
        for path, parts in (("world/facing", floor), ("plan/facing", floor), ("image/facing", image)):
            self._stream.log(path, *parts)
        ids, label_at = [str(track.track_id) for track in tracks], [(x + shapes.LABEL_M, y, 0.06) for x, y, _ in places]
        self._stream.log("plan/labels", rr.Points3D(label_at, colors=colours, labels=ids, radii=0.001))

    def _log_series(self, result: FrameResult) -> None:
        values = {f"time_ms/{stage}": duration for stage, duration in result.stages_ms.items()}
        values["people/confirmed"] = float(sum(track.state == "confirmed" for track in result.tracks))
        for decision in result.decisions:
            if decision.kind == "matched" and not math.isnan(decision.value):
                path = f"score/{decision.track_id}"
                if path not in self._curves:  # the curve has the person's colour
                    self._curves.add(path)
                    line = rr.SeriesLines(colors=[person_rgb(decision.track_id)], names=[str(decision.track_id)])
                    self.keep(path, line)
                values[path] = decision.value
        for path, value in values.items():
            self._stream.log(path, rr.Scalars(value))


def _labels_and_colours(tracks: Sequence[TrackState]) -> tuple[list[str], list[tuple[int, int, int]]]:
    """Id, height and state of people, and the colours of their ids."""
    labels = []
    for track in tracks:
        height = "" if math.isnan(track.height_m) else f" {track.height_m:.2f} m"
        labels.append(f"{track.track_id}{height}" + ("" if track.state == "confirmed" else f" ({track.state})"))
    return labels, [person_rgb(track.track_id, track.state) for track in tracks]
