"""Print how far each room is from its target in budget.toml; ``--lower`` lowers the ceilings to what is there now.

Run: python tools/budget.py [--lower]
"""

from __future__ import annotations

import re
import signal
import sys
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "budget.toml"
BUDGET: dict[str, Any] = tomllib.loads(FILE.read_text(encoding="utf-8"))


def rooms() -> list[str]:
    """All rooms: the packages, and the folders of planview. ``planview/*`` are the files next to the folders."""
    inside = sorted(path.parent.name for path in (ROOT / "planview").glob("*/__init__.py"))
    return ["calib", "stereo", "benchmarks", "planview/*", *(f"planview/{name}" for name in inside)]


def files_of(room: str) -> list[Path]:
    """All Python files of a room."""
    folder = ROOT / room.removesuffix("/*")
    return sorted(folder.glob("*.py") if room.endswith("/*") else folder.rglob("*.py"))


def lines_of(room: str) -> int:
    """Lines of a room; those of all rooms for ``total``."""
    names = rooms() if room == "total" else [room]
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for name in names for path in files_of(name))


def counts() -> dict[str, int]:
    """Files and classes of all rooms, and lines of tests."""
    sources = [path.read_text(encoding="utf-8") for room in rooms() for path in files_of(room)]
    tests = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("*.py")]
    return {
        "files": len(sources),
        "classes": sum(len(re.findall(r"(?m)^ *class \w+", text)) for text in sources),
        "lines of tests": sum(len(text.splitlines()) for text in tests),
    }


def main(lower: bool) -> None:
    """Print the table, and rewrite the ceilings when they are to be lowered."""
    text = FILE.read_text(encoding="utf-8")
    sizes = {name: lines_of(name) for name in BUDGET["rooms"]} | counts()
    for name, budget in (BUDGET["rooms"] | BUDGET["counts"]).items():
        print(f"{name:22} {sizes[name]:6}, target {budget['target']:6}: {sizes[name] - budget['target']:+6}")
        ceiling = min(budget["ceiling"], max(sizes[name], budget["target"]))
        text = re.sub(rf'(?m)^("{re.escape(name)}" = .*ceiling = )\d+', rf"\g<1>{ceiling}", text)
    if lower:
        FILE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # a pager may close early
    main("--lower" in sys.argv[1:])
