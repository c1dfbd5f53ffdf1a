"""Commands run in this process, and what they print: the types of fixtures."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

Cli = Callable[..., tuple[int, str]]
Succeed = Callable[..., str]
Refused = Callable[..., str]
ShownBy = Callable[..., str]
JsonOf = Callable[..., dict[str, Any]]


def contents(folder: Path) -> dict[str, bytes]:
    """What every file of a folder holds."""
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def one_sentence(printed: str) -> str:
    """The last line; a refusal is one line that follows no traceback."""
    assert "Traceback" not in printed
    lines = [line for line in printed.splitlines() if line.startswith("planview: ")]
    assert len(lines) == 1
    return lines[0]
