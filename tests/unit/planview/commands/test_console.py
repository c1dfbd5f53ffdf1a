"""What commands draw: messages, lines about what is done, and a bar."""

import io
import logging

from numba import njit
from rich.table import Table

from planview.commands.console import PlainConsole, compile_notice, drawing

LOG = logging.getLogger("planview.somewhere")


def test_messages_of_the_library_are_lines(capsys):
    with drawing() as bar:
        LOG.debug("tracking")
        bar(3, 10)
        LOG.info("the run is finished")
    assert capsys.readouterr().err.strip() == "the run is finished"


def test_quiet_drawing_shows_addresses_alone(capsys):
    with drawing(quiet=True):
        LOG.info("the run is finished")
        LOG.warning("open http://127.0.0.1:9090/")
    assert capsys.readouterr().err.strip() == "open http://127.0.0.1:9090/"


def test_kernels_that_are_compiled_are_announced(caplog):
    kernel = njit(lambda x: x + 1)
    with caplog.at_level(logging.INFO), compile_notice():
        kernel(1)
    assert "once per installation" in caplog.text


def test_kernels_that_are_cached_are_not_announced(caplog):
    kernel = njit(lambda x: x + 1)
    kernel(1)
    with caplog.at_level(logging.INFO), compile_notice():
        kernel(1)
    assert caplog.text == ""


EVIL = "out\x1b]0;owned\x07\x1b[31m[bold]x[/]:car:\udcff"


def test_console_shows_names_as_text():
    file = io.StringIO()
    console = PlainConsole(file=file, force_terminal=True, width=200, color_system=None)
    table = Table(show_header=False, box=None)
    table.add_row("results", EVIL)
    console.print(EVIL)
    console.print(table)
    assert "\x1b" not in file.getvalue()
    assert "\x07" not in file.getvalue()
    assert file.getvalue().count("\\x1b[31m[bold]x[/]:car:\\udcff") == 2
