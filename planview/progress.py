"""How far long work is: a function that the work calls, and that a program may draw."""

from collections.abc import Callable

Progress = Callable[[int, int | None], object]
"""Takes how much is done, and how much there is in all; None where that is open."""


def unseen(done: int, total: int | None) -> None:
    """Nobody watches."""
