"""The two kinds of failure that a user is shown."""


class InputError(Exception):
    """Bad input or wrong usage: one sentence naming the file, what was expected and what was found (exit status 2)."""


class WorkError(Exception):
    """The input was acceptable but the work could not be done, e.g. no floor is visible (exit status 1)."""
