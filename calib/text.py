"""Text files of users: regular, of a sane size, and nested no deeper than people write."""

from __future__ import annotations

import errno
import re
import stat
import tomllib
from pathlib import Path
from typing import Any

from calib.errors import InputError

MAX_BYTES = 2_000_000
"""Settings, rules and calibrations are kilobytes; anything larger is something else and is not read."""
MAX_TOML = 200_000
"""TOML that people write has some thousand characters; the parser takes a second for so many."""
MAX_DEPTH = 32
"""Deepest nesting of tables and lists: parsers recurse, and what people write has five (our choice)."""
REASONS = {
    errno.ENOENT: "nothing there",
    errno.EACCES: "no permission",
    errno.EPERM: "no permission",
    errno.EEXIST: "something else in its place",
    errno.ENOTDIR: "a file where a folder is expected",
    errno.EISDIR: "a folder",
    errno.ENOSPC: "no space left on the disk",
    errno.EDQUOT: "no space left in the quota",
    errno.EROFS: "a file system that is read-only",
    errno.ENAMETOOLONG: "a name that is too long",
    errno.ELOOP: "links that lead in a circle",
    errno.EMFILE: "too many open files",
    errno.EIO: "a disk that fails",
}
"""What the system's error numbers mean, for people."""
_PARTS = re.compile(r"[=,\n]")
_BRACKETS = re.compile(r"[\[\]{}]")


def reason(error: Exception) -> str:
    """Why a file cannot be read or written, in words that end "found ..." or "cannot be written (...)"."""
    text = REASONS.get(error.errno or 0) if isinstance(error, OSError) else None
    return text or " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__


def require_file(path: Path, what: str) -> int:
    """Size of a regular file [bytes]; reading a pipe or a device could wait or go on for ever.

    Raises:
        InputError: nothing there, or no regular file.
    """
    try:
        status = path.stat()
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected {what}, found {reason(error)}") from error
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe or a device"
        raise InputError(f"{path}: expected {what}, found {kind}")
    return status.st_size


def read_text(path: Path, what: str, max_bytes: int = MAX_BYTES) -> str:
    """The text of a small file in UTF-8, with or without a byte order mark.

    Args:
        what: the file should be, for messages.
    Raises:
        InputError: no regular file, larger than ``max_bytes``, unreadable, or not text.
    """
    size = require_file(path, what)
    if size > max_bytes:
        raise InputError(f"{path}: expected {what} of up to {max_bytes} bytes, found {size}")
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected {what}, found {reason(error)}") from error


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises:
        ValueError: not TOML, longer than MAX_TOML, or keys or lists nested deeper than MAX_DEPTH.
    """
    if len(text) > MAX_TOML:
        raise ValueError(f"expected TOML of up to {MAX_TOML} characters, found {len(text)}")
    if max(part.count(".") for part in _PARTS.split(text)) > MAX_DEPTH or _depth(text) > MAX_DEPTH:
        raise ValueError(f"expected keys and lists nested up to {MAX_DEPTH} deep, found deeper ones")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("expected keys and lists nested less deeply") from error


def load_toml(path: Path, what: str) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        InputError: as ``read_text``, or not TOML.
    """
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
