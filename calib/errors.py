"""The two kinds of failure that a user is shown, each as one line that a terminal can print."""

MESSAGE_MAX = 600
"""Characters of a message; of a longer one, e.g. with a damaged file's key in it, the middle is left out."""


class _OneLineError(Exception):
    """Said in one line of printable characters, whatever the damaged file held that is quoted in it."""

    def __str__(self) -> str:
        """The message."""
        line = printable(" ".join(super().__str__().splitlines())).replace("\t", "\\t")
        half = MESSAGE_MAX // 2 - 3
        return line if len(line) <= MESSAGE_MAX else f"{line[:half]} ... {line[-half:]}"


class InputError(_OneLineError):
    """Bad input or wrong usage: one sentence naming the file, what was expected and what was found (exit status 2)."""


class WorkError(_OneLineError):
    """The input was acceptable but the work could not be done, e.g. no floor is visible (exit status 1)."""


def printable(text: str) -> str:
    r"""The text with control characters written out, e.g. ``\x1b``; line ends and tabs stay."""
    return "".join(c if c in "\n\t" or c.isprintable() else ascii(c)[1:-1] for c in text)
