"""Find out how a recording is laid out, and open it; recordings of several rigs in one world, side by side in time."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from calib.errors import InputError
from calib.io import entries, refuse_missing, refuse_unreadable
from calib.world import RIGS_FILE, load_rigs
from stereo.readers import base
from stereo.readers.bags import READER as BAG
from stereo.readers.datasets import EUROC, KITTI, MIDDLEBURY, TUM_RGBD
from stereo.readers.folders import FOLDERS, RGBD_FOLDERS, in_folders, sides_layout
from stereo.readers.images import SUFFIXES, Colour, bits_note, bits_of, image_files, images_of
from stereo.readers.live import READER as LIVE
from stereo.readers.pairing import pair_stamps
from stereo.readers.side_by_side import READER as SIDE_BY_SIDE
from stereo.readers.times import camera_times, read_times, stamps_of
from stereo.readers.unknown import ONE_IMAGE, inside_text, what_is_there
from stereo.readers.video import READER as VIDEO_PAIR
from stereo.readers.video import VideoFile, video_files, video_pair, video_tracks
from stereo.recording import (
    Frame,
    FrameClock,
    OpenOptions,
    Recording,
    Shot,
    SingleCamera,
    Skipped,
    StereoPair,
    prefetch,
    refuse_untimed,
)


def rigs_file(path: Path) -> Path:
    """The ``rigs.toml`` that a path names: itself, or the one in the folder."""
    return path if path.name == RIGS_FILE else path / RIGS_FILE


def is_multi_rig(path: Path) -> bool:
    """True if a path is a recording of several sensors: a folder with ``rigs.toml``, or that file."""
    return rigs_file(path).is_file()


def sensor_folders(path: Path, calibration: Path | None = None) -> list[Path]:
    """The recordings of several sensors; none where the path is not such a recording. Raises InputError: a calibration
    for sensors that have their own."""
    file = rigs_file(path)
    if not file.is_file():
        return []
    if calibration is not None:
        raise InputError(f"{calibration}: expected no calibration for {path}, whose sensors have their own")
    return [file.parent / entry.folder for entry in load_rigs(file)]


READERS: tuple[base.Reader, ...] = (
    BAG, EUROC, KITTI, TUM_RGBD, MIDDLEBURY, FOLDERS, RGBD_FOLDERS, VIDEO_PAIR, SIDE_BY_SIDE,
    LIVE,
)  # fmt: skip
"""In this order: the first that a path fits opens it."""
OF_TWO_IMAGES = tuple(reader for reader in READERS if reader not in (SIDE_BY_SIDE, LIVE))
"""Readers that do not take the video of one camera for one of two."""


def find_reader(path: Path, readers: Sequence[base.Reader] = READERS) -> base.Reader:
    """The first reader whose layout a path has. Raises InputError: nothing there, or no layout that is known."""
    refuse_unreadable(path)
    if reader := next((reader for reader in readers if reader.fits(path)), None):
        return reader
    refuse_missing(path)
    inside = entries(path)[:100] if path.is_dir() else []
    recordings = [one.name for one in inside if one.is_dir() and _is_recording(one)]
    if path.is_dir() and image_files(path) and _is_recording(path.resolve().parent):
        raise InputError(f"{path}: expected a recording, found a part of one: give {path.resolve().parent}")
    raise InputError(f"{path}: expected a recording, found {what_is_there(path, recordings)}")


def _is_recording(path: Path) -> bool:
    with suppress(InputError, OSError):
        return any(reader.fits(path) for reader in READERS)
    return False


def _two_paths(left: Path, options: OpenOptions) -> base.Layout:
    """The recordings of a left and a right camera, two videos or two folders of images, as one."""
    paths = left, options.right or left
    for path in paths:
        refuse_missing(path)
        if path.suffix.lower() in SUFFIXES:
            raise InputError(f"{path}: expected a video or a folder of images of one camera, found {ONE_IMAGE}")
    folder = Path(os.path.commonpath([path.resolve().parent for path in paths]))
    if all(path.is_dir() and image_files(path) for path in paths):
        return sides_layout(left, in_folders(*paths), folder, options)
    videos = []
    for path in paths:
        found = video_files(path) if path.is_dir() else [path]
        if len(found) > 1:
            raise InputError(f"{path}: expected one video, found {inside_text(path)}")
        videos += found
    if len(videos) != 2:
        raise InputError(f"{left} and {paths[1]}: expected two videos or two folders of images, found others")
    return video_pair(left, videos[0], videos[1], folder, options)


def find_layout(
    path: Path | str, options: OpenOptions | None = None, readers: Sequence[base.Reader] = READERS
) -> tuple[base.Reader, base.Layout]:
    """Find the reader of a path and its layout; no calibration is needed yet. Raises InputError: no recording there,
    unreadable, or sides that differ in size."""
    path = Path(path)
    options = options or OpenOptions()
    two = base.Reader("two-paths", "two recordings of one camera each", lambda path: False, _two_paths)
    reader = two if options.right is not None else find_reader(path, readers)
    if options.topics and reader is not BAG:
        raise InputError(f"expected a bag, found {path}: {reader.name}", argument="topics")
    return reader, reader.find(path, options)


def open_any(path: Path | str, options: OpenOptions | None = None) -> base.AnyRecording:
    """Open a pair or images with depth, with their calibration (same errors as ``open_recording``)."""
    recording: base.AnyRecording = open_by(READERS, path, options)
    return recording


def open_by(readers: Sequence[base.Reader], path: Path | str, options: OpenOptions | None = None) -> Any:
    """Open a recording by the first of some readers that it fits."""
    _, layout = find_layout(path, options, readers)
    recording = layout.open()
    recording.options = options or OpenOptions()
    return recording


def open_recording(path: Path | str, options: OpenOptions | None = None) -> Recording[StereoPair]:
    """Open a recorded stereo pair; nothing is decoded but the first frame of each side.

    Videos of different lengths end with the shorter one; the missing frames are reported in ``skipped``. A calibration
    for another resolution of the same aspect is scaled, which ``rig.source`` then notes. Raises InputError: no
    recording there, unreadable, sides that differ in size or do not pair, or a calibration for another image."""
    recording = open_any(path, options)
    if not isinstance(recording.sensor, StereoPair):
        raise InputError(f"{path}: expected a stereo pair, found images with depth")
    return recording


def open_video(path: Path | str, options: OpenOptions | None = None) -> Recording[SingleCamera]:
    """Open a single-camera recording: a video file, or a folder of images (and timestamps.csv); the options may give a
    rate in place of the recording's own times. Raises InputError: nothing there, not a video or images, or options that
    only recordings with depth have."""
    path = Path(path)
    options = options or OpenOptions()
    refuse_missing(path)
    if options.topics:
        raise InputError(f"expected a bag, found {path}: one camera", argument="topics")
    if options.calibration is not None:
        problem = f"expected a stereo pair or images with depth, found {path}: one camera"
        raise InputError(problem, argument="calibration")
    files = [] if path.is_file() else image_files(path)
    if files:
        return _images_of_one(path, files, options)
    videos = [path] if path.is_file() else video_files(path)
    if len(videos) != 1:
        raise InputError(f"{path}: expected images or one video, found {len(videos)} videos and no image")
    video = VideoFile(videos[0])
    listed = camera_times(videos[0], videos[0].parent, video.n_frames)
    if listed and options.fps is None:
        clock = base.clock_of_times(base.own_times(read_times(listed, video.n_frames).ns))
    else:
        clock = base.clock_of(path, options, video.n_frames, video.fps, video.raw)
    notes = list(clock.notes)
    tracks = video_tracks(videos[0])
    if tracks > 1:
        notes.append(f"{tracks} video tracks in the file: the first is read")
    return _recording_of_one(path, video, clock, notes, options)


def _images_of_one(path: Path, files: Sequence[Path], options: OpenOptions) -> Recording[SingleCamera]:
    frames: list[Path | None] = list(files)
    stamps = None if (path / "timestamps.csv").is_file() else stamps_of(files, path, path)
    if stamps is None:
        clock = base.clock_of(path, options, len(frames), files=frames)
    else:
        pairs = pair_stamps(stamps.ns, stamps.ns)
        frames = [files[i] if i >= 0 else None for i in pairs.left]
        clock = base.clock_of_pairs(pairs, options)
    bits = bits_of(files)
    notes = [*clock.notes, *bits_note(bits)]
    return _recording_of_one(path, images_of(frames, Colour(bits)), clock, notes, options)


def _recording_of_one(
    path: Path, source: base.FrameSource, clock: FrameClock, notes: list[str], options: OpenOptions
) -> Recording[SingleCamera]:
    sensor = SingleCamera(source.size)
    decode = base.together(source)
    return Recording(path, decode, source.n_frames, clock, notes, sensor, options=options, files=source.files)


class SeveralSensors:
    """A recording of several sensors of one place; iterate it for frames with a shot of each.

    Attributes:
        path: the folder with ``rigs.toml``.
        parts: the recording of each sensor on its own clock, in the order of ``rigs.toml``; their ``world_SE3_left`` is
            that of the common world.
        starts_s: when the first frame of each was taken, on the common clock [s].
        n_frames, fps, files, skipped, notes, options: see ``stereo.recording.Recording``; moments at the rate of the
            slowest sensor.
    """

    is_live = False

    def __init__(
        self,
        path: Path,
        parts: Sequence[base.AnyRecording],
        starts_s: Sequence[float],
        options: OpenOptions | None = None,
    ) -> None:
        """``options`` are what every sensor was opened with."""
        self.path = path
        self.parts = tuple(parts)
        self.starts_s = tuple(starts_s)
        self.notes = list[str]()
        self.options = options or OpenOptions()
        self.fps = min(part.fps for part in parts)
        self._first_s = min(starts_s)
        ends = [s - self._first_s + part.n_frames / part.fps for part, s in zip(parts, starts_s, strict=True)]
        self.n_frames = max(1, round(max(ends) * self.fps))

    @property
    def identity(self) -> list[Any]:
        """Everything that decides results besides the images: cameras and times of every sensor."""
        return [[part.identity for part in self.parts], self.starts_s]

    @property
    def files(self) -> list[Path]:
        """Files of the images of all sensors."""
        return [file for part in self.parts for file in part.files]

    @property
    def skipped(self) -> list[Skipped]:
        """Frames that one of the sensors passed over; indices are its own."""
        return [Skipped(s.index, f"{part.name}: {s.why}") for part in self.parts for s in part.skipped]

    def __iter__(self) -> Iterator[Frame[Shot]]:
        with ExitStack() as stack:
            streams = []
            for part, start_s in zip(self.parts, self.starts_s, strict=True):
                frames = stack.enter_context(closing(prefetch(part)))
                streams.append(_Stream(frames, start_s - self._first_s, 1 / part.fps))
            yield from moments(streams, 1 / self.fps)

    def at(self, indices: Sequence[int]) -> Iterator[Frame[Shot]]:
        """The usable ones of these frames, whose indices ascend; all before them are read."""
        requested = set(indices)
        for frame in self:
            if frame.index > max(requested, default=-1):
                return
            if frame.index in requested:
                yield frame


class _Stream:
    """A sensor's frames with one read ahead."""

    def __init__(self, frames: Generator[Frame[Shot], None, None], start_s: float, period_s: float) -> None:
        self._frames = frames
        self._start_s = start_s
        self.period_s = period_s
        self.next: Frame[Shot] | None = next(frames, None)

    @property
    def time_s(self) -> float:
        """Time of the next frame on the common clock; infinite after the last."""
        return float("inf") if self.next is None else self.next.timestamp_s + self._start_s

    def take(self, period_s: float) -> Shot | None:
        """The shot of the next frame; those after it that come too soon for the common period are passed over."""
        frame = self.next
        soonest = self.time_s + period_s - self.period_s / 2
        self.next = next(self._frames, None)
        while self.next is not None and self.time_s < soonest:
            self.next = next(self._frames, None)
        return None if frame is None else frame.images


