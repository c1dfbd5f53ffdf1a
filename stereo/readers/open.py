"""Find out how a recording is laid out, and open it; recordings of several rigs in one world, side by side in time."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from pathlib import Path

from calib.errors import InputError
from calib.io import entries, missing, refuse_unreadable
from calib.world import RIGS_FILE, load_rigs
from stereo.readers import base
from stereo.readers.bags import READER as BAG
from stereo.readers.datasets import EUROC, KITTI, KITTI_SEQUENCE, MIDDLEBURY, TUM_RGBD
from stereo.readers.folders import FOLDERS, RGBD_FOLDERS, in_folders, sides_layout
from stereo.readers.images import SUFFIXES, Colour, bits_note, bits_of, image_files, images_of
from stereo.readers.live import READER as LIVE
from stereo.readers.pairing import pair_stamps
from stereo.readers.side_by_side import READER as SIDE_BY_SIDE
from stereo.readers.times import camera_times, read_times, stamps_of
from stereo.readers.unknown import ONE_IMAGE, what_is_there
from stereo.readers.video import READER as VIDEO_PAIR
from stereo.readers.video import VideoFile, video_files, video_pair, video_tracks
from stereo.recording import (
    FrameClock,
    OpenOptions,
    RgbdFrame,
    Skipped,
    StereoFrame,
    StereoRecording,
    Video,
    assumed_clock,
    prefetch,
)


def rigs_file(path: Path) -> Path:
    """The ``rigs.toml`` that a path names: itself, or the one in the folder."""
    return path if path.name == RIGS_FILE else path / RIGS_FILE


def is_multi_rig(path: Path) -> bool:
    """Whether a path is a recording of several heads: a folder with ``rigs.toml``, or that file."""
    return rigs_file(path).is_file()


def _refuse_several(path: Path, _options: OpenOptions) -> base.Layout:
    file = rigs_file(path)
    folders = ", ".join(str(file.parent / entry.folder) for entry in load_rigs(file))
    raise InputError(
        f"{path}: expected one stereo pair, found a recording of several heads, which a run tracks whole: "
        f"give one of {folders}"
    )


READERS: tuple[base.Reader, ...] = (
    base.Reader("heads", "several heads", is_multi_rig, _refuse_several), BAG,
    EUROC, KITTI, KITTI_SEQUENCE, TUM_RGBD, MIDDLEBURY, FOLDERS, RGBD_FOLDERS, VIDEO_PAIR, SIDE_BY_SIDE,
    LIVE,
)  # fmt: skip
"""In this order: the first that a path fits opens it."""


def find_reader(path: Path) -> base.Reader:
    """The reader whose layout a path has. Raises InputError: nothing there, or no layout that is known."""
    refuse_unreadable(path, "a recording")
    if reader := next((reader for reader in READERS if reader.fits(path)), None):
        return reader
    if not path.exists():
        raise missing(path)
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
        if not path.exists():
            raise missing(path)
        if path.suffix.lower() in SUFFIXES:
            raise InputError(f"{path}: expected a video or a folder of images of one camera, found {ONE_IMAGE}")
    folder = Path(os.path.commonpath([path.resolve().parent for path in paths]))
    if all(map(image_files, filter(Path.is_dir, paths))) and all(map(Path.is_dir, paths)):
        return sides_layout(left, in_folders(*paths), folder, options)
    videos = [video_files(path) if path.is_dir() else [path] for path in paths]
    if [len(found) for found in videos] != [1, 1]:
        raise InputError(f"{left} and {paths[1]}: expected two videos or two folders of images, found others")
    return video_pair(left, videos[0][0], videos[1][0], folder, options)


def holds_pair(path: Path, options: OpenOptions | None = None) -> bool:
    """Whether a path holds images of two cameras, or images with depth; one video counts as one camera's."""
    if options is not None and options.right is not None:
        return True
    reader = next((reader for reader in READERS if reader.fits(path)), None)
    return reader is not None and reader.key not in ("side-by-side", "live")


