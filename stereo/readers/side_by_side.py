"""Both cameras in one video."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from calib.errors import InputError
from stereo.readers.pair import halves
from stereo.readers.reader import OpenOptions, Reader, Stream
from stereo.readers.stereo_layout import StereoLayout, clock_of, rig_in
from stereo.readers.videos import SUFFIXES, VideoFile, video_files


def _fits(path: Path) -> bool:
    return _video(path) is not None


def _find(path: Path, options: OpenOptions) -> StereoLayout:
    video = _video(path) or path
    source = VideoFile(video)
    size = _half(video, source.size)
    clock = clock_of(video.parent, options, source.fps)
    streams = tuple(Stream(name, size, source.n_frames) for name in ("left", "right"))
    return StereoLayout(
        path, video.parent, size, partial(halves, source), streams, source.n_frames, clock.fps, clock.times_s,
        rig_in(video.parent, options, size), clock.notes, clock.even,
    )  # fmt: skip


def _half(video: Path, size: tuple[int, int]) -> tuple[int, int]:
    width, height = size
    if width % 2:
        raise InputError(f"{video}: expected a side-by-side video of even width, found {width}x{height}")
    if width < 1.5 * height:
        raise InputError(
            f"{video}: expected a side-by-side pair (twice as wide as one camera), found {width}x{height}: "
            "a stereo recording needs both cameras"
        )
    return width // 2, height


def _video(path: Path) -> Path | None:
    if path.is_file():
        return path if path.suffix.lower() in SUFFIXES else None
    found = video_files(path) if path.is_dir() else []
    return found[0] if len(found) == 1 else None


READER = Reader("side-by-side", "a side-by-side video", "one side-by-side video", _fits, _find)
