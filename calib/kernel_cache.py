"""A place for compiled kernels where neither the installation nor the user's cache can be written."""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"


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
    """Where numba looks: beside the modules, then in the user's cache."""
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return [Path(__file__).parent / "__pycache__", Path(cache) / "numba"]


def first_writable(places: Sequence[Path]) -> Path | None:
    """The first place in which a file can be made."""
    for place in places:
        with suppress(OSError):
            place.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=place):
                return place
    return None
