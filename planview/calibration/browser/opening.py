"""A session for a video or a stereo recording."""

from __future__ import annotations

from pathlib import Path

from calib.errors import InputError
from calib.types import U8
from planview.calibration.browser.session import CalibrationSession
from planview.calibration.floor import view_floor
from stereo.floor import FloorSearch
from stereo.readers import OpenOptions, open_recording, open_video


def open_session(path: Path, calibration: Path | None = None, n_frames: int = 40) -> CalibrationSession:
    """Frames to draw on, spread over a video of one camera, or the depth of a stereo recording.

    Raises:
        InputError: neither a video nor a stereo recording.
        WorkError: no usable frame.
    """
    if path.is_dir() and (calibration is not None or _is_stereo(path)):
        recording = open_recording(path, OpenOptions(calibration))
        view = view_floor(recording, FloorSearch())
        return CalibrationSession(str(path), [view.image], [0], view)
    video = open_video(path)
    step = max(1, video.n_frames // n_frames)
    frames: list[U8] = []
    indices: list[int] = []
    for frame in video:
        if frame.index % step == 0:
            frames.append(frame.image)
            indices.append(frame.index)
    if not frames:
        raise InputError(f"{path}: expected a video with frames, found none that can be decoded")
    return CalibrationSession(path.name, frames, indices)


def _is_stereo(folder: Path) -> bool:
    names = {p.stem for p in folder.iterdir()}
    return {"left", "right"} <= names
