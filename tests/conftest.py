"""Shared fixtures: where the real recordings are."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real recordings ($PLANVIEW_TEST_DATA, else ../shared/data beside the repository)."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("PLANVIEW_TEST_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"real recordings are not here ({folder}); set PLANVIEW_TEST_DATA to run this test")
    return folder
