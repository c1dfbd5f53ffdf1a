"""Files of users: text of a sane size, files written whole, and lengths and sizes as text."""

from __future__ import annotations

import errno
import math
import os
import re
import shutil
import stat
import tomllib
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from calib.errors import InputError, UnreadableError, WorkError

MAX_BYTES = 2_000_000
"""Settings, rules and calibrations are kilobytes; anything larger is something else and is not read."""
MAX_TOML = 200_000
"""TOML that people write has some thousand characters; the parser takes a second for 200,000."""
MAX_DEPTH = 32
"""Deepest nesting of tables and lists: parsers recurse, and what people write has five."""
REASONS = {
    errno.ENOENT: "nothing there", errno.EACCES: "no permission", errno.EPERM: "no permission",
    errno.ENOTDIR: "a file where a folder is expected", errno.EISDIR: "a folder",
    errno.ENOSPC: "no space left on the disk",
}  # fmt: skip
"""The system's most frequent errors, in words that end "found ..."."""
_PARTS = re.compile(r"[=,\n]")
_BRACKETS = re.compile(r"[\[\]{}]")


def entries(folder: Path) -> list[Path]:
    """Entries of a folder by name, without hidden files, which systems add to those of people (``._*``). Raises
    InputError: a folder that cannot be read, which does not count as empty."""
    with expecting(folder, "a folder that can be read", OSError):
        return sorted(path for path in folder.iterdir() if not path.name.startswith("."))


def refuse_unreadable(path: Path) -> None:
    """Raise InputError for a recording that may not be read: it does not count as absent."""
    with expecting(path, "a recording", OSError):
        if path.is_file():
            path.open("rb").close()
        elif path.is_dir():
            (path / "x").exists()  # a folder may be listed and its files still be closed
            entries(path)


def closed_text(paths: Iterable[Path]) -> str:
    """The first of these files that may not be read, for a sentence about what was found; empty without one."""
    closed = next((path for path in paths if path.exists() and not os.access(path, os.R_OK)), None)
    return f"{closed.name}, which cannot be read (no permission)" if closed else ""


def reason(error: Exception) -> str:
    """Reason for which a file cannot be read or written, in words that end "found ..." or "cannot be written (...)"."""
    if isinstance(error, OSError) and error.errno in REASONS:
        return REASONS[error.errno]
    text = str(getattr(error, "strerror", None) or error)
    return " ".join(text.split()) or type(error).__name__


@contextmanager
def expecting(path: Path | str, what: str, *errors: type[Exception]) -> Iterator[None]:
    """Turns errors of reading ``what`` a file should hold into an InputError that names the file."""
    try:
        yield
    except errors as error:
        raise InputError(f"{path}: expected {what}, found {reason(error)}") from error


@contextmanager
def expecting_table(path: Path, what: str) -> Iterator[None]:
    """Turns errors of taking values out of a table that a file holds into an InputError that names the file."""
    try:
        yield
    except KeyError as error:
        raise InputError(f"{path}: expected {what} with the key {error}, found none") from error
    except (ValueError, TypeError, AttributeError, OverflowError) as error:
        text = str(error)
        problem = text if text.startswith("expected a camera") else f"expected {what}, found {text}"
        raise InputError(f"{path}: {problem}") from error


def file_size(path: Path) -> int:
    """Size of a regular file that can be opened [bytes]; reading a pipe or a device might never end.
    Raises UnreadableError: nothing there, no permission, or no regular file."""
    try:
        status = path.stat()
        if stat.S_ISREG(status.st_mode):
            path.open("rb").close()
            return status.st_size
    except (OSError, ValueError) as error:
        dangling = isinstance(error, FileNotFoundError) and path.is_symlink()
        raise UnreadableError("a link to a file that is not there" if dangling else reason(error)) from error
    raise UnreadableError("a folder" if stat.S_ISDIR(status.st_mode) else "a pipe or a device")


def require_file(path: Path, what: str) -> int:
    """``file_size`` of what should be ``what``. Raises InputError: it cannot be read."""
    try:
        return file_size(path)
    except UnreadableError as error:
        if not path.is_symlink():
            refuse_missing(path)
        raise InputError(f"{path}: expected {what}, found {error}") from error


def refuse_missing(path: Path) -> None:
    """Raise InputError for a path that is not there, about its folder where that is not there either."""
    if not path.exists():
        where = path if path.parent.exists() else path.parent
        raise InputError(f"{where}: no such file or folder")


