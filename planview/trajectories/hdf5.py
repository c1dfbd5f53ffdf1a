"""HDF5 files of users, opened once what the library would read without end is refused."""

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
def opened(path: Path) -> Iterator[Any]:
    """The file, to read. Raises OSError, RuntimeError: unreadable, or another file. ValueError: a damaged heap of
    strings: libhdf5 2.0 and before walk in place over an object of no size."""
    import h5py  # a tenth of a second, and only these files need it

    with path.open("rb") as raw, mmap.mmap(raw.fileno(), 0, access=mmap.ACCESS_READ) as data:
        sizes = data[13:15] if data[8:9] in (b"\0", b"\1") else data[9:11]
        if data[:8] != SIGNATURE or sizes != b"\x08\x08":  # bytes of an address and of a length
            raise ValueError("another file")
        start = data.find(_HEAP)
        while start >= 0:
            (size,) = struct.unpack("<Q", data[start + 8 : start + 16].ljust(8, b"\0"))  # a file may end in it
            end, place = min(start + size, len(data)), start + 16
            while place + 16 <= end:  # object 0 is what is free, header included
                number, length = struct.unpack_from("<H6xQ", data, place)
                step = 16 + (length + 7) // 8 * 8 if number else length
                if not 0 < step <= end - place:
                    raise ValueError(f"a damaged heap of strings at byte {place}")
                place += step
            start = data.find(_HEAP, start + 1)
    with h5py.File(path, "r") as file:
        yield file
