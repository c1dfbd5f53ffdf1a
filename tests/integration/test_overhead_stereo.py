"""The real overhead pair, with no configuration at all: sun, saturation, moving shadows, and two walkers."""

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from calib.types import F64
from planview.engine.engine import Engine
from planview.engine.open import open_engine
from planview.trajectories.state import TrackState

MIDDLE_CROSSED_AT = (67, 242)
"""Frames near which a walker's head crosses the middle of the image (README of the data)."""


@dataclass(frozen=True, eq=False)
class Walker:
    """Confirmed rows of one id: frames, seconds, heights [m], columns of the head as a share of the image's width."""

    frame: F64
    seconds: F64
    height_m: F64
    column: F64

    @property
    def lasts_s(self) -> float:
        return float(self.seconds[-1] - self.seconds[0])

    @property
    def crossing(self) -> float:
        """Frame in which the head crosses the image's middle."""
        change = np.flatnonzero(np.diff(np.sign(self.column - 0.5)))
        assert len(change) == 1, f"expected one crossing of the middle, found {len(change)}"
        return float(self.frame[change[0] + 1])


@pytest.fixture(scope="module")
def walkers(shared_data: Path) -> list[Walker]:
    """Confirmed ids in the order of their appearance."""
    engine = open_engine(shared_data / "overhead-stereo")
    rows: dict[int, list[tuple[float, ...]]] = defaultdict(list)
    for result in engine:
        for track in result.tracks:
            if track.state == "confirmed":
                where = head_column(engine, track)
                rows[track.track_id].append((result.frame, result.timestamp_s, track.height_m, where))
    return [Walker(*np.array(rows[i]).T) for i in sorted(rows)]


def head_column(engine: Engine, track: TrackState) -> float:
    geometry, pose = engine.stereo.geometry, engine.stereo.floor.world_SE3_left
    u, _ = geometry.project(pose.inverse() @ np.array([track.x_m, track.y_m, track.height_m]))
    return float(u / geometry.width)


def lasting(walkers: list[Walker]) -> list[Walker]:
    return [walker for walker in walkers if walker.lasts_s > 1.0]


def test_both_walkers_are_found_once_and_nobody_else_for_a_second(walkers: list[Walker]) -> None:
    assert len(lasting(walkers)) == 2


def test_walkers_are_as_tall_as_people(walkers: list[Walker]) -> None:
    for walker in lasting(walkers):
        inside = np.abs(walker.column - 0.5) < 0.3
        assert 1.5 <= np.median(walker.height_m[inside]) <= 1.9


def test_walkers_cross_the_middle_when_they_did(walkers: list[Walker]) -> None:
    crossings = [walker.crossing for walker in lasting(walkers)]
    assert crossings == pytest.approx(MIDDLE_CROSSED_AT, abs=10)


def test_walkers_go_the_ways_they_went(walkers: list[Walker]) -> None:
    first, second = lasting(walkers)
    assert first.column[0] > 0.5 > first.column[-1]
    assert second.column[0] < 0.5 < second.column[-1]


def test_walkers_are_followed_for_as_long_as_they_are_well_inside(walkers: list[Walker]) -> None:
    for walker in lasting(walkers):
        assert walker.column.min() < 0.3 and walker.column.max() > 0.7
        assert np.diff(walker.frame).max() <= 5
