"""Both cameras in one video, side by side or one above the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.formats import load_rig
from calib.rig import StereoRig
from calib.types import U8
from stereo.readers.order import Order, is_ideal, rectified_rig, tell_order
from stereo.readers.packing import Common, Packing, find_packing
from stereo.readers.pair import split_pairs
from stereo.readers.reader import OpenOptions, Reader, Stream
from stereo.readers.source import FrameSource, is_grey
from stereo.readers.stereo_layout import Size, StereoLayout, clock_of
from stereo.readers.timed_files import pixel_text
from stereo.readers.videos import SUFFIXES, VideoFile, video_files

LOOKED_AT = 3
"""Frames spread over the video in which the two views are matched (our choice)."""


def _fits(path: Path) -> bool:
    return _video(path) is not None


def _find(path: Path, options: OpenOptions) -> StereoLayout:
    video = _video(path) or path
    source = VideoFile(video)
    return packed_layout(path, video, video.parent, source, sampled(source), options)


def packed_layout(
    path: Path, named: Path, folder: Path, source: FrameSource, pictures: Sequence[U8], options: OpenOptions
) -> StereoLayout:
    """Tell how the two views share a source's pictures, and which is the left one.

    Args:
        path: of the recording.
        named: the video, for messages.
        folder: where calibration, times and world.toml lie.
        pictures: a few of the source.
    Raises:
        InputError: the pictures are no two views of one scene.
    """
    calibration = options.calibration or folder
    packing, shared = find_packing(pictures, _aspect(calibration))
    if packing is None:
        raise InputError(f"{named}: {_no_pair(source.size, pictures, shared)}")
    size = packing.size(source.size)
    order, assumed = _order(calibration, size, shared)
    swapped, rectified = (order.swapped, order.rectified) if order else (False, False)
    clock = clock_of(folder, options, source.fps)
    stored = (size[0], size[1] // 2) if packing.stacked and packing.squeezed else size
    stored = (size[0] // 2, size[1]) if packing.squeezed and not packing.stacked else stored
    pixels = pixel_text(is_grey(pictures[0]), None)
    streams = tuple(Stream(name, stored, source.n_frames, None, pixels) for name in ("left", "right"))
    split = partial(_views, packing, swapped)
    return StereoLayout(
        path, folder, size, partial(split_pairs, source, split), streams, source.n_frames, clock.fps, clock.times_s,
        _rig(calibration, size, rectified), (*_notes(packing, order, assumed), *clock.notes), clock.even,
    )  # fmt: skip


def sampled(source: FrameSource) -> list[U8]:
    """A few pictures of a source, one at least: its announced length is believed only as far as it is read."""
    spread = sorted({round(float(i)) for i in np.linspace(0, max(0, source.n_frames - 1), LOOKED_AT)})
    found = [frame.image for frame in source.at(spread) if frame.image is not None]
    return found or [frame.image for frame in source.at([0]) if frame.image is not None]


def _views(packing: Packing, swapped: bool, picture: U8) -> tuple[U8, U8]:
    first, second = packing.split(picture)
    return (second, first) if swapped else (first, second)


def _aspect(calibration: Path) -> float | None:
    try:
        width, height = load_rig(calibration).left.size
    except InputError:
        return None
    return width / height


def _order(calibration: Path, size: Size, shared: Common) -> tuple[Order | None, str]:
    """What the corners say, and what was assumed of rectified images; nothing without a calibration."""
    try:
        rig = load_rig(calibration, size)
        if is_ideal(rig):
            return tell_order(shared.matches, rig, rig), ""
        rectified, assumed = rectified_rig(partial(load_rig, calibration, size, rectified=True), rig)
    except InputError:
        return None, ""
    return tell_order(shared.matches, rig, rectified), assumed


def _rig(calibration: Path, size: Size, rectified: bool) -> Callable[[], StereoRig]:
    def load() -> StereoRig:
        rig = load_rig(calibration, size)
        return rectified_rig(partial(load_rig, calibration, size, rectified=True), rig)[0] if rectified else rig

    return load


def _notes(packing: Packing, order: Order | None, assumed: str) -> list[str]:
    notes = []
    if packing.stacked or packing.squeezed:
        notes.append(f"the views lie {packing.text}")
    if order and order.swapped:
        notes.append(
            f"the right camera's view comes first: left and right are exchanged ({order.nearer:.0%} of {order.matches} "
            "matched corners are then nearer than infinity)"
        )
    if order and order.rectified:
        notes.append("the images are rectified already" + (f"; {assumed}" if assumed else ""))
    return notes


def _no_pair(size: Size, pictures: Sequence[U8], shared: Common) -> str:
    width, height = size
    expected = "expected two views of one scene (side by side, or one above the other), found"
    if width / height >= 1.8:
        left, right = (is_grey(np.ascontiguousarray(half)) for half in np.array_split(pictures[0], 2, axis=1)[:2])
        if left != right:
            return (
                f"{expected} a grey and a coloured half with {len(shared.matches)} of {shared.corners} corners alike: "
                "a picture of depth beside its colour image holds no depth in metres"
            )
    return f"{expected} one picture of {width}x{height}: a stereo recording needs both cameras"


def _video(path: Path) -> Path | None:
    if path.is_file():
        return path if path.suffix.lower() in SUFFIXES else None
    found = video_files(path) if path.is_dir() else []
    return found[0] if len(found) == 1 else None


READER = Reader("side-by-side", "a video with both cameras", "one video with both cameras", _fits, _find)
