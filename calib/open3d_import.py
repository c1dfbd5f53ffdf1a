"""open3d, which renders scenes and writes clouds of points; tracking does without it.

It weighs some hundred megabytes and needs system libraries, so that it is imported only where it is used.
"""

from __future__ import annotations

from typing import Any

from calib.errors import WorkError
from calib.text import reason

SYSTEM_LIBRARIES = "libegl1 libgl1 libusb-1.0-0 libgomp1"
"""Debian's packages that open3d's wheel needs."""


def import_open3d(purpose: str) -> Any:
    """The module.

    Args:
        purpose: what it is needed for, the subject of the sentence when it is missing.
    Raises:
        WorkError: it is not installed, or a system library is missing.
    """
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise WorkError(
            f"{purpose} needs open3d (pip install open3d) and its system libraries "
            f"(on Debian: apt install {SYSTEM_LIBRARIES}): {reason(error)}"
        ) from error
    return open3d
