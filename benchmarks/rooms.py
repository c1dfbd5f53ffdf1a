"""Occupancy of drawn conference rooms: other cameras, clothes and seats than in the committed one."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.counting import CountingTable, OccupancyRow, Scorer
from planview.counting.geometry import RulePlane
from planview.counting.rules import Rules, parse_rules
from planview.counting.scoring import OccupancyGroup
from planview.synthetic.random_scenes.conference import random_conference

ROOM_RIGHT_MIN_PERCENT = {"0": 98.0, "1-2": 98.0, "3-5": 97.0, "6-9": 95.0, "10+": 88.0}
"""Time with the right occupancy by true number that drawn rooms together must reach."""


def score_room(seed: int, scorer: Scorer) -> CountingTable:
    """Score the number of people in the conference room of a seed."""
    drawn, name = random_conference(seed), f"conference-{seed}"

    def rules_on(plane: RulePlane) -> Rules:
        zone = {"name": "room", "polygon_m": [list(corner) for corner in drawn.zone_m]}
        return parse_rules({"zone": [zone]}, plane, name)

    return scorer.score(drawn.scene, name, rules_on, ROOM_RIGHT_MIN_PERCENT)


def all_rooms(tables: Sequence[CountingTable]) -> CountingTable:
    """The rows of every room, and after several rooms one row for each range with the frames of all of them."""
    together = sum(tables, CountingTable((), ()))
    if len(tables) < 2:
        return together
    pooled = [_pooled(people, together.occupancy) for people in ROOM_RIGHT_MIN_PERCENT]
    return together + CountingTable((), tuple(row for row in pooled if row.group.frames))


def _pooled(people: str, rows: Sequence[OccupancyRow]) -> OccupancyRow:
    groups = [row.group for row in rows if row.group.people == people]
    frames = sum(group.frames for group in groups)

    def mean(values: Sequence[float | None]) -> float | None:
        weighted = [g.frames * value for g, value in zip(groups, values, strict=True) if value is not None]
        return sum(weighted) / frames if frames else None

    group = OccupancyGroup(
        people,
        frames,
        mean([g.right_percent for g in groups]),
        mean([g.mean_difference for g in groups]),
        mean([g.mean_absolute_difference for g in groups]),
    )
    return OccupancyRow("all rooms", "room", group, ROOM_RIGHT_MIN_PERCENT[people])
