"""Two videos, one for each camera."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from stereo.readers.pair import both
from stereo.readers.reader import OpenOptions, Reader
from stereo.readers.stereo_layout import StereoLayout, clock_of, rig_in, same_size, stream
from stereo.readers.videos import VideoFile, video_files


def _fits(path: Path) -> bool:
    return path.is_dir() and _side(path, "left") is not None and _side(path, "right") is not None


def _find(path: Path, options: OpenOptions) -> StereoLayout:
    left, right = _side(path, "left") or path, _side(path, "right") or path
    a, b = VideoFile(left), VideoFile(right)
    size, n_frames = same_size(a, b, left, right), max(a.n_frames, b.n_frames)
    clock = clock_of(path, options, a.fps)
    return StereoLayout(
        path, path, size, partial(both, a, b), (stream("left", a), stream("right", b)), n_frames, clock.fps,
        clock.times_s, rig_in(path, options, size), clock.notes,
    )  # fmt: skip


def _side(folder: Path, name: str) -> Path | None:
    return next((f for f in video_files(folder) if f.stem.lower() == name), None)


READER = Reader("videos", "a pair of videos", "left.* and right.* videos", _fits, _find)
