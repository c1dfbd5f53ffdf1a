"""The two kinds of failure that a user is shown, each as one line that a terminal can print."""

from __future__ import annotations

from collections.abc import Callable

MESSAGE_MAX = 600
"""Characters of a message; of a longer one, e.g. with a damaged file's key in it, the middle is left out."""


class _OneLineError(Exception):
    """Said in one line of printable characters, whatever the damaged file held that is quoted in it.

    Attributes:
        argument: of a Python function, whose value is refused; the sentence begins with it.
        remedy: the argument that gives what is missing; the sentence ends with it.
    """

    def __init__(self, message: str, *, argument: str = "", remedy: str = "") -> None:
        super().__init__(message)
        self.argument = argument
        self.remedy = remedy

    def __str__(self) -> str:
        """The sentence, about Python's arguments."""
        return self.sentence(lambda argument: argument if "=" in argument else f"{argument}=")

    def sentence(self, name: Callable[[str], str]) -> str:
        """The message with its arguments, which are called as ``name`` gives them."""
        first = f"{name(self.argument)}: " if self.argument else ""
        last = f"; use {name(self.remedy)}" if self.remedy else ""
        return _one_line(f"{first}{self.args[0]}{last}")


class UnreadableError(ValueError):
    """Reason for which something that is there cannot be read, in words that end "found ...": raised where it shows,
    and carried to the sentence that names the file or the topic."""


class InputError(_OneLineError):
    """Bad input or wrong usage: one sentence naming the file, what was expected and what was found (exit status 2)."""

    def about(self, subject: str) -> InputError:
        """The same error with what it is about in front, such as a file."""
        return InputError(f"{subject}: {self.args[0]}", argument=self.argument, remedy=self.remedy)


class WorkError(_OneLineError):
    """The input was acceptable but the work could not be done, e.g. no floor is visible (exit status 1).

    Attributes:
        in_pictures: whether pictures of the recording, with its depth and rows, show why.
    """

    def __init__(self, message: str, *, remedy: str = "", in_pictures: bool = False) -> None:
        super().__init__(message, remedy=remedy)
        self.in_pictures = in_pictures


def _one_line(text: str) -> str:
    """Printable text without line ends, and without its middle where it is longer than ``MESSAGE_MAX``."""
    line = printable(" ".join(text.splitlines())).replace("\t", "\\t")
    half = MESSAGE_MAX // 2 - 3
    return line if len(line) <= MESSAGE_MAX else f"{line[:half]} ... {line[-half:]}"


def printable(text: str) -> str:
    r"""The text with control characters written out, e.g. ``\x1b``; line ends and tabs stay."""
    return "".join(c if c in "\n\t" or c.isprintable() else ascii(c)[1:-1] for c in text)
