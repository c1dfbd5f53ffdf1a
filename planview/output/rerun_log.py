"""A rerun recording of a run."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import rerun as rr

from calib.errors import InputError, WorkError
from calib.io import reason, refuse_full_disk, sync
from calib.types import U8
from planview.drawing.people import bounds_of
from planview.engine.engine import Engine, FrameResult
from planview.maps.grid import FloorRig
from planview.output import rerun_shapes as shapes
from planview.output.folder import rrd_parts
from planview.output.report.page import errors_of, scores_of
from planview.output.run_folder import RunFolder
from planview.tracking.base import person_boxes
from planview.trajectories.plot import person_rgb
from planview.trajectories.state import TrackState


def log_assessment(stream: rr.RecordingStream, results: RunFolder) -> None:
    """Log the truth of the recording and the errors against it, where there is one."""
    errors, truth = errors_of(scores_of(results)), results.truth
    if truth is not None and len(truth):
        # Points on the floor and at the heads, a row per frame; 1.7 m of a true person whose height is not known.
        frames, counts = np.unique(truth.frame, return_counts=True)
        heights = np.nan_to_num(truth.height_m, nan=1.7)
        times = rr.TimeColumn("time", duration=results.clock.at(frames))
        for path, z, radius in (("plan/truth", np.full(len(truth), 0.04), 0.06), ("world/truth", heights, 0.05)):
            places = np.column_stack([truth.x_m, truth.y_m, z]).astype(np.float32)
            columns = rr.Points3D.columns(positions=places).partition(counts)
            rr.send_columns(path, [rr.TimeColumn("frame", sequence=frames), times], columns, recording=stream)
            stream.log(path, rr.Points3D.from_fields(colors=[(255, 255, 255)], radii=[radius]), static=True)
    for error in errors:
        stream.set_time("frame", sequence=error.frame)
        stream.set_time("time", duration=float(results.clock.at(np.array([error.frame]))[0]))
        text = f"{error.kind.replace('_', ' ')}: {error.who}: {error.note}"
        stream.log("errors", rr.TextLog(text, level=rr.TextLogLevel.ERROR))


BOX_WIDTH_M = 0.5
"""Width of the boxes around people [m]."""


class RerunLog:
    """Writes ``run.rrd``.

    Args:
        resumed: the run resumes: rerun cannot continue a file, so another one begins, ``run-2.rrd`` and so on, which
            the viewer shows as one recording.
        every: images, clouds and maps of every n-th frame only; people, decisions and curves of all.
    Raises:
        WorkError: too little free disk space.
    """

    def __init__(self, engine: Engine, path: Path, every: int = 1, *, resumed: bool = False) -> None:
        number = len(rrd_parts(path)) + 1 if resumed else 1
        self._engine, self._path = engine, path if number == 1 else path.with_name(f"{path.stem}-{number}.rrd")
        refuse_full_disk(self._path)
        self._stereo, self._every = engine.stereo, every
        self._shown: set[str] = set()
        self._curves: set[str] = set()
        # Of the first frame, then three seconds later, when the foreground knows people; a resumed run has it in its
        # first file.
        self._scenes_at_s = [-math.inf] if self._stereo and not resumed else []
        self._frames = 0
        # All files belong to the same recording by its id; the viewer keeps a layout per application. Chunks of 10 s or
        # 2 MB: the default is five a second of each path.
        self._stream = rr.RecordingStream(
            "planview" if self._stereo else "planview-single", recording_id=f"planview-{path.parent.name}",
            batcher_config=rr.ChunkBatcherConfig(flush_tick=10.0),
        )  # fmt: skip
        self._stream.save(str(self._path))  # with a blueprint it would wait for ever on a disk without room for it
        self._stream.send_blueprint(shapes.blueprint(self._engine), make_active=False)
        self._keep("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        for n, (name, stereo) in enumerate(engine.rigs.items()):
            pose, geometry = stereo.floor.world_SE3_left, stereo.geometry
            place = rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation)
            lens = rr.Pinhole(
                image_from_camera=geometry.matrix, resolution=geometry.size, camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=0.4,
            )  # fmt: skip
            self._keep(f"world/{name}" if n else "world/camera", place, lens)
        if self._stereo:
            self._keep("world/floor", shapes.metre_grid(shapes.shown_floor(self._stereo)))

    def _keep(self, path: str, *things: rr.AsComponents) -> None:
        """Log what holds for all frames."""
        self._stream.log(path, *things, static=True)

    def mark(self) -> dict[str, int]:
        self._flush()
        sync(self._path)
        return {}

    def frame(self, result: FrameResult) -> None:
        """Log one frame, on the timelines ``frame`` and ``time``."""
        refuse_full_disk(self._path)
        self._stream.set_time("frame", sequence=result.frame)
        self._stream.set_time("time", duration=result.timestamp_s)
        self._log_scene(result)
        if result.frame % self._every == 0:
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
        self._frames += 1
        # So many frames may wait for rerun's thread: on a busy machine they would pile up in memory.
        if self._frames % 100 == 0:
            self._flush()

    def close(self) -> None:
        with suppress(InputError, WorkError):  # tables that cannot be read
            results = RunFolder(self._path.parent)
            xy = np.column_stack([results.tracks.x_m, results.tracks.y_m])[results.tracks.state == "confirmed"]
            if np.isfinite(xy).any():
                bounds = bounds_of(xy)
                self._keep("plan/grid", shapes.metre_grid(bounds))
                self._stream.send_blueprint(shapes.blueprint(self._engine, bounds))
            log_assessment(self._stream, results)
        self.mark()
        self._stream.disconnect()  # where rerun's thread could not write it would wait for ever
        sync(self._path)

    def _flush(self) -> None:
        """Wait for rerun's thread as long as the file grows; the thread may end without a word when it cannot write."""
        size = -1
        while True:
            try:
                return self._stream.flush(timeout_sec=4.0)
            except (RuntimeError, ValueError) as error:
                before, size = size, self._path.stat().st_size
                if size == before:
                    # Neither the end of Python nor that of the stream, which is kept for ever, waits for the thread.
                    rr.unregister_shutdown()
                    ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._stream))
                    problem = f"{self._path}: cannot be written ({reason(error)}); earlier frames are kept"
                    raise WorkError(problem) from error

    def _log_scene(self, result: FrameResult) -> None:
        due_s, depth = self._scenes_at_s, result.depth
        if due_s and result.timestamp_s >= due_s[0] and self._stereo is not None and depth is not None:
            self._keep("world/scene", shapes.scene_cloud(depth, result.views[0], self._stereo))
            self._keep("plan/floor", shapes.floor_image(depth.picture(), self._stereo))
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
        floor, image = shapes.facing_arrows(tracks, self._engine.camera)
        for path, arrows in (("world/facing", floor), ("plan/facing", floor), ("image/facing", image)):
            self._stream.log(path, arrows)
        ids, beside = [str(track.track_id) for track in tracks], [(x + shapes.LABEL_M, y, 0.06) for x, y, _ in places]
        self._stream.log("plan/labels", rr.Points3D(beside, colors=colours, labels=ids, radii=0.001))

    def _log_series(self, result: FrameResult) -> None:
        values = {f"time_ms/{stage}": duration for stage, duration in result.stages_ms.items()}
        values["people/confirmed"] = float(sum(track.state == "confirmed" for track in result.tracks))
        for decision in result.decisions:
            if decision.kind == "matched" and not math.isnan(decision.value):
                path = f"score/{decision.track_id}"
                if path not in self._curves:  # the curve has the person's colour
                    self._curves.add(path)
                    line = rr.SeriesLines(colors=[person_rgb(decision.track_id)], names=[str(decision.track_id)])
                    self._keep(path, line)
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
