"""Frames from a video file, and two videos as the two cameras of a recording."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from calib.errors import InputError
from calib.formats import load_rig
from calib.images import as_grey
from calib.io import entries, require_file
from calib.times import rate_of_times, run_on
from calib.types import F64, I64, U8
from stereo.readers import base
from stereo.readers.images import Stream, is_grey
from stereo.readers.pairing import TimePairs, one_of_each, pair_stamps
from stereo.readers.times import camera_times, read_times
from stereo.recording import Decoded, OpenOptions

SUFFIXES = frozenset({
    ".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v", ".mpg", ".mpeg", ".m2v", ".ts", ".mts", ".flv", ".f4v", ".wmv",
    ".asf", ".ogv", ".3gp", ".vob", ".mxf", ".h264", ".h265", ".hevc", ".mjpeg", ".mjpg",
})  # fmt: skip
DEPTH_IN_VIDEO = (
    "depth in a video is not read, since videos lose it: write it as PNG images of 16 bits into a folder depth, and "
    "the colour images into a folder rgb"
)
_RAW = (b"\0\0\0\1", b"\0\0\1\x67", b"\xff\xd8\xff")
"""First bytes of pictures without a container: H.264 and H.265, and JPEG one after the other."""


class VideoFile:
    """One camera's frames from a video; broken frames inside it are yielded without an image."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.files: Sequence[Path] = (path,)
        capture = _open(path)
        with path.open("rb") as file:
            self.raw = file.read(4).startswith(_RAW)
        found, first = capture.read()
        self._start_ms = float(capture.get(cv2.CAP_PROP_POS_MSEC))
        fps = float(capture.get(cv2.CAP_PROP_FPS))
        announced = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self.n_frames = int(announced) if np.isfinite(announced) and announced > 0 else 0
        # A file of less than 200 bytes a frame is too small for its number of frames: counting them costs nothing.
        if self.n_frames > path.stat().st_size / 200:
            self.n_frames = 1 + sum(1 for _ in takewhile(lambda _: capture.grab(), range(1, self.n_frames)))
        if self.raw and not self.n_frames:
            self.n_frames = len(_packets(path).times_s)
        if not found or first is None:
            raise InputError(f"{path}: expected a video, found no frame that can be decoded: {_code_text(capture)}")
        self.size = first.shape[1], first.shape[0]
        self.fps = fps if 0 < fps <= 1000 else math.nan
        # A header may announce the clock of its times, 1000 per second, in the place of a rate.
        shown = None if self.raw else rate_of_times(_packets(path, 300).times_s)
        if shown and not abs(shown.fps / self.fps - 1.0) <= 0.02:
            self.fps = shown.fps
        self._lost = _before_key_frame(path)
        if not self.raw and self._lost:
            self._start_ms -= 1000.0 * self._lost / self.fps
        self._grey = is_grey(np.asarray(first, dtype=np.uint8))

    def __iter__(self) -> Iterator[Decoded]:
        """Frames up to the last that can be decoded; a tail that cannot is left out."""
        capture = _open(self._path)
        index = self._lost
        broken = 0
        try:
            yield from map(self._early, range(self._lost))
            # Reads that fail in a row for about a second, more than a lost key frame costs, are the end.
            while broken < 25 and (broken == 0 or index + broken < self.n_frames):
                found, image = capture.read()
                if not found or image is None:
                    broken += 1
                    continue
                for lost in range(index, index + broken):
                    yield Decoded(lost, None, None, f"{self._path.name} cannot be decoded here")
                index += broken
                broken = 0
                yield Decoded(index, self._time(capture, index), self._pixels(image))
                index += 1
        finally:
            capture.release()

    def at(self, indices: Iterable[int]) -> Iterator[Decoded]:
        """Only these frames, ascending; near ones are reached by reading on, since a seek decodes from a key frame.

        Some files (MPEG-1, uneven times) are read in order throughout: a seek lands on another frame there.
        """
        capture = _open(self._path)
        position = self._lost
        try:
            for index in indices:
                if index < self._lost:
                    yield self._early(index)
                    continue
                if index - position > 250 and self._seeks:  # the usual distance of key frames
                    there = _open(self._path)
                    if self._seek(there, index):
                        capture, there = there, capture
                        position = index
                    there.release()
                while position < index and capture.grab():
                    position += 1
                found, image = capture.read() if position == index else (False, None)
                if not found or image is None:
                    return
                position += 1
                yield Decoded(index, self._time(capture, index), self._pixels(image))
        finally:
            capture.release()

    def _early(self, index: int) -> Decoded:
        return Decoded(index, None, None, f"{self._path.name} begins without the key frame of this one")

    @cached_property
    def _seeks(self) -> bool:
        """True if a seek gives the image and time that reading in order gives, at a frame near the beginning."""
        ordered = _open(self._path)
        for _ in range(100):
            ordered.grab()
        sought = _open(self._path)
        sought.set(cv2.CAP_PROP_POS_FRAMES, 100)
        found, image = ordered.read()
        again, other = sought.read()
        same_time = ordered.get(cv2.CAP_PROP_POS_MSEC) == sought.get(cv2.CAP_PROP_POS_MSEC)
        return bool(found and again and same_time and np.array_equal(image, other))

    def _seek(self, capture: cv2.VideoCapture, index: int) -> bool:
        """Seek so that the frame is read next; whether that succeeded, as far as the time of the one before shows."""
        if not capture.set(cv2.CAP_PROP_POS_FRAMES, index - 1) or not capture.grab():
            return False
        late_s = self._time(capture, index - 1) - (index - 1) / self.fps
        return abs(late_s) < 0.5 / self.fps

    def _time(self, capture: cv2.VideoCapture, index: int) -> float:
        seconds = (float(capture.get(cv2.CAP_PROP_POS_MSEC)) - self._start_ms) / 1000.0
        return seconds if seconds > 0.0 else index / self.fps  # some containers hold no times

    def _pixels(self, image: object) -> U8:
        pixels = np.asarray(image, dtype=np.uint8)
        return as_grey(pixels) if self._grey else pixels


