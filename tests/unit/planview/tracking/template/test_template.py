"""Harville's tracker."""

import math
from dataclasses import replace

import numpy as np
import pytest

from planview.maps.grid import Grid
from planview.maps.plan_view import FloorPoints, PlanViewMaps
from planview.maps.view import View
from planview.tracking.base import Observation
from planview.tracking.template import TemplateParams, TemplateTracker
from planview.tracking.template.tracker import mean_differences
from planview.trajectories.state import TrackState

GRID = Grid(-3.0, -3.0, 0.1, 60, 60)
NO_POINTS = FloorPoints(np.empty((0, 3), np.float32), np.empty(0, np.float32), np.empty(0, np.int32))
PACE_M = 0.1

Block = tuple[float, float, float] | tuple[float, float, float, float]
"""x, y, height [m], and surface of all cells together [m^2], 0.25 where it is left out."""


def observe(frame: int, people: list[Block], fps: float = 10.0) -> Observation:
    """The centre cell of a block has 1.5 times the surface of the others, and is the head."""
    height, occupancy = np.zeros(GRID.shape, np.float32), np.zeros(GRID.shape, np.float32)
    for x, y, tall, *area in people:
        row, col = (round(i) for i in GRID.index_of(x, y))
        body = slice(max(0, row - 2), row + 3), slice(max(0, col - 2), col + 3)
        height[body] = max(tall - 0.3, 0.1)
        occupancy[body] += np.float32((area[0] if area else 0.25) / 25.5)
        height[row, col] = tall
        occupancy[row, col] *= 1.5
    maps = PlanViewMaps(GRID, height, occupancy, height, occupancy, 0.002, NO_POINTS)
    return Observation(frame, frame / fps, build_maps=lambda: maps)


def follow(tracker: TemplateTracker, frames: list[list[Block]], start: int = 0) -> list[tuple[TrackState, ...]]:
    return [tracker.update(observe(start + i, people)) for i, people in enumerate(frames)]


def walk(x_m: float, y_m: float, n: int, height_m: float = 1.75, step_m: float = PACE_M) -> list[list[Block]]:
    """One person who takes n steps along x, on the centres of cells."""
    return [[(x_m + i * step_m, y_m, height_m)] for i in range(n)]


def kinds(tracker: TemplateTracker) -> list[str]:
    return [decision.kind for decision in tracker.decisions]


def test_newcomer_is_tentative_until_followed_for_a_while():
    tracker = TemplateTracker(TemplateParams(confirm_s=0.4))
    for _ in range(2):
        results = follow(tracker, walk(-0.95, 0.05, 6))
        assert [(t.track_id, t.state) for (t,) in results] == [(-1, "tentative")] * 4 + [(1, "confirmed")] * 2
        tracker.reset()  # ids start again


def test_newcomer_is_dropped_at_the_first_miss():
    tracker = TemplateTracker()
    assert follow(tracker, [*walk(0.05, 0.05, 1), []])[-1] == () and kinds(tracker) == ["pruned"]


@pytest.mark.parametrize("thing", [(0.05, 0.05, 1.1), (0.05, 0.05, 1.75, 0.04)], ids=["chair", "hand"])
def test_what_is_too_low_or_too_small_is_no_newcomer(thing):
    assert follow(TemplateTracker(), [[thing]] * 10)[-1] == ()


def test_place_of_somebody_who_stands_is_exact():
    (track,) = follow(TemplateTracker(), [[(0.05, 0.35, 1.8)]] * 10)[-1]
    assert (track.x_m, track.y_m, track.height_m) == pytest.approx((0.05, 0.35, 1.8), abs=1e-3)


def test_velocity_is_that_of_the_walker():
    frames = follow(TemplateTracker(), walk(-1.95, 0.05, 25))
    (track,) = frames[-1]
    assert (track.x_m, track.vx_mps, track.vy_mps) == pytest.approx((0.45, 1.0, 0.0), abs=0.05)
    assert all(len(tracks) == 1 for tracks in frames)  # what is found of a person is cleared


def test_walkers_who_pass_each_other_keep_their_ids():
    frames = [a + b for a, b in zip(walk(-1.45, -0.35, 30, 1.6), walk(1.45, 0.35, 30, 1.9, -PACE_M), strict=True)]
    results = follow(TemplateTracker(), frames)
    heights = [{track.track_id: round(track.height_m, 1) for track in results[i]} for i in (5, -1)]
    assert heights[0] == heights[1] and sorted(heights[0].values()) == [1.6, 1.9]


def test_lost_person_is_predicted_for_four_seconds():
    tracker = TemplateTracker()
    seen = follow(tracker, walk(-0.95, 0.05, 10))[-1][0]
    (lost,), *_, last, after = follow(tracker, [[]] * 41, start=10)[4:]
    assert lost.state == "lost" and lost.x_m == pytest.approx(seen.x_m + 0.5 * seen.vx_mps, abs=1e-6)
    assert (len(last), len(after), kinds(tracker)) == (1, 0, ["pruned"])


@pytest.mark.parametrize(
    ("y_m", "states", "decisions"),
    [(1.85, {1: "confirmed"}, ["reacquired"]), (2.25, {1: "lost", -2: "tentative"}, ["spawned"])],
)
def test_newcomer_within_reach_of_a_lost_person_is_that_person(y_m, states, decisions):
    tracker = TemplateTracker()
    follow(tracker, [*walk(0.05, 0.05, 10, step_m=0.0), *[[]] * 5])
    tracks = follow(tracker, [[(0.05, y_m, 1.75)]], start=15)[0]
    assert {track.track_id: track.state for track in tracks} == states and kinds(tracker) == decisions


