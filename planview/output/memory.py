"""Memory of long runs."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress


def return_unused_memory() -> None:
    """Let the C library return to the system what was freed but is kept for later.

    Buffers of many sizes, made and freed by several threads, leave holes that glibc does not return by itself: the
    resident memory of an hour grew by a fiftieth though no object was kept. Elsewhere nothing is done.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # a C library without it
            ctypes.CDLL(None).malloc_trim(0)
