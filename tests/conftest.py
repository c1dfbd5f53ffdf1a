"""Shared fixtures: where the real recordings are; and what was skipped without them."""

import os
from pathlib import Path

import pytest

WITHOUT_RECORDINGS = "real recordings are not here"
"""Begins the reason of every skip for that."""


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real recordings ($PLANVIEW_TEST_DATA, else ../shared/data beside the repository)."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("PLANVIEW_TEST_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"{WITHOUT_RECORDINGS} ({folder}); set PLANVIEW_TEST_DATA to run this test")
    return folder


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many tests the missing recordings cost: a run without them must not pass for a whole one."""
    skipped = sum(WITHOUT_RECORDINGS in str(report.longrepr) for report in terminalreporter.stats.get("skipped", ()))
    if skipped:
        terminalreporter.write_line(
            f"{skipped} tests skipped: {WITHOUT_RECORDINGS}; set PLANVIEW_TEST_DATA to run them", yellow=True
        )