def test_frames_that_show_nothing_end_nobody():
    tracker, states = TemplateTracker(TemplateParams(lost_s=0.5)), []
    for n, people in enumerate(walk(-1.95, 0.05, 30)):
        seen = observe(n, people) if not 12 <= n < 20 else replace(observe(n, []), views=(View.unknown((1, 1)),))
        states.append([(track.track_id, track.state) for track in tracker.update(seen)])
    assert states[11] == states[-1] == [(1, "confirmed")] and states[12:20] == [[(1, "lost")]] * 8


def test_template_that_holds_little_of_its_person_is_recentred_on_the_occupancy_peak():
    """A template of 81 cells with 25 filled counts as slipped: the peak is the head of a block a cell away."""
    tracker = TemplateTracker(TemplateParams(recentre_filled=0.5))
    follow(tracker, [[(0.05, 0.05, 1.75)]])
    (track,) = tracker.update(observe(1, [(0.15, 0.05, 1.75)]))
    assert (track.x_m, track.y_m) == pytest.approx((0.15, 0.05), abs=1e-9) and "recentred" in kinds(tracker)


def test_recentring_leaves_the_velocity():
    still, moved = TemplateTracker(TemplateParams(recentre_filled=0.0)), TemplateTracker()
    for tracker in (still, moved):
        follow(tracker, walk(-0.95, 0.05, 8))
    moved.params = TemplateParams(recentre_filled=0.5)
    one, other = (tracker.update(observe(8, [(-0.05, 0.05, 1.75)]))[0] for tracker in (still, moved))
    assert "recentred" in kinds(moved) and one.x_m != other.x_m
    assert (one.vx_mps, one.vy_mps) == (other.vx_mps, other.vy_mps)


def test_templates_follow_who_sits_down():
    heights = [*np.linspace(1.75, 1.25, 10).tolist(), *[1.25] * 10]
    (track,) = follow(TemplateTracker(), [[(0.05, 0.05, height)] for height in heights])[-1]
    assert track.height_m == pytest.approx(1.25, abs=0.01)


def test_score_is_the_sum_of_its_terms():
    tracker = TemplateTracker()
    follow(tracker, walk(-0.95, 0.05, 3))
    (matched,) = tracker.decisions
    assert sum(matched.terms) == pytest.approx(matched.value)


@pytest.mark.parametrize("without", ["height", "occupancy"])
def test_weight_of_zero_leaves_a_statistic_out(without):
    tracker = TemplateTracker(TemplateParams(**{f"{without}_weight": 0.0}))
    follow(tracker, walk(-0.95, 0.05, 3))
    assert getattr(tracker.decisions[0].terms, without) == 0.0


def test_debug_shows_what_was_searched():
    tracker = TemplateTracker()
    follow(tracker, walk(0.05, 0.05, 3))
    debug = tracker.debug()
    assert [drawing.name for drawing in debug.drawings] == ["search", "template"]
    assert {name: tile.shape for name, tile in debug.tiles.items()} == dict.fromkeys(
        ("template/-1/height", "template/-1/occupancy"), (9, 9)
    )


def test_person_at_the_edge_of_the_floor_is_followed():
    (track,) = follow(TemplateTracker(), [[(-2.95, 2.95, 1.75, 0.5)]] * 6)[-1]
    assert track.state == "confirmed" and math.dist((track.x_m, track.y_m), (-2.95, 2.95)) < 0.3


def test_observation_without_maps_is_refused():
    with pytest.raises(ValueError, match="plan-view maps"):
        TemplateTracker().update(Observation(0, 0.0))


def test_time_that_runs_backwards_is_refused():
    tracker = TemplateTracker()
    follow(tracker, walk(0.05, 0.05, 1), start=5)
    with pytest.raises(ValueError, match="time to advance"):
        tracker.update(observe(2, []))


def test_difference_counts_one_sided_cells_as_h_max_thirds():
    template = np.array([[1.5, 0.0], [1.0, 0.0]], np.float32)
    seen = np.array([[1.7, 0.9], [0.0, 0.0]], np.float32)
    height, occupancy = mean_differences(template, template, seen, seen, 0.8)
    assert height[0, 0] == pytest.approx((0.2 + 0.8 + 0.8) / 3, abs=1e-6)
    assert occupancy[0, 0] == pytest.approx((0.2 + 0.9 + 1.0) / 3, abs=1e-6)


def test_difference_is_none_where_the_template_was_moved():
    rng = np.random.default_rng(1)
    template = np.where(rng.random((5, 5)) < 0.5, rng.uniform(0.1, 2.0, (5, 5)), 0.0).astype(np.float32)
    height = np.zeros((20, 20), np.float32)
    height[8:13, 6:11] = template
    apart, _ = mean_differences(template, template, height, height, 0.8)
    assert apart.shape == (16, 16) and apart[8, 6] == pytest.approx(0.0, abs=1e-6) and (apart > 0.0).sum() == 255


def test_difference_of_empty_floors_is_the_largest():
    nothing = np.zeros((5, 5), np.float32)
    assert mean_differences(nothing, nothing, nothing, nothing, 0.8) == (0.8, 0.0)
