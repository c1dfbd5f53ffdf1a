"""Both cameras in one video: how they share its pictures, and the recording."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from PIL import Image

from calib.errors import InputError
from calib.formats import load_rig
from calib.images import as_grey
from calib.io import size_text
from calib.rig import StereoRig
from calib.types import U8
from stereo.readers.base import FramePairs, FrameSource, Layout, Reader, clock_of, stereo_layout, together
from stereo.readers.images import Colour, Size, Stream, bits_of, image_files, images_of, is_grey
from stereo.readers.video import (
    DEPTH_IN_VIDEO,
    SUFFIXES,
    VideoFile,
    is_depth,
    pair_in,
    video_files,
    video_tracks,
)
from stereo.recording import DecodedPair, OpenOptions
from stereo.rig_correction import match_corners


class Packing(NamedTuple):
    """Layout of the two views in a picture: stacked one above the other, else side by side; squeezed to half along the
    axis on which they share the picture, and stretched again."""

    stacked: bool
    squeezed: bool

    def __str__(self) -> str:
        kind = "one above the other" if self.stacked else "side by side"
        return f"{kind}, squeezed to half" if self.squeezed else kind

    def size(self, picture: Size) -> Size:
        """(width, height) of one view as it is given [px]."""
        return picture if self.squeezed else self.stored(picture)

    def stored(self, picture: Size) -> Size:
        """(width, height) of one view as it is stored [px]."""
        return (picture[0], picture[1] // 2) if self.stacked else (picture[0] // 2, picture[1])

    def split(self, picture: U8) -> tuple[U8, U8]:
        """The first (left or upper) and the second view."""
        size = picture.shape[1], picture.shape[0]
        width, height = self.stored(size)
        parts = picture[:height, :width], picture[-height:, -width:]
        first, second = (cv2.resize(part, size) if self.squeezed else np.ascontiguousarray(part) for part in parts)
        return np.asarray(first, dtype=np.uint8), np.asarray(second, dtype=np.uint8)


FEATURES = 150
SEARCH_PX = 24
"""Corners tried in a view, and how far apart rows of cameras that are not rectified may be [px of 320]."""


def count_corners(pairs: Iterable[tuple[U8, U8]]) -> tuple[int, int]:
    """Count the corners in the first views of some pairs, and those of them that the second views show, too."""
    corners = 0
    matched = 0
    for pair in pairs:
        first, second = (_thin_grey(view) for view in pair)
        points = cv2.goodFeaturesToTrack(first, FEATURES, 0.01, 14.0)
        if points is not None:
            corners += len(points)
        reach = 0.3 * first.shape[1]  # largest disparity, each way
        offsets = match_corners(first, second, reach, -reach, features=FEATURES, search_px=SEARCH_PX)[:, 3]
        if len(offsets):
            # Matches of one pair of cameras lie about on one row offset [px of 320].
            matched += int(np.count_nonzero(np.abs(offsets - np.median(offsets)) <= 4.0))
    return corners, matched


def _thin_grey(view: U8) -> U8:
    """A view in grey, 320 px wide or less."""
    height, width = view.shape[:2]
    thin = min(width, 320)
    size = thin, round(height * thin / width)
    return np.asarray(cv2.resize(as_grey(view), size, interpolation=cv2.INTER_AREA), np.uint8)


def find_packing(pictures: Sequence[U8], aspect: float | None) -> Packing | None:
    """The packing whose two views have most in common, None when none gives two views of one scene.

    ``aspect`` is the width over the height of one camera's images by the calibration, None when unknown.
    """
    height, width = pictures[0].shape[:2]
    candidates = _possible((width, height), aspect) or _possible((width, height), None)
    if not candidates:
        return None
    counts = [count_corners(map(packing.split, pictures)) for packing in candidates]
    fractions = [matched / max(1, corners) for corners, matched in counts]
    best = int(np.argmax(fractions))
    if counts[best][0] < 20:  # too few: what is most usual for the size
        return None if candidates[0].squeezed else candidates[0]
    # Real pairs have 0.3 to 0.8 of the corners in common, halves of one picture under 0.03.
    return candidates[best] if fractions[best] >= 0.12 else None


def _possible(picture: Size, aspect: float | None) -> list[Packing]:
    """Packings that give views of a camera's aspect, or of a usual one."""
    possible: list[Packing] = []
    for stacked, widest in ((False, 3.4), (True, 2.6)):
        for squeezed in (False, True):
            packing = Packing(stacked, squeezed)
            width, height = packing.size(picture)
            fits = 0.9 <= width / height < widest
            if aspect is not None:
                fits = abs(width / height / aspect - 1.0) < 0.02
            if fits and picture[stacked] % 2 == 0:
                possible.append(packing)
                break
    return possible


