"""A small challenge, and its recording, which is rendered once."""

from pathlib import Path

import pytest

from benchmarks.suite import suite_recording
from planview.synthetic.scene import Scene

CHALLENGE = """description = "one crosses"
covers = ["320x240"]
fps = 10
duration_s = 8
[camera]
width = 160
height = 120
lens_deg = 70
baseline_m = 0.3
[[choreography]]
kind = "cross"
start_s = 0.0
duration_s = 1
speed_mps = 1.5
"""


@pytest.fixture(scope="session")
def challenge(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("suite") / "tiny.toml"
    path.write_text(CHALLENGE)
    return path


@pytest.fixture(scope="session")
def recording(challenge: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Scene]:
    """Cache, folder and scene of seed 3."""
    cache = tmp_path_factory.mktemp("cache")
    return cache, *suite_recording(challenge, 3, cache)
