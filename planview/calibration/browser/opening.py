"""A session for a video or a stereo recording."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from calib.errors import InputError, WorkError
from calib.images import focal_share
from calib.people.model import KnownValues
from calib.rig import Floor
from calib.types import U8
from planview.calibration.browser.session import CalibrationSession
from planview.calibration.floor import FloorView, view_floor
from stereo.floor import FloorSearch
from stereo.readers import OpenOptions, holds_pair, open_recording, open_video

PHOTOGRAPHS = (".jpg", ".jpeg", ".heic", ".tif", ".tiff")


def open_session(path: Path, calibration: Path | None = None, n_frames: int = 40) -> CalibrationSession:
    """Frames to draw on, spread over a video of one camera, or the depth of a stereo recording.

    The focal length of photographs that say it is taken as known.

    Raises:
        InputError: neither a video nor a stereo recording.
        WorkError: no usable frame.
    """
    if path.is_dir() and (calibration is not None or holds_pair(path)):
        recording = open_recording(path, OpenOptions(calibration))
        view = view_floor(recording, FloorSearch())
        return CalibrationSession(str(path), [view.image], [0], view, _plain_floor(view))
    video = open_video(path)
    step = max(1, video.n_frames // n_frames)
    kept = [(frame.index, frame.image) for frame in video if frame.index % step == 0]
    if not kept:
        raise InputError(f"{path}: expected a video with frames, found none that can be decoded")
    session = CalibrationSession(path.name, [image for _, image in kept], [index for index, _ in kept])
    session.known = known_of(path, session.size)
    return session


def frames_at(path: Path, indices: Sequence[int]) -> list[tuple[int, U8]]:
    """Pictures of a video at some positions, as far as it has them."""
    wanted, found = set(indices), []
    for frame in open_video(path):
        if frame.index in wanted:
            found.append((frame.index, frame.image))
        if frame.index >= max(wanted):
            break
    return found


def known_of(path: Path, size: tuple[int, int]) -> KnownValues:
    """The focal length of the first photograph of a folder, where it says it."""
    photographs = sorted(p for p in path.iterdir() if p.suffix.lower() in PHOTOGRAPHS) if path.is_dir() else []
    with suppress(InputError):
        if photographs:
            return KnownValues(focal_px=focal_share(photographs[0]) * math.hypot(*size))
    return KnownValues()


def _plain_floor(view: FloorView) -> Floor | None:
    try:
        return view.find()
    except WorkError:
        return None
