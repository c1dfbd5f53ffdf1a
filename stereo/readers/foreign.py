"""What a path holds that is no recording, and the way out."""

from __future__ import annotations

import re
from pathlib import Path

from calib.text import reason

_POINTER = re.compile(rb"\Aversion https://git-lfs\.github\.com/spec/v1\noid [^\n]+\nsize (\d+)")
_NAMED = {
    ".svo": "a ZED recording, which only the ZED SDK reads: its SVO export (ZED_SVO_Export, or ZED_Explorer) gives "
    "side-by-side video or images",
    ".oni": "an OpenNI recording, which only OpenNI reads: export its images and depth",
    ".klg": "a Kintinuous log: export its images and depth",
    ".bag": "a file of that name that is no ROS 1 bag",
    ".mcap": "a file of that name that is no MCAP file",
    ".db3": "a file of that name that is no SQLite database",
}
_NAMED[".svo2"] = _NAMED[".svo"]
_ARCHIVES = frozenset({".zip", ".tar", ".gz", ".tgz", ".bz2", ".xz", ".7z", ".rar", ".zst"})


def content_text(path: Path) -> str:
    """What there is instead of a recording, for a message."""
    if path.is_dir():
        return ", ".join(sorted(f.name for f in path.iterdir())[:6]) or "an empty folder"
    return "another file" if path.is_file() else "neither a file nor a folder"


def foreign_text(path: Path) -> str | None:
    """What a file is that is known to be no recording, or none that can be read here, and the way out."""
    if not path.is_file():
        return None
    try:
        with path.open("rb") as file:
            head = file.read(256)
    except OSError as error:
        return f"a file that cannot be read ({reason(error)})"
    if pointer := _POINTER.match(head):
        return f"a git-lfs pointer instead of the file of {int(pointer[1])} bytes: git lfs pull fetches it"
    suffix = path.suffix.lower()
    if suffix in _ARCHIVES:
        return "an archive: unpack it"
    return _NAMED.get(suffix, None if head else "an empty file")
