"""Counts of a table, whose rows are located in blocks of frames, are those of a live run, frame by frame."""

import numpy as np
import pytest

from planview.counting.events import Event
from planview.counting.geometry import RulePlane
from planview.counting.rules import AnalyticsParams, Rules, parse_rules
from planview.counting.stream import Analytics
from planview.counting.totals import Clock, count_tracks
from planview.trajectories.table import Trajectories, row_state

People = dict[str, int]
Stays = dict[str, list[str]]
RULES = {
    "tripwire": [{"name": "door", "from_m": [-1, 0], "to_m": [1, 0]}],
    "zone": [{"name": "room", "polygon_m": [[-1, -1], [1, -1], [1, 1], [-1, 1]]}],
}


def wild_tracks(seed: int) -> Trajectories:
    """People near a door who are lost, hidden, exchanged and given new ids all the time."""
    rng = np.random.default_rng(seed)
    rows = []
    for person in range(4):
        place, track_id, away = rng.uniform(-1.5, 1.5, 2), person + 1, 0
        for frame in range(int(rng.integers(0, 20)), 1100):
            place = np.clip(place + rng.normal(0, 0.12, 2), -1.6, 1.6)
            away = max(0, away - 1) if rng.random() > 0.03 else int(rng.integers(1, 40))
            if rng.random() < 0.01:
                track_id = int(rng.integers(1, 30))
            state = rng.choice(["confirmed", "lost", "tentative"], p=[0.9, 0.07, 0.03])
            if not away and all(row[:2] != (frame, track_id) for row in rows[-2000:]):
                rows.append((frame, track_id, *place, state))
    rows.sort(key=lambda row: row[:2])
    frame, ids, x, y, state = zip(*rows, strict=True)
    n = len(rows)
    return Trajectories(
        np.array(frame), np.array(ids), np.array(frame) / 10, np.array(x), np.array(y), np.full(n, 1.7),
        np.array(state), np.ones(n), np.full((n, 4), np.nan), np.full((n, 2), np.nan),
    )  # fmt: skip


def every_frame(tracks: Trajectories, rules: Rules, params: AnalyticsParams) -> tuple[list[Event], Stays, People]:
    counter, events = Analytics(rules, params), []
    for frame in np.unique(tracks.frame).tolist():
        rows = np.flatnonzero(tracks.frame == frame).tolist()
        events += counter.update(frame, frame / 10, [row_state(tracks, row) for row in rows])
    stays = {name: sorted(map(str, map(vars, stays))) for name, stays in counter.stays.items()}
    return sorted(events, key=str), stays, counter.people


@pytest.mark.parametrize("seed", range(2))
def test_counts_of_a_table_are_those_of_every_frame(seed: int) -> None:
    tracks, params = wild_tracks(seed), AnalyticsParams(min_age_s=0.3)
    rules = parse_rules(RULES, RulePlane(), "r")
    counts = count_tracks(tracks, rules, params, clock=Clock(tracks, 10.0))
    events, stays, people = every_frame(tracks, rules, params)
    assert len(events) > 5
    assert sorted(counts.events, key=str) == events
    assert counts.people == people
    assert {name: sorted(map(str, map(vars, stays))) for name, stays in counts.stays.items()} == stays
