"""The real overhead pair, with no configuration at all: sun, saturation, moving shadows, and two walkers."""

from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from planview.engine.open import open_engine

MIDDLE_CROSSED_AT = (67, 242)
"""Frames near which a walker's head crosses the middle of the image (README of the data)."""


@pytest.mark.slow
def test_two_walkers_are_followed_through_the_middle_as_they_went(shared_data: Path) -> None:
    engine = open_engine(shared_data / "overhead-stereo")
    geometry, pose = engine.stereo.geometry, engine.stereo.floor.world_SE3_left
    rows: dict[int, list[tuple[float, ...]]] = defaultdict(list)
    for result in engine:
        for track in (t for t in result.tracks if t.state == "confirmed"):
            u, _ = geometry.project(pose.inverse() @ np.array([track.x_m, track.y_m, track.height_m]))
            rows[track.track_id].append((result.frame, result.timestamp_s, track.height_m, u / geometry.width))
    found = [np.array(rows[i]).T for i in sorted(rows)]
    lasting = [walker for walker in found if walker[1, -1] - walker[1, 0] > 1.0]
    assert len(lasting) == 2
    for (frame, _, height_m, column), crossed_at, way in zip(lasting, MIDDLE_CROSSED_AT, (-1, 1), strict=True):
        assert 1.5 <= np.median(height_m[np.abs(column - 0.5) < 0.3]) <= 1.9
        (crossing,) = np.flatnonzero(np.diff(np.sign(column - 0.5)))
        assert frame[crossing + 1] == pytest.approx(crossed_at, abs=10)
        assert np.sign(column[-1] - 0.5) == np.sign(0.5 - column[0]) == way
        # Followed for as long as they are well inside.
        assert column.min() < 0.3 and column.max() > 0.7 and np.diff(frame).max() <= 5
