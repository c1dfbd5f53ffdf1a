"""Pairs of board images, whatever their layout: folders, interleaved names, side by side, or video."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from calib.errors import InputError
from calib.formats.base import side_of
from calib.types import U8
from stereo.readers.images import frame_number, image_files, read_image
from stereo.readers.video import SUFFIXES as VIDEO_SUFFIXES
from stereo.readers.video import VideoFile

MAX_FRAMES = 240
"""Frames of a video that are searched for the board, evenly spread: enough to choose 40 good views from."""
_DEEP_SUFFIXES = frozenset({".png", ".tif", ".tiff", ".pgm", ".ppm"})
"""Formats that can hold more than 8 bits."""
_SIDE_BY_SIDE_ASPECT = 2.0
"""Wider images are two pictures side by side: no single sensor is that wide."""


@dataclass(frozen=True, eq=False)
class BoardPair:
    """Two images taken together; without images ``why`` says what is wrong."""

    name: str
    left: U8 | None
    right: U8 | None
    why: str = ""


@dataclass(frozen=True)
class _Layout:
    """Where the images are: files in pairs, files that hold both images, or one or two videos."""

    pairs: Sequence[tuple[Path | None, Path | None]] = ()
    wide: Sequence[Path] = ()
    videos: Sequence[Path] = ()


class BoardImages:
    """The pairs at a path; iterating reads them one by one.

    Raises:
        InputError: no pairs there.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if path.is_file() and path.suffix.lower() in VIDEO_SUFFIXES:
            self._layout = _Layout(videos=(path,))
        elif path.is_dir():
            self._layout = _in_folder(path)
        else:
            raise InputError(f"{path}: expected a folder of board images or a video, found none")
        self._frames = self._frame_indices() if self.is_video else []

    @property
    def is_video(self) -> bool:
        """Whether the pairs are frames of a video."""
        return bool(self._layout.videos)

    def __len__(self) -> int:
        return len(self._frames) + len(self._layout.pairs) + len(self._layout.wide)

    @property
    def names(self) -> list[str]:
        """Names of the pairs in order."""
        pairs = [_pair_name(*pair) for pair in self._layout.pairs]
        return [*pairs, *(file.name for file in self._layout.wide), *map(_frame_name, self._frames)]

    def __iter__(self) -> Iterator[BoardPair]:
        return self.at(range(len(self)))

    def at(self, indices: Sequence[int]) -> Iterator[BoardPair]:
        """Only these pairs, in ascending order."""
        if self.is_video:
            yield from self._video_pairs([self._frames[i] for i in indices])
            return
        for index in indices:
            if self._layout.wide:
                yield _split(self._layout.wide[index].name, _read(self._layout.wide[index]))
            else:
                yield _read_pair(*self._layout.pairs[index])

    def _frame_indices(self) -> list[int]:
        n = min(VideoFile(path).n_frames for path in self._layout.videos)
        if n < 1:
            raise InputError(f"{self.path}: expected a video that tells its number of frames, found none")
        return sorted({int(i) for i in np.linspace(0, n - 1, min(n, MAX_FRAMES))})

    def _video_pairs(self, frames: Sequence[int]) -> Iterator[BoardPair]:
        streams = [VideoFile(path).at(frames) for path in self._layout.videos]
        for decoded in zip(*streams, strict=False):
            name = _frame_name(decoded[0].index)
            images = [one.image for one in decoded]
            if any(image is None for image in images):
                yield BoardPair(name, None, None, "cannot be decoded")
            elif len(images) == 2:
                yield BoardPair(name, images[0], images[1])
            else:
                yield _split(name, images[0])


def _in_folder(folder: Path) -> _Layout:
    sides = _side_folders(folder)
    if sides is not None:
        return _Layout(pairs=_paired(image_files(sides[0]), image_files(sides[1])))
    images = image_files(folder)
    if not images:
        return _Layout(videos=_videos(folder))
    by_side = {side: [f for f in images if side_of(_spaced(f.stem)) == side] for side in ("left", "right")}
    if by_side["left"] and by_side["right"]:
        return _Layout(pairs=_paired(by_side["left"], by_side["right"]))
    return _Layout(wide=images)