def read_text(path: Path, what: str, max_bytes: int = MAX_BYTES) -> str:
    """The text of a small file in UTF-8, with or without a byte order mark; messages name ``what`` it should be. Raises
    InputError: no regular file, larger than ``max_bytes``, unreadable, or not text."""
    size = require_file(path, what)
    if size > max_bytes:
        raise InputError(f"{path}: expected {what} of up to {max_bytes} bytes, found {size}")
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected {what} as text, found binary data at byte {error.start}") from error


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text. Raises ValueError: not TOML, longer than MAX_TOML, or nested deeper than MAX_DEPTH."""
    if len(text) > MAX_TOML:
        raise ValueError(f"one of {len(text)} characters (at most {MAX_TOML})")
    if max(part.count(".") for part in _PARTS.split(text)) > MAX_DEPTH or _depth(text) > MAX_DEPTH:
        raise ValueError(f"keys or lists nested more than {MAX_DEPTH} deep")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(str(error).replace("end of document", f"the end, line {len(text.splitlines())}")) from error
    except RecursionError as error:
        raise ValueError("keys or lists nested too deep") from error


def load_toml(path: Path, what: str) -> dict[str, Any]:
    """The tables of a TOML file. Raises InputError: as ``read_text``, or not TOML."""
    try:
        return parse_toml(read_text(path, what))
    except ValueError as error:
        raise InputError(f"{path}: expected {what}, found {error}") from error


def _depth(text: str) -> int:
    """Deepest nesting of brackets, those in strings and comments included."""
    depth = deepest = 0
    for bracket in _BRACKETS.findall(text):
        depth = max(0, depth + (1 if bracket in "[{" else -1))
        deepest = max(deepest, depth)
    return deepest


PART = ".part"
"""Ending of a file that is being written; what is found under it later is what a killed program left."""


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """The place to write a file to, which becomes ``path`` in one step when the block ends without an error; its folder
    is made if need be.

    After an error nothing is left of it, and an earlier file at ``path`` is as it was. Links are followed; a device or
    a pipe, which cannot be replaced, is written directly. Raises OSError: it cannot be written, synced or renamed.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        yield target
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(target.name + PART)
    try:
        yield part
        sync(part)
        os.replace(part, target)
    except BaseException:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise
    # Bring a folder's names to the disk, where the system can.
    with suppress(OSError):
        sync(target.parent)


ATTEMPT = ".attempt-"
"""Begin of the name of a folder that is being filled; what is found under it later is what a killed program left."""


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A new folder next to another one, whose name it gets when the block ends without an error: results are there when
    they are whole, and of two at the same time the first that is done stays. Raises WorkError: it cannot be made."""
    part = folder.parent / f"{ATTEMPT}{os.getpid()}-{uuid.uuid4().hex[:8]}"
    try:
        part.mkdir(parents=True)
        yield part
        if not folder.is_dir():
            part.rename(folder)
    except OSError as error:
        if not folder.is_dir():
            raise WorkError(f"{folder}: cannot be written ({reason(error)})") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def write_whole(path: Path, content: str | bytes) -> None:
    """Replace a file by text (UTF-8) or bytes in one step (see ``whole_file``)."""
    with whole_file(path) as part:
        part.write_bytes(content.encode() if isinstance(content, str) else content)


def sync(path: Path) -> None:
    """Bring a file's content to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


FREE_BYTES_MIN = 64 * 2**20
"""Free disk space for what comes next [bytes]: on a full disk HDF5 ends the process and rerun waits for ever."""


def refuse_full_disk(path: Path, size: int = 0) -> None:
    """Raises WorkError: the disk of a file that grows has no room for ``size`` more bytes and FREE_BYTES_MIN."""
    needed = FREE_BYTES_MIN + size
    free = shutil.disk_usage(path.parent).free
    if free < needed:
        raise WorkError(
            f"{path}: expected at least {needed >> 20} MB of free disk, found {free >> 20}: "
            "the disk is full; earlier frames are kept"
        )


def toml_string(text: str) -> str:
    """A TOML string."""
    escaped = "".join(c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in text)
    return f'"{escaped}"'


UNITS_M: dict[str, float] = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "ft": 0.3048}
_LENGTH = re.compile(r"\s*([0-9.,eE+-]*?)\s*([a-zA-Zµ]+)\s*")


def parse_length(text: str, what: str = "length") -> float:
    """A positive length in metres, from a number with its unit; a unit alone means one of it. Messages name ``what`` it
    is. Raises InputError: no unit, an unknown one, or no positive finite number."""
    match = _LENGTH.fullmatch(text.replace("µ", "u"))
    units = ", ".join(UNITS_M)
    if match is None or match[2].lower() not in UNITS_M:
        raise InputError(f"{what}: expected a length with its unit ({units}), e.g. 24.23mm, found {text!r}")
    try:
        value = float(match[1] or 1)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise InputError(f"{what}: expected a positive length such as 24.23mm, found {text!r}")
    return value * UNITS_M[match[2].lower()]


def parse_size(text: str, what: str = "size") -> tuple[int, int]:
    """Width and height from text such as 1280x720. Raises InputError: other text."""
    match = re.fullmatch(r"\s*([1-9]\d{0,4})\s*[xX×]\s*([1-9]\d{0,4})\s*", text)
    if match is None:
        raise InputError(f"{what}: expected WIDTHxHEIGHT, e.g. 1280x720, found {text!r}")
    return int(match[1]), int(match[2])


def size_text(size: tuple[int, int]) -> str:
    """Width and height as ``parse_size`` reads them."""
    return f"{size[0]}x{size[1]}"
