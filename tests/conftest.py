"""Shared fixtures: where the real recordings are; and what was skipped without them."""

import json
import os
from pathlib import Path

import pytest
from cli import Cli, JsonOf, Refused, ShownBy, Succeed, one_sentence
from hypothesis import settings

# As in planview.cli: threads of small matrices wait for each other, most of all in tests side by side.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# The first example may compile a kernel.
settings.register_profile("unhurried", deadline=None)
settings.load_profile("unhurried")

WITHOUT_RECORDINGS = "real recordings are not here"
"""Begins the reason of every skip for that."""


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real recordings ($PLANVIEW_TEST_DATA, else ../shared/data next to the repository)."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("PLANVIEW_TEST_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"{WITHOUT_RECORDINGS} ({folder}); set PLANVIEW_TEST_DATA to run this test")
    return folder


@pytest.fixture
def cli(capsys) -> Cli:
    """Run a command in this process: exit status and what it prints on stderr."""

    def command(*argv):
        from planview.cli import main

        try:
            main([str(word) for word in argv])
        except SystemExit as left:
            return int(left.code or 0), capsys.readouterr().err
        return 0, capsys.readouterr().err

    return command


@pytest.fixture
def succeed(cli) -> Succeed:
    """Run a command that must succeed: what it prints on stderr."""

    def command(*argv):
        status, printed = cli(*argv)
        assert status == 0, printed
        return printed

    return command


@pytest.fixture
def refused(cli) -> Refused:
    """Run a command that is refused: the one sentence that gives the reason."""

    def command(*argv, status=2):
        found, printed = cli(*argv)
        assert found == status, printed
        return one_sentence(printed)

    return command


@pytest.fixture
def shown_by(capsys) -> ShownBy:
    """Run a command: what it prints on stdout."""

    def command(*argv):
        from planview.cli import main

        with pytest.raises(SystemExit) as left:
            main([*map(str, argv)])
        assert not left.value.code
        return capsys.readouterr().out

    return command


@pytest.fixture
def json_of(shown_by) -> JsonOf:
    """Run a command with --json: the object that it prints."""
    return lambda *argv: dict(json.loads(shown_by(*argv, "--json")))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print how many tests the missing recordings cost: a run without them must not pass for a whole one."""
    skipped = sum(WITHOUT_RECORDINGS in str(report.longrepr) for report in terminalreporter.stats.get("skipped", ()))
    if skipped:
        terminalreporter.write_line(
            f"{skipped} tests skipped: {WITHOUT_RECORDINGS}; set PLANVIEW_TEST_DATA to run them", yellow=True
        )