def _side_folders(folder: Path) -> tuple[Path, Path] | None:
    """The subfolders that hold the left and the right images."""
    folders = [f for f in sorted(folder.iterdir()) if f.is_dir() and image_files(f)]
    left = [f for f in folders if side_of(_spaced(f.name)) == "left"]
    right = [f for f in folders if side_of(_spaced(f.name)) == "right"]
    if len(left) == len(right) == 1:
        return left[0], right[0]
    if left or right:
        raise InputError(
            f"{folder}: expected one folder of left and one of right images, found {len(left) + len(right)}"
        )
    return None


def _videos(folder: Path) -> tuple[Path, ...]:
    videos = [f for f in sorted(folder.iterdir()) if f.suffix.lower() in VIDEO_SUFFIXES and f.is_file()]
    left = [f for f in videos if side_of(_spaced(f.stem)) == "left"]
    right = [f for f in videos if side_of(_spaced(f.stem)) == "right"]
    if len(left) == len(right) == 1:
        return left[0], right[0]
    if len(videos) == 1:
        return (videos[0],)
    wanted = "left and right images or videos, or images or a video side by side"
    raise InputError(f"{folder}: expected {wanted}, found {len(videos) or 'no images or'} videos")


def _spaced(name: str) -> str:
    """The name with a blank between letters and digits, so that L1 reads as l 1 (cam0 stays one word)."""
    return re.sub(r"(?<![a-z])([lr])(\d)", r"\1 \2", name.lower())


def _paired(left: Sequence[Path], right: Sequence[Path]) -> list[tuple[Path | None, Path | None]]:
    """Mates by name without the word for the side, else by number, else in order."""
    for key in (_plain, frame_number):
        lefts, rights = {key(f): f for f in left}, {key(f): f for f in right}
        unique = len(lefts) == len(left) and len(rights) == len(right)
        if unique and None not in lefts and len(lefts.keys() & rights.keys()) * 2 >= min(len(left), len(right)):
            order = [key(f) for f in left] + [key(f) for f in right if key(f) not in lefts]
            return [(lefts.get(k), rights.get(k)) for k in order]
    if len(left) != len(right):
        raise InputError(
            f"{left[0].parent}: expected as many left as right images, or names that pair up, "
            f"found {len(left)} and {len(right)}"
        )
    return list(zip(left, right, strict=True))


def _plain(file: Path) -> str:
    name = re.sub(r"left|right|cam(era)?_?[01](?!\d)", "*", file.stem.lower())
    return re.sub(r"(?<![a-z])[lr](?![a-z])", "*", name)


def _read_pair(left: Path | None, right: Path | None) -> BoardPair:
    name = _pair_name(left, right)
    if left is None or right is None:
        return BoardPair(name, None, None, "has no mate from the other camera")
    images = [_read(file) for file in (left, right)]
    for file, image in zip((left, right), images, strict=True):
        if image is None:
            return BoardPair(name, None, None, f"{file.parent.name}/{file.name} cannot be decoded")
    return BoardPair(name, images[0], images[1])


def _read(file: Path) -> U8 | None:
    """(H, W) or (H, W, 3) uint8, None when it cannot be decoded; deeper images are stretched to fill 8 bits."""
    image = read_image(file)
    if image is None or file.suffix.lower() not in _DEEP_SUFFIXES:
        return image
    deep = cv2.imdecode(np.fromfile(file, dtype=np.uint8), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION)
    if deep is None or deep.dtype == np.uint8:
        return image
    return np.asarray(cv2.normalize(deep, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U), dtype=np.uint8)  # type: ignore[call-overload]


def _pair_name(left: Path | None, right: Path | None) -> str:
    names = dict.fromkeys(file.name for file in (left, right) if file is not None)
    return " ".join(names)


def _frame_name(index: int) -> str:
    return f"frame {index}"


def _split(name: str, image: U8 | None) -> BoardPair:
    if image is None:
        return BoardPair(name, None, None, "cannot be decoded")
    height, width = image.shape[:2]
    if width < _SIDE_BY_SIDE_ASPECT * height or width % 2:
        raise InputError(
            f"{name}: expected a left and a right image side by side (an even width, at least twice the height), "
            f"found {width}x{height}"
        )
    return BoardPair(name, image[:, : width // 2], image[:, width // 2 :])
