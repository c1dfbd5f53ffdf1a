"""Videos of a run."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2

from calib.errors import InputError, WorkError
from calib.images import write_image
from calib.io import PART, reason
from calib.types import U8
from planview.output.scene.compose import SceneComposer
from planview.output.scene.frames import SceneFrames

CODECS = {".mp4": "mp4v", ".webm": "VP80", ".avi": "MJPG", ".mkv": "mp4v"}
"""By ending: what OpenCV writes everywhere. Browsers play VP8 (.webm)."""


class FilmWriter:
    """Writes pictures of one size into a video, which is at its place when all are written.

    Args:
        path: its ending gives the format.
        fps: pictures per second.
    Raises:
        InputError: no ending of a video.
    """

    def __init__(self, path: Path, fps: float) -> None:
        if path.suffix.lower() not in CODECS:
            raise InputError(f"{path}: expected a video's name ({', '.join(CODECS)}), found {path.name!r}")
        self._path, self._fps = path, fps
        self._part = path.with_name(f"{path.stem}{PART}{path.suffix}")
        self._writer: cv2.VideoWriter | None = None
        self.count = 0

    def add(self, picture: U8) -> None:
        """Append a picture.

        Raises:
            WorkError: the video cannot be written.
        """
        if self._writer is None:
            self._writer = self._open((picture.shape[1], picture.shape[0]))
        self._writer.write(picture)
        self.count += 1

    def close(self, *, complete: bool) -> None:
        """End the video; an incomplete one is removed.

        Raises:
            WorkError: it cannot be moved to its place.
        """
        if self._writer is None:
            return
        self._writer.release()
        try:
            if complete:
                self._part.replace(self._path)
            else:
                self._part.unlink(missing_ok=True)
        except OSError as error:
            raise WorkError(f"{self._path}: cannot be written ({reason(error)})") from error

    def _open(self, size: tuple[int, int]) -> cv2.VideoWriter:
        codec = cv2.VideoWriter.fourcc(*CODECS[self._path.suffix.lower()])
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise WorkError(f"{self._path.parent}: cannot be made ({reason(error)})") from error
        writer = cv2.VideoWriter(str(self._part), codec, self._fps, size)
        if not writer.isOpened():
            raise WorkError(f"{self._path}: the video cannot be written")
        return writer


def scene_pictures_of(
    composer: SceneComposer, frames: SceneFrames | None, first: int, last: int, every: int
) -> Iterator[U8]:
    """Pictures of every n-th frame; a frame that cannot be read shows the image before it."""
    wanted = iter(range(first, last + 1, every))
    frame = next(wanted, None)
    if frames is None:
        while frame is not None:
            yield composer(frame, None)
            frame = next(wanted, None)
        return
    for index, image in frames.through(first, last):
        while frame is not None and frame <= index:
            yield composer(frame, image)
            frame = next(wanted, None)


def write_still(composer: SceneComposer, frames: SceneFrames | None, frame: int, path: Path) -> None:
    """Write a picture of one frame; the floor alone where its image cannot be read.

    Raises:
        InputError: no picture's name.
        WorkError: it cannot be written.
    """
    image = next((image for _, image in frames.at([frame])), None) if frames is not None else None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_image(path, composer(frame, image))
    except OSError as error:
        raise WorkError(f"{path}: cannot be written ({reason(error)})") from error
