"""HDF5 files, opened to read."""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

SIGNATURE = b"\x89HDF\r\n\x1a\n"
_HEAP = b"GCOL\x01\0\0\0"
"""First bytes of a global heap, which holds strings (format specification, III.E); its size and objects follow."""


@contextmanager
def open_hdf5(path: Path) -> Iterator[Any]:
    """The file, to read. Raises OSError, RuntimeError: unreadable, or another file. ValueError: a damaged heap of
    strings."""
    import h5py  # a tenth of a second, and only these files need it

    with path.open("rb") as raw, mmap.mmap(raw.fileno(), 0, access=mmap.ACCESS_READ) as data:
        _refuse_damaged_heaps(data)
    with h5py.File(path, "r") as file:
        yield file


def _refuse_damaged_heaps(data: mmap.mmap) -> None:
    """Walk through the objects of all heaps: libhdf5 2.0 and before walk in place over an object of no size."""
    is_old = data[8:9] in (b"\0", b"\1")
    sizes = data[13:15] if is_old else data[9:11]  # bytes of an address and of a length
    if sizes != b"\x08\x08":
        raise ValueError("another file")
    start = data.find(_HEAP)
    while start >= 0:
        header = data[start + 8 : start + 16].ljust(8, b"\0")  # a file may end in it
        end = min(start + struct.unpack("<Q", header)[0], len(data))
        place = start + 16
        while place + 16 <= end:
            number, length = struct.unpack_from("<H6xQ", data, place)
            step = length  # object 0 is what is free, header included
            if number:
                step = 16 + (length + 7) // 8 * 8
            if not 0 < step <= end - place:
                raise ValueError(f"a damaged heap of strings at byte {place}")
            place += step
        start = data.find(_HEAP, start + 1)