def find_layout(path: Path | str, options: OpenOptions | None = None) -> tuple[base.Reader, base.Layout]:
    """What is at a path; no calibration is needed yet. Raises InputError: no recording there, unreadable, or sides that
    differ in size."""
    path, options = Path(path), options or OpenOptions()
    two = base.Reader("two-paths", "two recordings of one camera each", lambda path: False, _two_paths)
    reader = two if options.right is not None else find_reader(path)
    if options.topics and reader is not BAG:
        raise InputError(f"expected a bag, found {path}: {reader.name}", argument="topics")
    return reader, reader.find(path, options)


def open_any(path: Path | str, options: OpenOptions | None = None) -> base.AnyRecording:
    """Open a recording of any kind, with its calibration (same errors as ``open_recording``)."""
    recording = find_layout(path, options)[1].open()
    recording.options = options or OpenOptions()
    return recording


def open_recording(path: Path | str, options: OpenOptions | None = None) -> StereoRecording:
    """Open a recorded stereo pair; nothing is decoded but the first frame of each side.

    Videos of different lengths end with the shorter one; the missing frames are reported in ``skipped``. A calibration
    for another resolution of the same aspect is scaled, which ``rig.source`` then notes. Raises InputError: no
    recording there, unreadable, sides that differ in size or do not pair, or a calibration for another image."""
    recording = open_any(path, options)
    if not isinstance(recording, StereoRecording):
        raise InputError(f"{path}: expected a stereo pair, found images with depth")
    return recording


def open_video(path: Path | str, options: OpenOptions | None = None) -> Video:
    """Open a single-camera recording: a video file, or a folder of images (and timestamps.csv); the options may give a
    rate in place of the recording's own times. Raises InputError: nothing there, not a video or images, or options that
    only recordings with depth have."""
    path, options = Path(path), options or OpenOptions()
    if not path.exists():
        raise missing(path)
    if options.topics:
        raise InputError(f"expected a bag, found {path}: one camera", argument="topics")
    if options.calibration is not None:
        expected = "expected a stereo pair or images with depth"
        raise InputError(f"{expected}, found {path}: one camera", argument="calibration")
    files, videos = ([], [path]) if path.is_file() else (image_files(path), video_files(path))
    if not files and len(videos) != 1:
        raise InputError(f"{path}: expected images or one video, found {len(videos)} videos and no image")
    bits, clock, frames = bits_of(files), None, list[Path | None](files)
    if files and not (path / "timestamps.csv").is_file() and (stamps := stamps_of(files, path, path)):
        own = pair_stamps(stamps.ns, stamps.ns)
        frames, clock = [files[i] if i >= 0 else None for i in own.left], base.clock_of_pairs(own, options)
    source: base.FrameSource = images_of(frames, Colour(bits)) if files else VideoFile(videos[0])
    listed = None if files else camera_times(videos[0], videos[0].parent, source.n_frames)
    if listed and options.fps is None:
        times = base.own_times(read_times(listed, source.n_frames).ns)
        clock = FrameClock(base.rate_of(times), times)
    clock = clock or base.clock_of(path, options, source.n_frames, source.fps, source.raw)
    notes = [*clock.notes, *bits_note(bits)]
    if not files and (tracks := video_tracks(videos[0])) > 1:
        notes.append(f"{tracks} video tracks in the file: the first is read")
    return Video(path, base.together(source), source.n_frames, clock, notes, source.size, options=options)


AnyFrame = StereoFrame | RgbdFrame


@dataclass(frozen=True, eq=False)
class MultiRigFrame:
    """The frames of moment ``index``, from 0: their mean time on the common clock [s since the first frame of the
    earliest rig], and one frame per rig, None for a rig without a frame at that time."""

    index: int
    timestamp_s: float
    frames: tuple[AnyFrame | None, ...]


@dataclass(frozen=True, eq=False)
class RigRecording:
    """One rig of a recording: its folder, its frames on its own clock, and the time of the first on the common one."""

    name: str
    recording: base.AnyRecording
    start_s: float


