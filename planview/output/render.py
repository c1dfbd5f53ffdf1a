"""The recording of a run, opened again, and pictures and videos of the run."""

from __future__ import annotations

import os
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from calib.errors import InputError, WorkError
from calib.images import as_colour, write_image
from calib.io import PART
from calib.libraries import import_open3d
from calib.types import U8
from planview.counting.events import Event, way_words
from planview.drawing.image import ImagePainter
from planview.drawing.people import Snapshot, snapshot_at
from planview.drawing.plan import PlanBounds, PlanPainter
from planview.engine.config import Config
from planview.engine.open import open_source
from planview.engine.setup import set_up
from planview.maps.recording import MapsRecording
from planview.output.folder import writing
from planview.output.run_folder import RunFolder
from stereo.depth import median_image, point_cloud
from stereo.floor import setup_frames
from stereo.readers import OpenOptions, holds_pair, open_any
from stereo.readers.open import SeveralHeads
from stereo.recording import DepthCamera, Frame, OneCamera, Recording, Shot
from stereo.rectify import Rectifier
from stereo.rgbd import RgbdRectifier

if TYPE_CHECKING:
    from open3d.geometry import PointCloud

HEADER_PX, LINE_PX = 30, 22
ALONE_PX = (960, 720)
"""Size of the floor where there is no image."""
_INK, _BACK, _FONT = (40, 40, 40), (255, 255, 255), cv2.FONT_HERSHEY_SIMPLEX


def tally(events: Sequence[Event], rules: Mapping[str, Any], frame: int) -> list[str]:
    """What each rule of (all) events has counted up to a frame; ``rules``: see ``RunFolder.rule_counts``."""
    known = [(event.rule, str(event.direction or event.kind)) for event in events if event.frame <= frame]
    count = Counter(known)
    lines = []
    for rule, kind in {event.rule: event.kind for event in sorted(events, key=lambda e: e.frame)}.items():
        if kind == "crossing":
            inward, ways = rules.get(rule, {}).get("inward"), ("left_to_right", "right_to_left")
            parts = [f"{count[rule, way]} {way_words(way, inward)}" for way in ways]
        else:
            entries = count[rule, "entry"]
            parts = [f"{entries - count[rule, 'exit']} inside", f"{entries} entries"]
        lines.append(f"{rule}: {', '.join(parts)}")
    return lines


