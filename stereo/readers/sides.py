"""Which of two cameras a name refers to."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

_WORD = re.compile(r"left|right|(?<![a-z])[lr](?![a-z])", re.IGNORECASE)
_NUMBER = re.compile(
    r"(?<![a-z])(cam|camera|im|img|image|view|infra|ir|i|c|eye|sensor|lens|device)([_-]?)(\d{1,2})(?!\d)", re.IGNORECASE
)


class Sided(NamedTuple):
    """Names of two cameras.

    Attributes:
        left, right: positions in the list of names.
        rest: of every name, what is left without the side; empty where it tells none.
    """

    left: list[int]
    right: list[int]
    rest: list[str]


def split_sides(names: Sequence[str]) -> Sided | None:
    """Tell left from right by the words left and right (or L and R), else by two camera numbers, the lower one left.

    Args:
        names: without folder and ending; names that tell no side are passed over.
    Returns:
        None when the names do not tell two sides.
    """
    by_word = [_by_word(name) for name in names]
    sides = [found[0] if found else "" for found in by_word]
    if not {"l", "r"} <= set(sides):
        by_word = [_by_number(name) for name in names]
        numbers = sorted({found[0] for found in by_word if found}, key=int)
        if len(numbers) != 2:
            return None
        sides = ["" if not found else "l" if found[0] == numbers[0] else "r" for found in by_word]
    left, right = ([i for i, side in enumerate(sides) if side == one] for one in ("l", "r"))
    return Sided(left, right, [found[1] if found else "" for found in by_word])


def _by_word(name: str) -> tuple[str, str] | None:
    found = {word[0].lower() for word in _WORD.findall(name)}
    return (found.pop(), _WORD.sub("*", name)) if len(found) == 1 else None


def _by_number(name: str) -> tuple[str, str] | None:
    found = {number for _, _, number in _NUMBER.findall(name)}
    return (found.pop(), _NUMBER.sub(r"\1\2*", name)) if len(found) == 1 else None