def is_depth(video: Path) -> bool:
    """True if a video holds depth by its name."""
    return re.search(r"depth|disparity", video.stem, re.IGNORECASE) is not None


def video_files(folder: Path) -> list[Path]:
    """The videos of a folder, sorted by name."""
    return [f for f in entries(folder) if f.suffix.lower() in SUFFIXES and not f.is_dir()]


def _open(path: Path) -> cv2.VideoCapture:
    require_file(path, "a video")
    capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise InputError(f"{path}: expected a video, found {_kind_text(path)}")
    return capture


_REENCODE = "ffmpeg -i IN -c:v libx264 -crf 12 OUT.mp4 makes a video that is read"


def _code_text(capture: cv2.VideoCapture) -> str:
    """Reason why the pictures of a video are not decoded, with the way out."""
    code = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=True).decode("latin-1").strip("\0 ")
    return f"it is coded as {code or 'unknown'}, which OpenCV does not decode here, or damaged; {_REENCODE}"


def _kind_text(path: Path) -> str:
    """Kind of a file that cannot be opened as a video."""
    with path.open("rb") as file:
        head = file.read(64)
    if not head:
        return "an empty file"
    if head[4:8] == b"ftyp" and b"moov" not in boxes(path):
        return "one that was cut off: its index (moov) is missing, as when a recording is not ended"
    return f"a file that OpenCV does not open (it begins with {head[:8]!r}); {_REENCODE}"


def boxes(path: Path) -> dict[bytes, tuple[int, int]]:
    """Place and length [bytes] of the outer boxes of an MP4 or MOV file, by type."""
    found = {}
    at = 0
    size = path.stat().st_size
    with path.open("rb") as file:
        while at + 8 <= size:
            file.seek(at)
            head = file.read(16)
            length = int.from_bytes(head[:4], "big")
            length = int.from_bytes(head[8:], "big") if length == 1 else length or size - at
            if length < 8:
                break
            found[head[4:8]] = at, length
            at += length
    return found


