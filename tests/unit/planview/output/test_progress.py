"""Messages of a run on the terminal."""

import io

from numba import njit
from rich.console import Console
from rich.table import Table

from planview.output.progress import PlainConsole, compile_notice


def test_compiled_kernels_are_told_and_cached_ones_are_not() -> None:
    kernel = njit(lambda x: x + 1)
    told = io.StringIO()
    with compile_notice(Console(file=told)):
        kernel(1)
    assert "once per installation" in told.getvalue()
    told = io.StringIO()
    with compile_notice(Console(file=told)):
        kernel(1)
    assert told.getvalue() == ""


EVIL = "out\x1b]0;owned\x07\x1b[31m[bold]x[/]\udcff"


def test_console_shows_escape_codes_and_markup_of_names_as_text() -> None:
    file = io.StringIO()
    console = PlainConsole(file=file, force_terminal=True, width=200, color_system=None)
    table = Table(show_header=False, box=None)
    table.add_row("results", EVIL)
    console.print(EVIL)
    console.print(table)
    assert "\x1b" not in file.getvalue() and "\x07" not in file.getvalue()
    assert file.getvalue().count("\\x1b[31m[bold]x[/]\\udcff") == 2
