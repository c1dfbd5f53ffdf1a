"""Print how far each room is from its targets in budget.toml; ``--lower`` lowers the ceilings to what is there now.

Run: python tools/budget.py [--lower]
"""

from __future__ import annotations

import ast
import io
import re
import signal
import sys
import tokenize
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "budget.toml"
BUDGET: dict[str, Any] = tomllib.loads(FILE.read_text(encoding="utf-8"))

LAYOUT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)


@dataclass
class Size:
    """Amount of program in some files: names, numbers, operators and strings, and the lines that hold them."""

    tokens: int = 0
    code_lines: int = 0
    double_assignments: int = 0
    conditionals: int = 0
    comprehensions: int = 0

    def __add__(self, other: Size) -> Size:
        return Size(*(mine + more for mine, more in zip(vars(self).values(), vars(other).values(), strict=True)))

    @property
    def density(self) -> float:
        """Tokens per line of code, to a tenth."""
        return round(self.tokens / max(self.code_lines, 1), 1)

    def per_1000_lines(self, kind: str) -> int:
        """Double assignments, conditionals or comprehensions per 1,000 lines of code."""
        count: int = getattr(self, kind)
        return round(1000 * count / max(self.code_lines, 1))


def rooms() -> list[str]:
    """All rooms: the packages, and the folders of planview. ``planview/*`` are the files next to the folders."""
    inside = sorted(path.parent.name for path in (ROOT / "planview").glob("*/__init__.py"))
    return ["calib", "stereo", "benchmarks", "planview/*", *(f"planview/{name}" for name in inside)]


def files_of(room: str) -> list[Path]:
    """All Python files of a room, or of ``tests``."""
    folder = ROOT / room.removesuffix("/*")
    return sorted(folder.glob("*.py") if room.endswith("/*") else folder.rglob("*.py"))


def docstring_lines(tree: ast.Module) -> set[int]:
    """Numbers of the lines that hold docstrings or other strings that stand alone."""
    lines: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return lines


def size_of_text(text: str) -> Size:
    """Size of one file's text."""
    tree = ast.parse(text)
    size = Size()
    lines: set[int] = set()
    docstrings = docstring_lines(tree)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in LAYOUT and token.start[0] not in docstrings:
            size.tokens += 1
            lines.update(range(token.start[0], token.end[0] + 1))
    size.code_lines = len(lines)
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple):
            size.double_assignments += isinstance(node.targets[0], ast.Tuple)
        size.conditionals += isinstance(node, ast.IfExp)
        size.comprehensions += isinstance(node, COMPREHENSIONS)
    return size


def size_of(room: str) -> Size:
    """Size of a room; that of all rooms for ``total``."""
    names = rooms() if room == "total" else [room]
    texts = [path.read_text(encoding="utf-8") for name in names for path in files_of(name)]
    return sum(map(size_of_text, texts), Size())


def measured() -> dict[str, dict[str, float]]:
    """What each table of budget.toml limits, as it is now."""
    sizes = {name: size_of(name) for name in BUDGET["tokens"]}
    return {
        "tokens": {name: size.tokens for name, size in sizes.items()},
        "density": {name: size.density for name, size in sizes.items()},
        "per 1000 lines": {name: sizes["total"].per_1000_lines(name) for name in BUDGET["per 1000 lines"]},
    }


def main(lower: bool) -> None:
    """Print the tables, and rewrite the ceilings when they are to be lowered."""
    parts = re.split(r"(?m)^(?=\[)", FILE.read_text(encoding="utf-8"))
    for table, sizes in measured().items():
        print(table)
        for name, size in sizes.items():
            budget = BUDGET[table][name]
            print(f"  {name:22} {size:8}, target {budget['target']:8}: {size - budget['target']:+8.6g}")
            ceiling = min(budget["ceiling"], max(size, budget["target"]))
            line = rf'(?m)^("{re.escape(name)}" = .*ceiling = )[\d.]+'
            parts = [
                re.sub(line, rf"\g<1>{ceiling}", p) if p.startswith((f"[{table}]", f'["{table}"]')) else p
                for p in parts
            ]
    if lower:
        FILE.write_text("".join(parts), encoding="utf-8")


if __name__ == "__main__":
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # a pager may close early
    main("--lower" in sys.argv[1:])