def video_tracks(path: Path) -> int:
    """Videos in a container, of which only the first is read: counted in MP4, MOV, Matroska and WebM, else 1."""
    with path.open("rb") as file:
        head = file.read(1 << 16)
        if head[4:8] == b"ftyp" and (index := boxes(path).get(b"moov")):
            file.seek(index[0])
            return max(1, len(re.findall(rb"hdlr\0{8}vide", file.read(index[1]))))
    # Of a track entry the type 1, a video.
    return max(1, head.partition(b"\x1f\x43\xb6\x75")[0].count(b"\x83\x81\x01"))


class _Packets(NamedTuple):
    """When the frames of a video are shown by its container, or the first of them: (n,) float64 [s] in order; and notes
    where these times begin again, as in segments that were joined."""

    times_s: F64
    notes: tuple[str, ...]


def _packets(path: Path, most: int | None = None) -> _Packets:
    """The times of a container; nothing is decoded."""
    capture = _open(path)
    times: list[float] = []
    start_s = 0.0
    capture.set(cv2.CAP_PROP_FORMAT, -1)
    while len(times) != most and capture.grab():
        times.append(float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0)
        if len(times) == 1:
            start_s = _start_of(capture) - times[0]
    shown, notes = run_on(np.array(times, dtype=np.float64))
    return _Packets(np.sort(shown) + start_s, notes)  # packets come in the order of decoding


def _start_of(capture: cv2.VideoCapture) -> float:
    """When the frame that was read last is shown [s], where a container may begin after 0; to half a frame."""
    frames = capture.get(cv2.CAP_PROP_PTS)
    fps = capture.get(cv2.CAP_PROP_FPS)
    return frames / fps if fps > 0 and abs(frames) < 1e12 else 0.0


def _before_key_frame(path: Path) -> int:
    """Number of frames of H.264 or H.265 that come before the first key frame: decoders leave them out."""
    capture = _open(path)
    code = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=True).lower()
    capture.set(cv2.CAP_PROP_FORMAT, -1)
    if code not in (b"h264", b"avc1", b"hevc", b"hev1", b"hvc1"):
        return 0
    lost = 0
    while capture.grab():
        if capture.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME):
            return lost
        lost += 1
    return 0


def _by_time(left_s: F64, right_s: F64) -> TimePairs | None:
    """The pairs of two videos by the times of their frames; None where pairs in order are as good: the frames of a pair
    stay within half a period of each other, apart from times that waver. Elsewhere one video began later or lost
    frames, or the rates differ."""
    count = min(len(left_s), len(right_s))
    left_steps = np.diff(left_s)
    right_steps = np.diff(right_s)
    if count < 3 or (left_steps <= 0).any() or (right_steps <= 0).any():
        return None
    from scipy.ndimage import median_filter  # half a second, and only two videos with times need it

    apart = median_filter(left_s[:count] - right_s[:count], min(15, count), mode="nearest")
    if np.abs(apart).max() <= 0.5 * float(np.median(left_steps)):
        return None
    left_ns = (left_s * 1e9).astype(np.int64)
    right_ns = (right_s * 1e9).astype(np.int64)
    pairs = pair_stamps(left_ns, right_ns, one_clock=True)
    have_both = (pairs.left >= 0) & (pairs.right >= 0)
    return pairs if have_both.any() else None


class _PlacedVideo:
    """The frames of a video by the frames of a recording (an ``ItemSource``), of which each has a place in the video,
    ascending; -1 where the camera lost it."""

    def __init__(self, video: VideoFile, places: I64) -> None:
        self._video = video
        self._places = places

    def __iter__(self) -> Iterator[Decoded]:
        return self._frames_at(range(len(self._places)), iter(self._video))

    def at(self, indices: Iterable[int]) -> Iterator[Decoded]:
        """Only these frames."""
        listed = list(indices)
        return self._frames_at(listed, self._video.at(int(self._places[i]) for i in listed if self._places[i] >= 0))

    def _frames_at(self, indices: Iterable[int], frames: Iterator[Decoded]) -> Iterator[Decoded]:
        for index in indices:
            place = self._places[index]
            found = next((frame for frame in frames if frame.index == place), None) if place >= 0 else None
            if place >= 0 and found is None:
                return
            yield replace(found, index=index) if found else Decoded(index, None, None, "no frame of this time")


