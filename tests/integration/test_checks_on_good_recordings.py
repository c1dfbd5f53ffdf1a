"""Recordings that can be trusted pass, the real pair and the committed clip."""

from pathlib import Path

import pytest

from planview.checks.examine import examine
from planview.synthetic.assets import DEMO


def failures(folder: Path) -> dict[str, float]:
    return {check.name: check.value for check in examine(folder).checks if not check.ok}


def test_check_passes_the_committed_clip() -> None:
    assert failures(DEMO) == {}


def test_check_passes_the_real_overhead_pair(shared_data: Path) -> None:
    diagnosis = examine(shared_data / "overhead-stereo")
    values = {check.name: check.value for check in diagnosis.checks}
    assert diagnosis.ok, [check for check in diagnosis.checks if not check.ok]
    assert values["row offset"] > 0.3 and values["row residual"] < 0.2
    assert values["camera height"] == pytest.approx(2.74, abs=0.05)
    assert 1.5 < values["person height"] < 1.9
