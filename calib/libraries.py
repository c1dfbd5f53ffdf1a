"""What libraries need of the machine: a place for compiled kernels, and open3d where it is used.

open3d renders scenes and writes clouds of points; tracking does without it. It weighs some hundred megabytes and needs
system libraries, so that it is imported only where it is used.
"""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calib.errors import WorkError
from calib.io import reason

VARIABLE = "NUMBA_CACHE_DIR"


def silence_libraries() -> None:
    """What OpenCV and FFmpeg print about files that they cannot read is said in our own sentence; a level that the user
    has set stays. Works before OpenCV is imported."""
    os.environ.setdefault("OPENCV_LOG_LEVEL", "FATAL")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET


def prepare_kernel_cache() -> None:
    """Have numba cache in a temporary folder, with a warning, when it would find no place and give up."""
    if VARIABLE in os.environ or first_writable(usual_places()):
        return
    folder = tempfile.mkdtemp(prefix="planview-kernels-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ[VARIABLE] = folder
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = folder
    warnings.warn(
        f"neither planview's folder nor the user's cache can be written: kernels are compiled into {folder}, which is "
        f"removed at the end and costs a minute at each start; set {VARIABLE} to a folder that stays",
        RuntimeWarning,
        stacklevel=2,
    )


def usual_places() -> list[Path]:
    """Where numba looks: next to the modules, then in the user's cache."""
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return [Path(__file__).parent / "__pycache__", Path(cache) / "numba"]


def first_writable(places: Sequence[Path]) -> Path | None:
    """The first place in which a file can be made, or that can be made itself; nothing is written."""
    for place in places:
        there = next(folder for folder in (place, *place.parents) if folder.exists())
        if there.is_dir() and os.access(there, os.W_OK | os.X_OK):
            return place
    return None


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
