"""Counting while tracks arrive, and the page."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_tracks import positions_table

from planview.counting.events import Event
from planview.counting.rules import AnalyticsParams, RulePlane, load_rules, parse_rules
from planview.counting.stream import Analytics
from planview.counting.totals import Counts, count_tracks, count_truth
from planview.trajectories.clock import Clock
from planview.trajectories.state import State, TrackState
from planview.trajectories.table import Trajectories

WIRE = {"name": "door", "from_m": [0, 0], "to_m": [2, 0]}  # from left to right: its left side is y > 0
ZONE = {"name": "room", "polygon_m": [[0, 0], [4, 0], [4, 4], [0, 4]]}
Row = tuple[int, int, float, float, State]


def analytics(**params: float) -> Analytics:
    return Analytics(parse_rules({"tripwire": [WIRE], "zone": [ZONE]}, RulePlane(), "r"), AnalyticsParams(**params))


def feed(counter: Analytics, rows: Sequence[Row]) -> list[Event]:
    """Rows of frame, id, x, y, state."""
    events = []
    for frame in sorted({row[0] for row in rows}):
        tracks = [TrackState(i, state, x, y) for f, i, x, y, state in rows if f == frame]
        events += counter.update(frame, frame / 10, tracks)
    return events


def way(ys: Sequence[float], track_id: int = 1, x: float = 1.0, start: int = 0, state: State = "confirmed"):
    return [(start + i, track_id, x, float(y), state) for i, y in enumerate(ys)]


def crossings(rows: Sequence[Row], **params: float) -> list[tuple[int, str]]:
    return [(e.track_id, e.direction) for e in feed(analytics(**params), rows) if e.kind == "crossing"]


DOWN = np.linspace(1, -1, 21)
STAYS = [1.0, 0.9, 0.8, 0.7, 0.6, 0.5, -0.8, -0.9, -1.0, -1.0, -1.0, -1.0]
AROUND = [(i, 1, x, y, "confirmed") for i, (x, y) in enumerate([(3, 1), (3, 0.5), (3, -0.5), (2, -1), (1, -1)])]
RIGHT, LEFT = "left_to_right", "right_to_left"
WAYS: dict[str, tuple[list[Row], list[tuple[int, str]]]] = {
    "over the line": (way(DOWN), [(1, RIGHT)]),
    "over the line the other way": (way(DOWN[::-1]), [(1, LEFT)]),
    "flicker on the line": (way([1.0, 0.5] + [0.2, -0.2] * 20 + [0.5, 1.0]), []),
    "crossing after hesitation": (way([1.0, 0.5] + [0.2, -0.2] * 20 + [-0.5, -1.0]), [(1, RIGHT)]),
    "put back in a jump": (way([1.0, 0.8, 0.5, 0.1, -0.3, -0.5, 1.0, 0.8, 0.5, 0.1, -0.3, -0.6, -1.0]), [(1, RIGHT)]),
    "jump, and stayed beyond": (way(STAYS), [(1, RIGHT)]),
    "jump, not yet stayed": (way(STAYS[:11]), []),
    "back soon": (way([0.6, 0.3, 0.0, -0.3, -0.5, -0.3, 0.0, 0.3, 0.6]), [(1, RIGHT), (1, LEFT)]),
    "short-lived track": (way([0.5, 0.1, -0.5]), []),
    "young track that gets old enough": (way([0.5, 0.1, -0.5, -0.6, -0.7, -0.8]), [(1, RIGHT)]),
    "never confirmed": (way(DOWN, state="tentative"), []),
    "confirmed later": ([*way(DOWN[:15], state="tentative"), *way(DOWN[15:], start=15)], [(1, RIGHT)]),
    "confirmed later under an id": (
        [*way(DOWN[:15], track_id=-4, state="tentative"), *way(DOWN[15:], track_id=3, start=15)], [(3, RIGHT)],
    ),
    "past the end of the line": (way(DOWN, x=2.1), []),
    "round the end and back over it": ([*AROUND, *way(DOWN[::-1], start=5)], [(1, LEFT)]),
    "prediction": ([*way(DOWN[:8]), *way(DOWN[8:], start=8, state="lost")], []),
    "lost before and found after": (
        [*way(DOWN[:8]), *way(DOWN[8:14], start=8, state="lost"), *way(DOWN[14:], start=14)], [(1, RIGHT)],
    ),
    "new id beyond the line": ([*way(DOWN[:8]), *way(DOWN[14:], track_id=2, start=14)], [(2, RIGHT)]),
    "new id on the line": (
        [*way(DOWN[:15]), *way([0.1, -0.1, -0.3, -0.5, -0.7, -0.9], track_id=2, start=17)], [(1, RIGHT)],
    ),
    "another person the same way": ([*way(DOWN), *way(DOWN, track_id=2, start=25)], [(1, RIGHT), (2, RIGHT)]),
    "old id back after a new one took over": (
        [*way(DOWN[:8]), *way(DOWN[10:], track_id=2, start=10), *way(np.full(8, 1.0), start=14)], [(2, RIGHT)],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WAYS)
def test_crossings_of_a_line(name):
    rows, expected = WAYS[name]
    assert crossings(rows) == expected


def test_age_from_which_a_track_counts_is_a_parameter():
    assert crossings(way([0.5, 0.1, -0.5]), min_age_s=0.2) == [(1, RIGHT)]


@pytest.mark.parametrize(
    ("rows", "frame", "timestamp_s"),
    [
        (way([1.0, 0.6, 0.1, -0.3, -0.7, -1.0]), 3, 0.2 + 0.1 * 0.25),
        ([row for row in way(DOWN) if not 5 < row[0] < 16], 10, 1.0),
        (way([1.0, 0.9, 0.8, -1.5, 0.7, 0.5, 0.1, -0.3, -0.6]), 7, 0.6 + 0.1 * 0.25),
    ],
    ids=["between frames", "inside a gap", "after one frame that was wrong, as when a low camera sees the head only"],
)
def test_crossing_is_dated_to_the_line(rows, frame, timestamp_s):
    (event,) = (e for e in feed(analytics(), rows) if e.kind == "crossing")
    assert (event.frame, event.direction) == (frame, RIGHT)
    assert event.timestamp_s == pytest.approx(timestamp_s)


def test_stay_is_dated_to_the_outline():
    events = [e for e in feed(analytics(), way(np.linspace(-1, 5, 61), x=2.0)) if e.rule == "room"]
    assert [(e.kind, round(e.timestamp_s, 3)) for e in events] == [("entry", 1.0), ("exit", 5.0)]


def test_brushing_along_the_outline_enters_nothing():
    assert [e for e in feed(analytics(), way([-1.0, *[0.1, -0.1] * 20, -1.0], x=3.0)) if e.rule == "room"] == []


def test_memory_is_released_when_people_are_gone():
    counter = analytics()
    for k in range(50):
        feed(counter, way(DOWN, track_id=k + 1, start=50 * k))
    assert len(counter._of_id) <= 2


def totals(rows: Sequence[Row], rules: dict[str, Any], **params: float) -> tuple[Counts, dict[str, Any]]:
    data = np.array([[f, i, x, y] for f, i, x, y, _ in sorted(rows)])
    frame = data[:, 0].astype(np.int64)
    table = positions_table(frame, data[:, 1].astype(np.int64), data[:, 2:], timestamp_s=frame / 10)
    counts = count_tracks(table, parse_rules(rules, RulePlane(), "r"), AnalyticsParams(**params))
    return counts, counts.to_json()["rules"]


def test_zone_totals_follow_the_stays():
    rows = [*way(np.linspace(-1, 5, 61), x=2.0), *way(np.full(100, 2.0), track_id=2, x=3.0)]
    _, rules = totals(rows, {"zone": [ZONE]})
    room = rules["room"]
    assert (room["entries"], room["exits"], room["stays"], room["max_occupancy"]) == (1, 1, 2, 2)
    assert (room["appeared_inside"], room["vanished_inside"]) == (1, 1)
    assert room["mean_occupancy"] == pytest.approx((4.0 + 10.0) / 10.0)
    assert room["mean_dwell_s"] == pytest.approx(7.0)


def test_occupancy_over_time_follows_the_stays():
    counts, _ = totals(way(np.linspace(-1, 5, 61), x=2.0), {"zone": [ZONE]})
    np.testing.assert_array_equal(counts.occupancy("room", np.array([0.5, 1.5, 4.9, 5.1])), [0, 1, 1, 0])


def test_truth_counts_at_once_but_not_steps_back_within_the_hysteresis():
    rules = parse_rules({"tripwire": [WIRE]}, RulePlane(), "r")
    y = np.array([0.5, -0.15, 0.08, -0.5])
    frame = np.arange(4)
    truth = positions_table(frame, np.ones(4, np.int64), np.column_stack([np.ones(4), y]))
    clock = Clock(positions_table(frame, frame, np.zeros((4, 2)), timestamp_s=frame / 10), 30.0)
    (event,) = count_truth(truth, rules, clock).events
    assert event.direction == "left_to_right"
    assert event.timestamp_s == pytest.approx(0.2 + 0.1 * 0.08 / 0.58)


def test_tracks_are_a_short_table_in_a_notebook():
    tracks = positions_table(np.arange(9), np.ones(9, np.int64), np.zeros((9, 2)))
    assert tracks._repr_html_().count("<tr>") == 5
    assert len(repr(tracks)) <= 200


@pytest.mark.parametrize(("inward", "found"), [("left_to_right", (4, 0)), ("right_to_left", (0, 4)), (None, None)])
def test_totals_per_interval_add_up(inward, found):
    rows = [row for k in range(4) for row in way(DOWN, track_id=k + 1, start=30 * k)]
    counts, rules = totals(rows, {"tripwire": [WIRE | ({"inward": inward} if inward else {})]}, interval_s=5.0)
    door = rules["door"]
    assert door["left_to_right"] == 4
    assert [part["left_to_right"] for part in door["intervals"]] == [2, 1, 1]
    assert counts.span.duration_s == pytest.approx(11.1)
    if inward:
        assert (door["in"], door["out"]) == found
        assert tuple(sum(part[way] for part in door["intervals"]) for way in ("in", "out")) == found


def test_queue_counts_people_who_wait():
    passer = way(np.linspace(-1, 5, 31), x=1.0, track_id=1)
    waiter = way([*np.linspace(-1, 2, 16), *np.full(80, 2.0), *np.linspace(2, 5, 16)], x=3.0, track_id=2)
    queue = {"name": "till", "zone": "room", "min_wait_s": 3.0}
    _, rules = totals([*passer, *waiter], {"zone": [ZONE], "queue": [queue]})
    till = rules["till"]
    assert (till["waited"], till["served"], till["max_length"]) == (1, 1, 1)
    assert till["mean_wait_s"] == pytest.approx(10.0, abs=0.3)


def test_lines_in_pixels_are_crossed_by_the_foot_of_the_box():
    rules = parse_rules({"tripwire": [{"name": "w", "from_px": [0, 100], "to_px": [200, 100]}]}, RulePlane(), "r")

    def events(bottoms):
        counter = Analytics(rules, AnalyticsParams(hysteresis_m=0.25, min_age_s=0.0))
        found = []
        for i, bottom in enumerate(bottoms):
            track = TrackState(1, "confirmed", box_px=(90.0, bottom - 170.0, 20.0, 170.0))  # 100 px per metre
            found += [e.direction for e in counter.update(i, i / 10, [track])]
        return found

    assert events([60, 80, 110, 120]) == []
    assert events([60, 80, 110, 130]) == ["left_to_right"]  # down the image: from the left of a line to the right
    assert events([130, 80, 60]) == ["right_to_left"]


def test_person_who_walks_over_the_line_three_times_is_one_person_per_visit():
    counter = analytics()
    there_and_back = np.concatenate([DOWN, DOWN[::-1], DOWN])
    later = way(DOWN, start=len(there_and_back) + 60)
    elsewhere = way([9.0] * 200, track_id=2, x=50.0)
    events = feed(counter, way(there_and_back) + later + elsewhere)
    assert sum(event.kind == "crossing" for event in events) == 4
    assert counter.people["door"] == 2


def room(rows: Sequence[Row], queue_s: float = 5.0) -> dict[str, Any]:
    """The zone of a table, and how many waited in it."""
    queue = {"name": "till", "zone": "room", "min_wait_s": queue_s}
    _, rules = totals(rows, {"zone": [ZONE], "queue": [queue]})
    return rules["room"] | {"waited": rules["till"]["waited"]}


def test_a_stay_ends_with_the_track():
    found = room([*way(np.full(40, 2.0)), *way(np.full(40, 2.0), start=600)])
    assert (found["stays"], found["people"], found["waited"]) == (2, 2, 0)
    assert found["max_dwell_s"] == pytest.approx(4.0)
    assert found["mean_occupancy"] == pytest.approx(8.0 / 64.0)


def test_a_stay_goes_on_while_somebody_is_hidden_for_less():
    found = room([*way(np.full(40, 2.0)), *way(np.full(40, 2.0), start=70)])
    assert (found["stays"], found["waited"]) == (1, 1)


def test_an_id_that_is_suddenly_elsewhere_crosses_nothing():
    assert crossings([*way(np.full(10, 3.0)), *way(np.full(10, -3.0), start=10)]) == []


def test_one_frame_far_away_does_not_end_a_visit():
    found = room([*way(np.full(10, 2.0)), (10, 1, 1.0, 9.0, "confirmed"), *way(np.full(10, 2.0), start=11)])
    assert (found["stays"], found["people"]) == (1, 1)


PAGE = Path(__file__).resolve().parents[4] / "docs" / "counting.md"
METRES, PIXELS = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def rows_of(xy_m: np.ndarray | None = None, box_px: np.ndarray | None = None) -> Trajectories:
    """Forty frames of one person."""
    frame, xy_m = np.arange(40), np.full((40, 2), np.nan) if xy_m is None else xy_m
    return positions_table(frame, np.ones(40, np.int64), xy_m, None, 0.1 * frame, box_px)


STEPS = np.arange(40.0)
TOWARDS = rows_of(xy_m=np.column_stack([0 * STEPS, 5.0 - 0.1 * STEPS]))
UP = rows_of(box_px=np.column_stack([0 * STEPS + 300, 350 - 6 * STEPS, 0 * STEPS + 30, 0 * STEPS + 60]))


@pytest.mark.parametrize(("page", "rule", "tracks"), [(METRES, "door", TOWARDS), (PIXELS, "platform edge", UP)])
def test_rules_of_the_page_count_who_comes_in(tmp_path, page, rule, tracks):
    (tmp_path / "rules.toml").write_text(page)
    counted = count_tracks(tracks, load_rules(tmp_path / "rules.toml")).to_json()["rules"][rule]
    assert (counted["in"], counted["out"]) == (1, 0)
