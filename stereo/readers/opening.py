"""Find out how a recording is laid out, and open it."""

from __future__ import annotations

from pathlib import Path

from calib.errors import InputError
from stereo.readers import (
    euroc,
    folders,
    kitti,
    live,
    middlebury,
    rgbd_folders,
    several,
    side_by_side,
    tum_rgbd,
    video_pair,
)
from stereo.readers.bags import layout as bag_layout
from stereo.readers.bits import bits_note
from stereo.readers.foreign import content_text, foreign_text
from stereo.readers.images import ImageFiles, bits_of, image_files
from stereo.readers.pair import StereoRecording
from stereo.readers.reader import AnyRecording, Layout, OpenOptions, Reader
from stereo.readers.single import SingleRecording
from stereo.readers.timestamps import load_timestamps
from stereo.readers.videos import VideoFile, video_files

READERS: tuple[Reader, ...] = (
    several.READER,
    bag_layout.READER,
    euroc.READER,
    kitti.READER,
    kitti.SEQUENCE,
    tum_rgbd.READER,
    middlebury.READER,
    folders.READER,
    rgbd_folders.READER,
    video_pair.READER,
    side_by_side.READER,
    live.READER,
)
"""In the order in which they are asked: the first that a path fits opens it."""


def find_reader(path: Path) -> Reader:
    """The reader whose layout a path has.

    Raises:
        InputError: nothing there, or no layout that is known.
    """
    for reader in READERS:
        if reader.fits(path):
            return reader
    if not path.exists():
        raise InputError(f"{path}: expected a recording (folder or file), found nothing there")
    if foreign := foreign_text(path):
        raise InputError(f"{path}: expected a recording, found {foreign}")
    looked_for = "; ".join(reader.looks_for for reader in READERS)
    raise InputError(f"{path}: expected a recording ({looked_for}), found {content_text(path)}")


def holds_pair(path: Path) -> bool:
    """Whether a path holds images of two cameras, or images with depth; one video counts as one camera's."""
    reader = next((reader for reader in READERS if reader.fits(path)), None)
    return reader is not None and reader.key not in ("side-by-side", "live")


def find_layout(path: Path, options: OpenOptions | None = None) -> tuple[Reader, Layout]:
    """What is at a path; no calibration is needed yet.

    Raises:
        InputError: no recording there, unreadable, or sides that differ in size.
    """
    reader = find_reader(path)
    return reader, reader.find(path, options or OpenOptions())


def open_any(path: Path, options: OpenOptions | None = None) -> AnyRecording:
    """Open a recording of any kind, with its calibration (same errors as ``open_recording``)."""
    return find_layout(path, options)[1].open()


def open_recording(path: Path, options: OpenOptions | None = None) -> StereoRecording:
    """Open a recorded stereo pair; nothing is decoded but the first frame of each side.

    Videos of different lengths are cut to the shorter one and the missing frames are reported in ``skipped``: a video
    that ends early is a recorder that was stopped, and its frames still pair by position. Image folders whose names do
    not pair are refused (see ``pair_files``): there, any pairing would be a guess. A calibration for another resolution
    of the same aspect is scaled, which ``rig.source`` then notes.

    Raises:
        InputError: no recording there, unreadable, sides that differ in size, or a calibration for another image.
    """
    recording = open_any(path, options)
    if not isinstance(recording, StereoRecording):
        raise InputError(f"{path}: expected a stereo pair, found images with depth")
    return recording


def open_video(path: Path) -> SingleRecording:
    """Open a single-camera recording: a video file, or a folder of images (and timestamps.csv).

    Raises:
        InputError: nothing there, or not a video or images.
    """
    if not path.exists():
        raise InputError(f"{path}: expected a video or a folder of images, found nothing there")
    if path.is_file():
        return SingleRecording(path, VideoFile(path), None)
    files, stamps = image_files(path), path / "timestamps.csv"
    times, notes = load_timestamps(stamps) if stamps.is_file() else (None, ())
    if files:
        bits = bits_of(files)
        return SingleRecording(path, ImageFiles(files, bits), times, (*notes, *bits_note(bits)))
    found = video_files(path)
    if len(found) == 1:
        return SingleRecording(path, VideoFile(found[0]), times, notes)
    raise InputError(f"{path}: expected images or one video, found {len(found)} videos and no image")
