"""The recording of a run, opened again, and pictures and videos of the run."""

from __future__ import annotations

import os
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import singledispatch
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

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
from planview.output.folder import writing
from planview.output.run_folder import RunFolder
from planview.progress import Progress, unseen
from stereo.depth import median_image, point_cloud
from stereo.floor import frames_of_one_view
from stereo.readers import OpenOptions
from stereo.readers.base import AnyRecording
from stereo.readers.open import OF_TWO_IMAGES, READERS, SeveralSensors, open_by
from stereo.recording import DepthCamera, Frame, Recording, Shot, SingleCamera, StereoPair
from stereo.rectify import Rectifier, RectifyParams
from stereo.rgbd import RgbdRectifier

if TYPE_CHECKING:
    from open3d.geometry import PointCloud

HEADER_PX = 30
LINE_PX = 22
ALONE_PX = (960, 720)
"""Size of the floor where there is no image."""
PLAN_SHARE = 0.75
"""Width of the floor as a share of the height of the image next to it."""
MARKS = "arrow: faces there; bar: faces along it, either way; thin box: hidden; black: the truth"
"""Legend of pictures with people who face somewhere."""
_INK = (40, 40, 40)
_BACK = (255, 255, 255)


def tally(events: Sequence[Event], rules: Mapping[str, Any], frame: int) -> list[str]:
    """Counts of each rule of (all) events up to a frame; ``rules``: see ``RunFolder.rule_counts``."""
    past = [event for event in events if event.frame <= frame]
    count = Counter((event.rule, str(event.direction or event.kind)) for event in past)
    kinds = {event.rule: event.kind for event in sorted(events, key=lambda event: event.frame)}
    lines = []
    for rule, kind in kinds.items():
        if kind == "crossing":
            inward = rules.get(rule, {}).get("inward")
            parts = [f"{count[rule, way]} {way_words(way, inward)}" for way in ("left_to_right", "right_to_left")]
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
        self._trail_frames = round(trail_s / results.clock.frame_s)
        self._truth = results.truth if truth else None
        self._with_plan = plan and results.on_floor
        self._image = ImagePainter(results.camera, results.rules, self._bounds)
        self._plan: PlanPainter | None = None

    def __call__(self, frame: int, image: U8 | None) -> U8:
        """(H, W, 3) uint8 BGR with even H and W; ``image``: (h, w[, 3]) uint8 BGR, None where it cannot be read."""
        snapshot = snapshot_at(self._results.tracks, frame, self._trail_frames, self._truth)
        counts = tally(self._results.events, self._results.rule_counts, frame)
        title = self._title(frame)
        if image is None:
            width, height = ALONE_PX
            picture = self._floor(snapshot, width, height, counts)
        else:
            picture = self._image(image, snapshot)
            if self._with_plan:
                height = picture.shape[0]
                picture = np.hstack([picture, self._floor(snapshot, round(PLAN_SHARE * height), height, counts)])
            else:  # which has room for what rules count
                title = "   ".join([title, *counts])
        header = blank(HEADER_PX, picture.shape[1])
        write_text(header, title, HEADER_PX - 10, 0.5)
        legend = blank(LINE_PX, picture.shape[1])
        if np.isfinite(self._results.tracks.facing_deg).any():
            write_text(legend, MARKS, LINE_PX - 7, 0.42)
        whole = np.vstack([header, picture, legend])
        return np.ascontiguousarray(whole[: whole.shape[0] // 2 * 2, : whole.shape[1] // 2 * 2])

    def _title(self, frame: int) -> str:
        """Number and time of a frame, and how many people are there."""
        results = self._results
        time_s = float(results.clock.at(np.array([frame]))[0])
        people = np.count_nonzero(results.tracks.frame[results.of_people] == frame)
        return f"frame {frame}   {time_s:.2f} s   {people} {'person' if people == 1 else 'people'}"

    def _floor(self, snapshot: Snapshot, width: int, height: int, counts: list[str]) -> U8:
        """The floor from above, with the counts below it."""
        below = blank(LINE_PX * len(counts) + (8 if counts else 0), width)
        for n, line in enumerate(counts, 1):
            write_text(below, line, LINE_PX * n - 4, 0.45)
        if self._plan is None:
            size = width, height - below.shape[0]
            self._plan = PlanPainter(self._bounds, size, self._results.cameras, self._results.rules)
        return np.vstack([self._plan(snapshot), below])


def blank(height: int, width: int) -> U8:
    """A white picture."""
    return np.full((height, width, 3), _BACK, dtype=np.uint8)


def write_text(picture: U8, text: str, bottom: int, scale: float) -> None:
    cv2.putText(picture, text, (8, bottom), cv2.FONT_HERSHEY_SIMPLEX, scale, _INK, 1, cv2.LINE_AA)


CODECS = {".mp4": "vp09", ".webm": "VP80", ".avi": "MJPG", ".mkv": "VP80"}
"""By ending: what OpenCV's wheels write and browsers play, VP9 in .mp4 and VP8 in .webm; they have no H.264 encoder."""


@contextmanager
def _silent() -> Iterator[None]:
    """Hide what libraries in C print: OpenCV warns that .webm cannot hold VP8, which it can."""
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def write_video(path: Path, fps: float, pictures: Iterable[U8]) -> int:
    """Write pictures of one size into a video, which is at its place when all are written, and return how many there
    were. Raises InputError: the path does not end like a video. WorkError: it cannot be written."""
    codec = CODECS.get(path.suffix.lower())
    if codec is None:
        raise InputError(f"{path}: expected a video's name ({', '.join(CODECS)}), found {path.name!r}")
    part = path.with_name(f"{path.stem}{PART}{path.suffix}")
    writer = cv2.VideoWriter()
    count = 0
    try:
        for count, picture in enumerate(pictures, 1):
            if count == 1:
                with writing(path):
                    path.parent.mkdir(parents=True, exist_ok=True)
                with _silent():
                    is_open = writer.open(str(part), cv2.VideoWriter.fourcc(*codec), fps, picture.shape[1::-1])
                if not is_open:
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


def render_frames(
    composer: SceneComposer, run: RunFolder, frames: range, path: Path, progress: Progress = unseen
) -> Path:
    """Write frames of a run as a video; one that cannot be read shows the image before it. Raises InputError: no such
    frames. WorkError: none can be read, or the video cannot be written."""
    if frames.start >= run.n_frames:
        raise InputError(f"{run.path}: expected frames from {frames.start} on, found {run.n_frames}")
    due = range(frames.start, min(frames.stop, run.n_frames), frames.step)
    pictures = _pictures(composer, frames_or_none(run, warnings.warn), due, progress)
    if not write_video(path, min(240.0, 1.0 / run.clock.frame_s), pictures):
        raise WorkError(f"{path}: none of the frames {due.start} to {due.stop - 1} can be read")
    return path


def _pictures(composer: SceneComposer, frames: SceneFrames | None, due: range, progress: Progress) -> Iterator[U8]:
    images = ((frame, None) for frame in due) if frames is None else frames.through(due.start, due.stop - 1)
    left = deque(due)
    for index, image in images:
        while left and left[0] <= index:
            yield composer(left.popleft(), image)
            progress(len(due) - len(left), len(due))


def render_frame(composer: SceneComposer, run: RunFolder, frame: int, path: Path) -> Path:
    """Write a picture of one frame; the floor alone where its image cannot be read."""
    frames = frames_or_none(run, warnings.warn)
    picture = composer(frame, None if frames is None else frames.image(frame))
    with writing(path):
        write_image(path, picture)
    return path


class SceneFrames:
    """Images of a recording, of several sensors those of the first, as frame and (H, W[, 3]) uint8 BGR, in whose pixels
    the boxes of tracks.csv are."""

    def __init__(self, recording: Recording[Any] | SeveralSensors, image_of: Callable[[Shot], U8]) -> None:
        self._recording = recording
        self._image_of = image_of

    def image(self, frame: int) -> U8 | None:
        """The image of a frame; None where it cannot be read."""
        return next((image for _, image in self.at([frame])), None)

    def at(self, frames: Sequence[int]) -> Iterator[tuple[int, U8]]:
        """The images of ascending frames, as far as they can be read."""
        yield from self._shown(self._recording.at(frames))

    def through(self, first: int, last: int) -> Iterator[tuple[int, U8]]:
        """All images from one frame to another, both included."""
        if last >= 0:
            until_last = takewhile(lambda frame: frame.index <= last, iter(self._recording))
            yield from self._shown(frame for frame in until_last if frame.index >= first)

    def _shown(self, frames: Iterable[Frame[Any]]) -> Iterator[tuple[int, U8]]:
        for frame in frames:
            if frame.images:
                yield frame.index, self._image_of(frame.images)


def open_frames(run: RunFolder) -> SceneFrames:
    """Open the recording of a run again. Raises InputError: it is missing, or another version made the run."""
    path = run.recording
    if path is None or not path.exists():
        raise InputError(f"{path}: expected the recording of the run, found nothing there")
    rig = run.info.rig
    is_one_camera = rig is None or (rig.baseline_m is None and rig.depth_sensor is None)
    recording = open_source(path, run.options, is_one_camera)
    sensor = recording.parts[0].sensor
    return SceneFrames(cast(Recording[Any], recording), picture_of(sensor, path, run.config.rectify))


@singledispatch
def picture_of(sensor: object, path: Path, params: RectifyParams) -> Callable[[Shot], U8]:
    """Makes the picture of a shot in whose pixels boxes are. Raises InputError: shots without images."""
    raise InputError(f"{path}: expected a recording with images, found plan-view maps")


@picture_of.register
def _picture_of_one(sensor: SingleCamera, path: Path, params: RectifyParams) -> Callable[[Shot], U8]:
    return lambda shot: shot[0]


@picture_of.register
def _picture_of_depth(sensor: DepthCamera, path: Path, params: RectifyParams) -> Callable[[Shot], U8]:
    rectifier = RgbdRectifier(sensor.camera, sensor.technology, params)
    return lambda shot: rectifier(*shot)[0]


@picture_of.register
def _picture_of_pair(sensor: StereoPair, path: Path, params: RectifyParams) -> Callable[[Shot], U8]:
    rectifier = Rectifier(sensor.rig, params)
    return lambda shot: rectifier(*shot).image


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
    config = Config()
    recording = path
    options = options or OpenOptions()
    if (path / "run.json").is_file():
        run = RunFolder(path)
        run.refuse_own_parts(run.info.own_parts.keys() - {"tracker"}, "give the recording in place of the folder")
        config = run.config
        recording = run.recording or path
        if options.calibration is None:
            options = run.options
    opened: AnyRecording = open_by(OF_TWO_IMAGES if options.calibration is None else READERS, recording, options)
    rig = set_up(opened, config)
    spread, _ = frames_of_one_view(opened, config.analysis.setup_frames)
    depths = [rig.measure(frame.images) for frame in spread]
    colours = np.median([as_colour(depth.image) for depth in depths], axis=0).astype(np.uint8)
    disparity = median_image([depth.disparity for depth in depths])
    return point_cloud(disparity, colours, rig.geometry, rig.floor.world_SE3_left, rig.reduction)


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