def _find(path: Path, options: OpenOptions) -> Layout:
    video = _video(path)
    if video is None:
        files = image_files(path)
        photos = images_of(files, Colour(bits_of(files)))
        return packed_layout(path, path, path, photos, pictures_of(photos), options)
    source = VideoFile(video)
    try:
        return packed_layout(path, video, video.parent, source, pictures_of(source), options)
    except InputError as error:
        if path.is_file() and (sides := pair_in(path.parent)) and path in sides:
            ways = f"give the folder of both, {path.parent}, or track it alone"
            raise InputError(f"{video}: one camera of a pair; {ways}", remedy="tracker") from error
        if (tracks := video_tracks(video)) < 2:
            raise
        way = "ffmpeg -i IN -map 0:v:0 left.mp4 -map 0:v:1 right.mp4 writes each to a file"
        raise InputError(f"{video}: expected one video track, found {tracks}, of which one is read: {way}") from error


def _holds_photos(path: Path) -> bool:
    """Whether a folder holds images that are wide enough for two views."""
    files = image_files(path) if path.is_dir() else []
    with suppress(Exception), Image.open(files[0] if files else "") as header:  # whatever a damaged file provokes
        return len(files) > 1 and header.width >= 1.8 * header.height
    return False


def packed_layout(
    path: Path,
    named: Path,
    folder: Path,
    source: FrameSource,
    pictures: Sequence[U8],
    options: OpenOptions,
    *,
    rig: Callable[[], StereoRig] | None = None,
    live: bool = False,
) -> Layout:
    """How the two views share a source's pictures; the left or upper one is the left camera's.

    Args:
        named: the video, for messages.
        folder: where calibration, times and world.toml lie.
        pictures: a few of the source.
        rig: reads another calibration than the folder's, when given.
        live: see ``stereo_layout``.
    """
    calibration = options.calibration or folder
    aspect = None
    with suppress(InputError):
        one = load_rig(calibration).left
        aspect = one.width / one.height
    packing = find_packing(pictures, aspect)
    if packing is None:
        raise _no_pair(named, source.size).about(str(named))
    size = packing.size(source.size)
    pixels = "grey" if is_grey(pictures[0]) else "colour"
    streams = tuple(
        Stream(name, packing.stored(source.size), source.n_frames, None, pixels, source.files)
        for name in ("left", "right")
    )
    notes = [f"the views lie {packing}"] if packing != (False, False) else []

    def pairs(indices: Sequence[int] | None) -> Generator[DecodedPair, None, None]:
        with closing(together(source)(indices)) as frames:
            for (frame,) in frames:
                left, right = (None, None) if frame.image is None else packing.split(frame.image)
                yield replace(frame, image=left), replace(frame, image=right)

    clock = clock_of(folder, options, source.n_frames, source.fps, source.raw)
    each = FramePairs(pairs, source.n_frames, live=live)
    return stereo_layout(path, each, streams, clock, rig or partial(load_rig, calibration, size), notes, folder)


def pictures_of(source: FrameSource) -> list[U8]:
    """Three pictures of a source, one at least, since its announced length may be wrong."""
    spread = sorted({round(float(i)) for i in np.linspace(0, max(0, source.n_frames - 1), 3)})
    found = [frame.image for frame in source.at(spread) if frame.image is not None]
    return found or [frame.image for frame in source.at([0]) if frame.image is not None]


def _no_pair(named: Path, size: Size) -> InputError:
    expected = "expected two views of one scene (side by side, or one above the other), found"
    if is_depth(named):
        return InputError(DEPTH_IN_VIDEO)
    return InputError(
        f"{expected} one picture of {size_text(size)}: a stereo recording needs both cameras, and one camera another "
        "tracker",
        remedy="tracker",
    )


def _video(path: Path) -> Path | None:
    if path.is_file():
        return path if path.suffix.lower() in SUFFIXES else None
    found = video_files(path) if path.is_dir() else []
    return found[0] if len(found) == 1 else None


READER = Reader(
    "side-by-side", "both cameras in one picture", lambda path: bool(_video(path)) or _holds_photos(path), _find
)
