"""Libraries with needs of their own: silence for OpenCV, and open3d only where it is used.

open3d renders scenes and writes clouds of points; tracking does without it. It weighs some hundred megabytes and needs
system libraries, so that it is imported only where it is used.
"""

from __future__ import annotations

import os
from typing import Any

from calib.errors import WorkError
from calib.io import reason


def silence_libraries() -> None:
    """Silence OpenCV and FFmpeg about files that they cannot read, for which we have our own sentence; a level that the
    user has set stays. Works before OpenCV is imported."""
    os.environ.setdefault("OPENCV_LOG_LEVEL", "FATAL")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET


def import_open3d(purpose: str) -> Any:
    """The module; its ``purpose`` is the subject of the sentence when it is missing."""
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise WorkError(
            f"{purpose} needs open3d (pip install open3d) and its system libraries "
            f"(on Debian: apt install libegl1 libgl1 libusb-1.0-0 libgomp1): {reason(error)}"
        ) from error
    return open3d