def video_pair(path: Path, left: Path, right: Path, folder: Path, options: OpenOptions) -> base.Layout:
    """Two videos, paired by their times where these differ, else in order; calibration, times and world.toml lie in the
    folder."""
    for video in (left, right):
        if is_depth(video):
            raise InputError(f"{video}: {DEPTH_IN_VIDEO}")
    a = VideoFile(left)
    b = VideoFile(right)
    size = base.same_size(a, b, left, right)
    rig = partial(load_rig, options.calibration or folder, size)
    notes: list[str] = []
    if not (folder / "timestamps.csv").is_file():
        shown = [_packets(left), _packets(right)]
        for source, (packets_s, _) in zip((a, b), shown, strict=True):
            # A container announces the first of joined segments, and frames before a late begin.
            before = round(packets_s[0] * source.fps) if packets_s[0] > 0 else 0
            source.n_frames = max(source.n_frames - before, len(packets_s))
        times, pairs = _video_times((left, right), folder, shown, raw=a.raw or b.raw)
        late_s = float(times[1][0] - times[0][0])
        if abs(late_s) > 0.5 / a.fps:
            how = "by their times" if pairs else "in order, since no two frames are of one time"
            notes.append(f"by its container the right video begins {late_s:+.3g} s after the left one: paired {how}")
        if pairs:
            base.check_paired(pairs, path)
            decode = base.together(_PlacedVideo(a, pairs.left), _PlacedVideo(b, pairs.right))
            frames = base.FramePairs(decode, len(pairs.left), pairs.unpaired)
            streams = _streams(a, b, times)
            return base.stereo_layout(path, frames, streams, base.clock_of_pairs(pairs, options), rig, notes, folder)
        notes += shown[0].notes
    if a.n_frames != b.n_frames:
        counts = f"{a.n_frames} frames in the left video and {b.n_frames} in the right one"
        notes.append(f"{counts}: paired in order from the first")
    clock = base.clock_of(folder, options, min(a.n_frames, b.n_frames), a.fps, a.raw)
    frames = base.FramePairs(base.together(a, b), max(a.n_frames, b.n_frames))
    return base.stereo_layout(path, frames, _streams(a, b), clock, rig, notes, folder)


def _streams(left: VideoFile, right: VideoFile, times_s: Sequence[F64] = ()) -> tuple[Stream, Stream]:
    """Streams of both videos, with the times of their frames where these pair them."""
    streams = []
    for name, video, own_s in zip(("left", "right"), (left, right), times_s or (None, None), strict=True):
        count = video.n_frames if own_s is None else len(own_s)
        streams.append(Stream(name, video.size, count, own_s, files=video.files))
    return streams[0], streams[1]


def _video_times(
    videos: tuple[Path, Path], folder: Path, shown: Sequence[_Packets], raw: bool
) -> tuple[list[F64], TimePairs | None]:
    """The times of both videos [s], of files next to them or of their containers, and the pairs by these; None where
    pairs in order are as good."""
    times = [packets.times_s for packets in shown]
    files = [camera_times(video, folder, len(own)) for video, own in zip(videos, times, strict=True)]
    if files[0] and files[1]:
        left = read_times(files[0], len(times[0]))
        right = read_times(files[1], len(times[1]))
        return [base.own_times(left.ns), base.own_times(right.ns)], pair_stamps(left.ns, right.ns)
    return times, None if raw else _by_time(times[0], times[1])


def pair_in(folder: Path) -> tuple[Path, Path] | None:
    """The videos of the left and the right camera in a folder."""
    videos = video_files(folder)
    by_name = {video.stem.lower(): video for video in videos}
    if {"left", "right"} <= by_name.keys():
        return by_name["left"], by_name["right"]
    return one_of_each(videos)


READER = base.Reader(
    "videos",
    "a pair of videos",
    lambda path: path.is_dir() and pair_in(path) is not None,
    lambda path, options: video_pair(path, *(pair_in(path) or (path, path)), path, options),
)