def moments(streams: Sequence[_Stream], period_s: float) -> Iterator[Frame[Shot]]:
    """Frames by time: the earliest that waits, and those within 0.6 of the slowest sensor's period after it: half of it
    would let sensors that run half a period apart flicker between together and apart. The time of a frame is the
    mean of its shots' times [s since the first frame of the earliest sensor]."""
    index = 0
    while any(stream.next is not None for stream in streams):
        until = min(stream.time_s for stream in streams) + 0.6 * period_s
        times = [stream.time_s for stream in streams if stream.time_s <= until]
        shots = tuple(stream.take(period_s) if stream.time_s <= until else None for stream in streams)
        yield Frame(index, sum(times) / len(times), shots)
        index += 1


def open_rigs(path: Path, fps: float | None = None) -> SeveralSensors:
    """Open the recording of every sensor that ``rigs.toml`` lists, with ``fps`` in place of their own times where it is
    given. Raises InputError: one that cannot be opened, or has no times."""
    file = rigs_file(path)
    options = OpenOptions(fps=fps)
    folder = file.parent
    parts = []
    starts_s = []
    for entry in load_rigs(file):
        if not (folder / entry.folder).exists():
            raise InputError(f"{folder}: expected a recording in {entry.folder!r}, found nothing there")
        part = open_any(folder / entry.folder, options)
        refuse_untimed(part)
        part.name = entry.folder
        part.sensor = replace(part.sensor, world_SE3_left=entry.world_SE3_left)
        parts.append(part)
        starts_s.append(entry.start_s)
    return SeveralSensors(folder, parts, starts_s, options)


def _find_several(path: Path, options: OpenOptions) -> base.Layout:
    sensor_folders(path, options.calibration)
    recording = open_rigs(path, options.fps)
    clock = FrameClock(recording.fps)
    return base.Layout("sensors", (), recording.n_frames, clock, (), 0, lambda: recording)


def _find_camera(path: Path, options: OpenOptions) -> base.Layout:
    video = open_video(path, options)
    return base.Layout("camera", (), video.n_frames, video.clock, (*video.notes,), 0, lambda: video)


SEVERAL = base.Reader("sensors", "several sensors", is_multi_rig, _find_several)
ONE_CAMERA = base.Reader("camera", "one camera", lambda path: True, _find_camera)
