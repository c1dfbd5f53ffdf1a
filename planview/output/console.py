"""A terminal on which names of users' files stay text."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.text import Text

from calib.errors import printable


class PlainConsole(Console):
    """Console that shows control characters instead of sending them: a folder's name may hold escape codes.

    Markup in square brackets is text too, unless ``markup=True``.
    """

    def __init__(self, *, markup: bool = False, **options: Any) -> None:
        super().__init__(markup=markup, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """See ``rich.console.Console.render_str``."""
        return super().render_str(printable(text), **options)