class MultiRigRecording:
    """Several stereo recordings of one place; iterate it for its ``MultiRigFrame``.

    Attributes:
        path: the folder with ``rigs.toml``.
        rigs: in the order of ``rigs.toml``; their ``world_SE3_left`` is that of the common world.
        n_frames, fps, skipped: see ``stereo.recording.Recorded``; moments at the rate of the slowest rig.
    """

    def __init__(self, path: Path, rigs: Sequence[RigRecording]) -> None:
        self.path, self.rigs = path, tuple(rigs)
        self.fps = min(rig.recording.fps for rig in rigs)
        self._first_s = min(rig.start_s for rig in rigs)
        ends = [rig.start_s - self._first_s + rig.recording.n_frames / rig.recording.fps for rig in rigs]
        self.n_frames = max(1, round(max(ends) * self.fps))

    def __repr__(self) -> str:
        return f"MultiRigRecording({str(self.path)!r}, {len(self.rigs)} heads, {self.n_frames} frames)"

    @property
    def skipped(self) -> list[Skipped]:
        """Frames that one of the rigs passed over; indices are those of the rig."""
        return [Skipped(s.index, f"{rig.name}: {s.why}") for rig in self.rigs for s in rig.recording.skipped]

    def __iter__(self) -> Iterator[MultiRigFrame]:
        with ExitStack() as stack:
            streams = []
            for rig in self.rigs:
                items: Iterable[AnyFrame] = rig.recording
                frames = stack.enter_context(closing(prefetch(items)))
                streams.append(_Stream(frames, rig.start_s - self._first_s, 1 / rig.recording.fps))
            yield from moments(streams, 1 / self.fps)


class _Stream:
    """A rig's frames with one read ahead."""

    def __init__(self, frames: Generator[AnyFrame, None, None], start_s: float, period_s: float) -> None:
        self._frames, self._start_s = frames, start_s
        self.period_s = period_s
        self.next: AnyFrame | None = next(frames, None)

    @property
    def time_s(self) -> float:
        """Of the next frame on the common clock; infinite after the last."""
        return float("inf") if self.next is None else self.next.timestamp_s + self._start_s

    def take(self, period_s: float) -> AnyFrame | None:
        """The next frame; those after it that come too soon for the common period are passed over."""
        frame, soonest = self.next, self.time_s + period_s - self.period_s / 2
        self.next = next(self._frames, None)
        while self.next is not None and self.time_s < soonest:
            self.next = next(self._frames, None)
        return frame


def moments(streams: Sequence[_Stream], period_s: float) -> Iterator[MultiRigFrame]:
    """Frames by time: the earliest that waits, and those of other rigs taken within 0.6 of the slowest rig's period:
    half of it would let rigs that run half a period apart flicker between base.together and apart."""
    index = 0
    while any(stream.next is not None for stream in streams):
        until = min(stream.time_s for stream in streams) + 0.6 * period_s
        times = [stream.time_s for stream in streams if stream.time_s <= until]
        frames = tuple(stream.take(period_s) if stream.time_s <= until else None for stream in streams)
        yield MultiRigFrame(index, sum(times) / len(times), frames)
        index += 1


def open_rigs(path: Path) -> MultiRigRecording:
    """Open every rig that ``rigs.toml`` lists."""
    file = rigs_file(path)
    folder, rigs = file.parent, []
    for entry in load_rigs(file):
        if not (folder / entry.folder).exists():
            raise InputError(f"{folder}: expected a recording in {entry.folder!r}, found nothing there")
        recording = open_any(folder / entry.folder)
        recording.world_SE3_left = entry.world_SE3_left
        rigs.append(RigRecording(entry.folder, recording, entry.start_s))
    recordings = [rig.recording for rig in rigs]
    # Recordings without any times have the rate of those that have times, else the lowest.
    fps = min([one.fps for one in recordings if not one.clock.assumed] or [one.fps for one in recordings])
    for recording in recordings:
        if recording.clock.assumed and fps != recording.fps:
            recording.assume(assumed_clock(fps, recording.clock.even, ", as of the other rigs"))
    return MultiRigRecording(folder, rigs)
