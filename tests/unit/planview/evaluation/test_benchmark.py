"""The five qualities on tiny sequences."""

import math

import numpy as np
import pytest

from calib.errors import InputError
from planview.evaluation.benchmark import benchmark
from planview.trajectories.state import TrackState
from planview.trajectories.table import Trajectories, TrajectoryCollector


def table(*rows: tuple[int, int, float, float], state: str = "confirmed") -> Trajectories:
    """(frame, id, x, y) each."""
    gathered = TrajectoryCollector()
    frames: dict[int, list[TrackState]] = {}
    for frame, who, x, y in rows:
        frames.setdefault(frame, []).append(TrackState(who, state, x, y))  # type: ignore[arg-type]
    for frame in sorted(frames):
        gathered.add(frame, frame / 10, tuple(frames[frame]))
    return gathered.trajectories()


WALK = [(i, 1, -2.0 + 0.1 * i, 3.0) for i in range(41)]


def test_tracks_that_are_the_truth_have_the_best_of_everything() -> None:
    found = benchmark(table(*WALK), table(*WALK))
    assert (found.flux, found.density, found.position_m, found.trajectory_m, found.continuity) == (1, 1, 0, 0, 1)


def test_a_constant_offset_is_an_error_of_position_and_none_of_the_trajectory() -> None:
    found = benchmark(table(*[(f, i, x, y + 0.1) for f, i, x, y in WALK]), table(*WALK))
    assert found.position_m == pytest.approx(0.1) and found.trajectory_m == pytest.approx(0.0, abs=1e-9)


def test_a_person_missed_for_a_quarter_loses_density_and_continuity_and_no_flux() -> None:
    found = benchmark(table(*WALK[:41:2], *WALK[1:20:2]), table(*WALK))
    assert found.density == pytest.approx(31 / 41) and found.continuity == pytest.approx(31 / 41)
    assert found.flux == 1.0


def test_a_track_that_begins_anew_halves_the_continuity_and_loses_the_line_between() -> None:
    halves = [(f, 1 if f < 20 else 2, x, y) for f, _, x, y in WALK]
    found = benchmark(table(*halves), table(*WALK))
    assert found.continuity == pytest.approx(21 / 41) and found.density == 1.0
    assert found.flux == pytest.approx(2 / 3)  # of three lines along x, that in the middle


def test_false_tracks_count_against_flux_and_density() -> None:
    false = [(f, 2, x, y + 3.0) for f, _, x, y in WALK]
    found = benchmark(table(*WALK, *false), table(*WALK))
    assert (found.flux, found.density, found.continuity) == (0.0, 0.0, 1.0)


def test_people_who_sway_on_a_line_cross_nothing() -> None:
    sway = [(i, 1, 0.1 * math.sin(i), 3.0) for i in range(41)]
    assert math.isnan(benchmark(table(*sway), table(*sway)).flux)
    assert benchmark(table(*sway), table(*sway)).to_json()["flux"] is None


def test_without_positions_on_the_floor_it_is_refused() -> None:
    boxes = table(*[(f, i, np.nan, np.nan) for f, i, _, _ in WALK])
    with pytest.raises(InputError, match="tracks with floor positions"):
        benchmark(boxes, table(*WALK))
