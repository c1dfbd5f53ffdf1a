"""Commands run in this process, and what they say (fixtures ``say``, ``refused`` and ``json_of``)."""

from collections.abc import Callable
from typing import Any

Say = Callable[..., tuple[int, str]]
Refused = Callable[..., str]
JsonOf = Callable[..., dict[str, Any]]


def one_sentence(told: str) -> str:
    """The last line; a refusal is one line that follows no traceback."""
    assert "Traceback" not in told
    lines = [line for line in told.splitlines() if line.startswith("planview: ")]
    assert len(lines) == 1
    return lines[0]