class SceneComposer:
    """Draws frames of a run: the image with people, and the floor from above.

    Args:
        bounds: of the floor that is shown; where people were when None.
    """

    def __init__(
        self,
        results: RunFolder,
        trail_s: float = 4.0,
        *,
        plan: bool = True,
        truth: bool = True,
        bounds: PlanBounds | None = None,
    ) -> None:
        self._results = results
        self._bounds = bounds or results.bounds()
        self._trail = round(trail_s / results.clock.frame_s)
        self._truth = results.truth if truth else None
        self._with_plan = plan and results.on_floor
        self._image = ImagePainter(results.camera, results.rules, self._bounds)
        self._plan: PlanPainter | None = None

    def __call__(self, frame: int, image: U8 | None) -> U8:
        """(H, W, 3) uint8 BGR with even H and W; ``image``: (h, w[, 3]) uint8 BGR, None where it cannot be read."""
        snapshot = snapshot_at(self._results.tracks, frame, self._trail, self._truth)
        counted = tally(self._results.events, self._results.rule_counts, frame)
        panels = [] if image is None else [self._image(image, snapshot)]
        if self._with_plan or image is None:
            height = panels[0].shape[0] if panels else ALONE_PX[1]
            panels.append(self._floor(snapshot, height, counted, alone=not panels))
        picture = np.hstack(panels)
        header: U8 = np.full((HEADER_PX, picture.shape[1], 3), _BACK, dtype=np.uint8)
        time_s = float(self._results.clock.at(np.array([frame]))[0])
        people = np.count_nonzero(self._results.tracks.frame[self._results.of_people] == frame)
        text = f"frame {frame}   {time_s:.2f} s   {people} {'person' if people == 1 else 'people'}"
        if image is not None and not self._with_plan:  # which has room for what rules count
            text = "   ".join([text, *counted])
        cv2.putText(header, text, (8, HEADER_PX - 10), _FONT, 0.5, _INK, 1, cv2.LINE_AA)
        whole = np.vstack([header, picture])
        return np.ascontiguousarray(whole[: whole.shape[0] // 2 * 2, : whole.shape[1] // 2 * 2])

    def _floor(self, snapshot: Snapshot, height: int, counted: list[str], *, alone: bool) -> U8:
        """The floor from above, with the counts below it."""
        below = LINE_PX * len(counted) + (8 if counted else 0)
        # Width of the floor as a share of the image's height.
        size = ALONE_PX[0] if alone else round(0.75 * height), height - below
        if self._plan is None:
            self._plan = PlanPainter(self._bounds, size, self._results.cameras, self._results.rules)
        text: U8 = np.full((below, size[0], 3), _BACK, dtype=np.uint8)
        for n, line in enumerate(counted):
            cv2.putText(text, line, (8, LINE_PX * (n + 1) - 4), _FONT, 0.45, _INK, 1, cv2.LINE_AA)
        return np.vstack([self._plan(snapshot), text])


CODECS = {".mp4": "vp09", ".webm": "VP80", ".avi": "MJPG", ".mkv": "VP80"}
"""By ending: what OpenCV's wheels write and browsers play, VP9 in .mp4 and VP8 in .webm; they have no H.264 encoder."""


@contextmanager
def _silent() -> Iterator[None]:
    """Without what libraries in C print: OpenCV does not know that .webm holds VP8, and warns of it."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def write_video(path: Path, fps: float, pictures: Iterable[U8]) -> int:
    """Write pictures of one size into a video, which is at its place when all are written; how many there were. Raises
    InputError: the path does not end like a video. WorkError: it cannot be written."""
    codec = CODECS.get(path.suffix.lower())
    if codec is None:
        raise InputError(f"{path}: expected a video's name ({', '.join(CODECS)}), found {path.name!r}")
    part, writer, count = path.with_name(f"{path.stem}{PART}{path.suffix}"), cv2.VideoWriter(), 0
    try:
        for count, picture in enumerate(pictures, 1):
            if count == 1:
                with writing(path):
                    path.parent.mkdir(parents=True, exist_ok=True)
                with _silent():
                    opened = writer.open(str(part), cv2.VideoWriter.fourcc(*codec), fps, picture.shape[1::-1])
                if not opened:
                    raise WorkError(f"{path}: the video cannot be written")
            writer.write(picture)
        writer.release()
        if count:
            with writing(path):
                part.replace(path)
    finally:
        writer.release()
        part.unlink(missing_ok=True)
    return count


def scene_pictures_of(
    composer: SceneComposer, frames: SceneFrames | None, first: int, last: int, every: int
) -> Iterator[U8]:
    """Pictures of every n-th frame; a frame that cannot be read shows the image before it."""
    frames_due = deque(range(first, last + 1, every))
    if frames is None:
        yield from (composer(frame, None) for frame in frames_due)
        return
    for index, image in frames.through(first, last):
        while frames_due and frames_due[0] <= index:
            yield composer(frames_due.popleft(), image)


def write_still(composer: SceneComposer, frames: SceneFrames | None, frame: int, path: Path) -> None:
    """Write a picture of one frame; the floor alone where its image cannot be read."""
    image = next((image for _, image in frames.at([frame])), None) if frames is not None else None
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_image(path, composer(frame, image))


class SceneFrames:
    """Images of a recording, of several heads those of the first, as frame and (H, W[, 3]) uint8 BGR, in whose pixels
    the boxes of tracks.csv are."""

    def __init__(self, recording: Recording[Any] | SeveralHeads, image_of: Callable[[Shot], U8]) -> None:
        self._recording, self._image_of = recording, image_of

    def at(self, frames: Sequence[int]) -> Iterator[tuple[int, U8]]:
        """The images of ascending frames, as far as they can be read."""
        yield from self._shown(self._recording.at(frames))

    def through(self, first: int, last: int) -> Iterator[tuple[int, U8]]:
        """All images from one frame to another, both included."""
        if last >= 0:
            upto = takewhile(lambda frame: frame.index <= last, iter(self._recording))
            yield from self._shown(frame for frame in upto if frame.index >= first)

    def _shown(self, frames: Iterable[Frame[Any]]) -> Iterator[tuple[int, U8]]:
        for frame in frames:
            if frame.images:
                yield frame.index, self._image_of(frame.images)


def open_frames(run: RunFolder) -> SceneFrames:
    """Open the recording of a run again. Raises InputError: it is missing, or another version made the run."""
    path, rig = run.recording, run.info.rig
    if path is None or not path.exists():
        raise InputError(f"{path}: expected the recording of the run, found nothing there")
    recording = open_source(path, run.options, rig is None or (rig.baseline_m is None and rig.depth_sensor is None))
    if isinstance(recording, MapsRecording):
        raise InputError(f"{path}: expected a recording with images, found plan-view maps")
    head = recording.parts[0].head
    if isinstance(head, OneCamera):
        return SceneFrames(recording, lambda shot: shot[0])
    if isinstance(head, DepthCamera):
        sensor = RgbdRectifier(head.camera, head.sensor, run.config.rectify)
        return SceneFrames(recording, lambda shot: sensor(*shot)[0])
    pair = Rectifier(head.rig, run.config.rectify)
    return SceneFrames(recording, lambda shot: pair(*shot).image)


def frames_or_none(run: RunFolder, warn: Callable[[str], object]) -> SceneFrames | None:
    """``open_frames``, or None and a warning."""
    try:
        return open_frames(run)
    except (InputError, WorkError) as error:
        warn(f"no images, only the floor: {error}")
        return None


def scene_of(path: Path, options: OpenOptions | None = None) -> PointCloud:
    """Points of what does not move, in the world frame of the tracks, of a run's folder or a recording of one rig.
    Raises InputError: no recording of a pair or of images with depth. WorkError: no floor is visible."""
    config, recording, options = Config(), path, options or OpenOptions()
    if (path / "run.json").is_file():
        run = RunFolder(path)
        config, recording = run.config, run.recording or path
        options = options if options.calibration else run.options
    if not recording.exists() or not (options.calibration or holds_pair(recording, options)):
        raise InputError(f"{recording}: expected a recording of a stereo pair or of images with depth, found none")
    opened = open_any(recording, options)
    rig = set_up(opened, config)
    depths = [rig.measure(frame.images) for frame in setup_frames(opened, config.analysis.setup_frames)]
    colours = np.median(np.stack([as_colour(depth.image) for depth in depths]), axis=0).astype(np.uint8)
    disparity, pose = median_image([depth.disparity for depth in depths]), rig.floor.world_SE3_left
    return point_cloud(disparity, colours, rig.geometry, pose, rig.reduction)


def write_cloud(path: Path, cloud: PointCloud) -> int:
    """Write a cloud, thinned and without outliers, in the format of the file's name (.ply, .pcd, .xyz), and return how
    many points it has. Raises InputError: another format. WorkError: open3d is missing, or the file cannot be written.
    """
    if path.suffix.lower() not in (".ply", ".pcd", ".xyz"):
        raise InputError(f"{path}: expected a name that ends in .ply, .pcd or .xyz")
    o3d = import_open3d("a cloud of points")
    # Points are thinned to one in a cube of this side [m] (our choice: half a cell of the maps).
    # Out goes a point whose mean distance to 16 neighbours is 2 deviations above the mean of all (values of open3d's
    # documentation, rounded).
    thin, _ = cloud.voxel_down_sample(0.015).remove_statistical_outlier(16, 2.0)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    if not o3d.io.write_point_cloud(str(path), thin):
        raise WorkError(f"{path}: cannot be written")
    return len(thin.points)
