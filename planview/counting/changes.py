"""Rows of a table in which a count can change: people mostly go on as before, and need not be asked every frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from calib.types import F64, I8, I64, Bool
from planview.counting.people import VELOCITY_S
from planview.counting.places import Places


class Changes(NamedTuple):
    """Where counts can change: (N,) rows at which a person may change sides, (M,) frames in which anything happens."""

    rows: Bool
    frames: Bool


class SidedRule(Protocol):
    """A tripwire or a zone."""

    def sides(self, places: Places) -> I8:
        """(N,) side on which each row is; only a change of it, or a beginning or end, can change a count."""


def changes(frame: I64, moments_s: F64, places: Places, rules: Sequence[SidedRule]) -> Changes:
    """The rows and frames that ``Analytics`` must be given for the counts that it gives of all.

    A track that goes on from one frame to the next, in the same state and on the same side of every rule, changes
    nothing but its last sighting. So a row counts when its track begins, ends, or changes in it or in the next one; a
    frame counts that has such a row, or lies VELOCITY_S before the end of a stretch of sightings, since stitching
    predicts from these two.

    Args:
        frame: (N,) of the rows, sorted; ``places`` and the rules' sides refer to the same rows.
        moments_s: (M,) times of the M different frames [s]; where they run backwards, everything counts.
        rules: what may change sides.
    """
    number = np.cumsum(np.diff(frame, prepend=frame[:1]) > 0)
    if not len(frame) or (np.diff(moments_s) < 0).any():
        return Changes(np.ones(len(frame), dtype=np.bool_), np.ones(len(moments_s), dtype=np.bool_))
    order = np.lexsort((number, places.track_id))
    kept = (places.track_id, places.confirmed, places.observed, *(rule.sides(places) for rule in rules))
    begins = np.diff(number[order], prepend=-2) != 1
    for column in kept:
        begins[1:] |= np.diff(column[order].astype(np.int64)) != 0
    ends = np.append(begins[1:], True)
    rows = np.zeros(len(frame), dtype=np.bool_)
    rows[order] = begins | ends
    last = moments_s[number[order[ends]]]
    before = np.searchsorted(moments_s, last - VELOCITY_S, side="right")
    frames = np.zeros(len(moments_s) + 2, dtype=np.bool_)
    frames[1 + number[rows]] = True
    for rounding in (-1, 0, 1):
        frames[np.maximum(before + rounding, 0)] = True
    return Changes(rows, frames[1:-1])
