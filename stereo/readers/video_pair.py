"""Two videos, one for each camera."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from stereo.readers.pair import both
from stereo.readers.reader import OpenOptions, Reader
from stereo.readers.sides import split_sides
from stereo.readers.stereo_layout import StereoLayout, clock_of, rig_in, same_size, stream
from stereo.readers.videos import VideoFile, video_files


def _fits(path: Path) -> bool:
    return path.is_dir() and _sides(path) is not None


def _find(path: Path, options: OpenOptions) -> StereoLayout:
    left, right = _sides(path) or (path, path)
    a, b = VideoFile(left), VideoFile(right)
    size, n_frames = same_size(a, b, left, right), max(a.n_frames, b.n_frames)
    clock = clock_of(path, options, a.fps)
    return StereoLayout(
        path, path, size, partial(both, a, b), (stream("left", a), stream("right", b)), n_frames, clock.fps,
        clock.times_s, rig_in(path, options, size), clock.notes, clock.even,
    )  # fmt: skip


def _sides(folder: Path) -> tuple[Path, Path] | None:
    videos = video_files(folder)
    by_name = {video.stem.lower(): video for video in videos}
    if {"left", "right"} <= by_name.keys():
        return by_name["left"], by_name["right"]
    sided = split_sides([video.stem for video in videos])
    if sided is None or len(sided.left) != 1 or len(sided.right) != 1:
        return None
    return videos[sided.left[0]], videos[sided.right[0]]


READER = Reader("videos", "a pair of videos", "two videos named left.* and right.* or alike", _fits, _find)
