"""Places of the scenes and the demo clip of the package, and of real recordings."""

from __future__ import annotations

import os
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
_PACKAGED = Path(__file__).resolve().parent / "scenes"
"""Folder of an installed package (``setup.py``)."""
SCENES = _PACKAGED if _PACKAGED.is_dir() else REPOSITORY / "data" / "synthetic"
"""The scenes of the package, one TOML each."""
DEMO = SCENES / "demo"
"""The demo clip."""


def real_recordings() -> Path:
    """Folder of real recordings, which may be missing: $PLANVIEW_TEST_DATA, else ../shared/data of the repository."""
    return Path(os.environ.get("PLANVIEW_TEST_DATA", REPOSITORY.parent / "shared" / "data"))
