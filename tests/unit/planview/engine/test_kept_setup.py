"""What a run found out about a recording, kept for the next one."""

import math
from pathlib import Path

import numpy as np
import pytest
from toy_stereo import toy_rig

from calib.rig import Floor, world_from_plane
from planview.checks.check import Check
from planview.engine.config import Config
from planview.engine.kept_setup import KeptSetup
from planview.engine.setup import Setup
from stereo.matcher import disparity_range
from stereo.rectify import Rectifier
from stereo.row_offset import VerticalFit, VerticalModel

CHECKS = Check("rows", True, math.nan), Check("floor", True, 1 / 3, "m", (0.1, math.inf), "between", "in view")


@pytest.fixture
def setup() -> Setup:
    model = VerticalModel(0.1, 1e-3 / 3, 0.0)
    rectifier = Rectifier(toy_rig(), None, model)
    floor = Floor(world_from_plane(np.array([0.0, -0.6, -0.8]), 2.7), 0.7, 0.01, np.eye(3) / 7)
    searched = disparity_range(rectifier.geometry, None, floor)
    return Setup(rectifier, floor, searched, "found", VerticalFit(model, before_px=0.2), checks=CHECKS)


def test_a_kept_setup_is_the_same_bit_for_bit(setup: Setup, tmp_path: Path) -> None:
    kept = KeptSetup("key", tmp_path / "setups")
    kept.save(setup)
    found = kept.load(toy_rig(), Config())
    assert found is not None
    np.testing.assert_array_equal(found.floor.world_SE3_left.matrix, setup.floor.world_SE3_left.matrix)
    np.testing.assert_array_equal(found.floor.covariance, setup.floor.covariance)
    assert (found.disparities, found.floor_source) == (setup.disparities, "found")
    assert found.rectifier.vertical == setup.rectifier.vertical
    assert repr(found.checks) == repr(CHECKS)


@pytest.mark.parametrize("content", [None, b"", b"{}", b"\xff"])
def test_what_is_not_kept_or_damaged_is_found_again(content: bytes | None, tmp_path: Path) -> None:
    kept = KeptSetup("key", tmp_path)
    if content is not None:
        kept.path.write_bytes(content)
    assert kept.load(toy_rig(), Config()) is None


def test_a_cache_that_cannot_be_written_is_no_failure(setup: Setup, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    kept = KeptSetup("key", tmp_path / "file" / "setups")
    kept.save(setup)
    assert kept.load(toy_rig(), Config()) is None
