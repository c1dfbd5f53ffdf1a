"""Find out how a recording is laid out, and open it."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

from calib.errors import InputError
from calib.floor.world_file import load_world
from calib.formats import load_rig
from calib.types import F64
from stereo.readers import images, videos
from stereo.readers.images import ImageFiles, image_files
from stereo.readers.pair import DEFAULT_FPS, PairsOf, StereoRecording, both, halves, rate_of
from stereo.readers.pairing import pair_files
from stereo.readers.single import SingleRecording
from stereo.readers.source import FrameSource
from stereo.readers.timestamps import load_timestamps
from stereo.readers.videos import VideoFile

Size = tuple[int, int]
Layout = tuple[Size, int, float, PairsOf]


def open_recording(path: Path, calibration: Path | None = None) -> StereoRecording:
    """Open a recorded stereo pair; nothing is decoded but the first frame of each side.

    Layouts: a folder with ``left/`` and ``right/`` images, with ``left.*`` and ``right.*`` videos or with one
    side-by-side video, or the path of a side-by-side video; ``timestamps.csv``, ``world.toml`` and the calibration
    lie in the folder. Videos of different lengths are cut to the shorter one and the missing frames are reported in
    ``skipped``: a video that ends early is a recorder that was stopped, and its frames still pair by position.
    Image folders whose names do not pair are refused (see ``pair_files``): there, any pairing would be a guess.
    A calibration for another resolution of the same aspect is scaled, which ``rig.source`` then notes.

    Args:
        path: the folder or the side-by-side video.
        calibration: calibration file or folder; found in the recording's folder when None.
    Raises:
        InputError: no recording there, unreadable, sides that differ in size, or a calibration for another image.
    """
    folder = path if path.is_dir() else path.parent
    if not path.exists():
        raise InputError(f"{path}: expected a recording (folder or video), found nothing there")
    size, n_frames, fps, pairs = _layout(path)
    rig = load_rig(calibration or folder, size)
    times = _times(folder)
    fps = rate_of(times) if times is not None else (fps if math.isfinite(fps) else DEFAULT_FPS)
    world = folder / "world.toml"
    pose = load_world(world).world_SE3_left if world.is_file() else None
    return StereoRecording(path, rig, pairs, n_frames, fps, times, pose)


def open_video(path: Path) -> SingleRecording:
    """Open a single-camera recording: a video file, or a folder of images (and timestamps.csv).

    Raises:
        InputError: nothing there, or not a video or images.
    """
    if not path.exists():
        raise InputError(f"{path}: expected a video or a folder of images, found nothing there")
    if path.is_file():
        return SingleRecording(path, VideoFile(path), None)
    files = image_files(path)
    if files:
        return SingleRecording(path, ImageFiles(files), _times(path))
    found = _videos(path)
    if len(found) == 1:
        return SingleRecording(path, VideoFile(found[0]), _times(path))
    raise InputError(f"{path}: expected images or one video, found {len(found)} videos and no image")


def _layout(path: Path) -> Layout:
    if path.is_file():
        return _side_by_side(path)
    left, right = path / "left", path / "right"
    if left.is_dir() and right.is_dir():
        return _folders(left, right)
    left_video, right_video = (_side(path, name) for name in ("left", "right"))
    if left_video and right_video:
        a, b = VideoFile(left_video), VideoFile(right_video)
        n_frames = max(a.n_frames, b.n_frames)
        return _same_size(a, b, left_video, right_video), n_frames, a.fps, partial(both, a, b)
    found = _videos(path)
    if len(found) == 1 and not (left_video or right_video):
        return _side_by_side(found[0])
    names = ", ".join(sorted(f.name for f in path.iterdir())[:6]) or "an empty folder"
    raise InputError(f"{path}: expected left/ and right/, left.* and right.* or one side-by-side video, found {names}")


def _folders(left: Path, right: Path) -> Layout:
    files = image_files(left), image_files(right)
    for folder, found in zip((left, right), files, strict=True):
        if not found:
            raise InputError(f"{folder}: expected images ({', '.join(sorted(images.SUFFIXES))}), found none")
    pairs = pair_files(*files)
    a, b = ImageFiles([pair[0] for pair in pairs]), ImageFiles([pair[1] for pair in pairs])
    return _same_size(a, b, left, right), len(pairs), math.nan, partial(both, a, b)


def _side_by_side(video: Path) -> Layout:
    source = VideoFile(video)
    width, height = source.size
    if width % 2:
        raise InputError(f"{video}: expected a side-by-side video of even width, found {width}x{height}")
    if width < 1.5 * height:
        raise InputError(
            f"{video}: expected a side-by-side pair (twice as wide as one camera), found {width}x{height}: "
            "a stereo recording needs both cameras"
        )
    return (width // 2, height), source.n_frames, source.fps, partial(halves, source)


def _same_size(a: FrameSource, b: FrameSource, left: Path, right: Path) -> Size:
    if a.size != b.size:
        raise InputError(
            f"{right}: expected images as large as {left.name}'s {a.size[0]}x{a.size[1]}, found {b.size[0]}x{b.size[1]}"
        )
    return a.size


def _side(folder: Path, name: str) -> Path | None:
    return next((f for f in _videos(folder) if f.stem.lower() == name), None)


def _videos(folder: Path) -> list[Path]:
    return sorted(f for f in folder.iterdir() if f.suffix.lower() in videos.SUFFIXES and f.is_file())


def _times(folder: Path) -> F64 | None:
    file = folder / "timestamps.csv"
    return load_timestamps(file) if file.is_file() else None
