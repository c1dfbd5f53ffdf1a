"""Counting in a file of tracks or of truth."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.errors import InputError
from planview.counting.clock import Clock
from planview.counting.params import AnalyticsParams
from planview.counting.people import TrackRow
from planview.counting.places import Places
from planview.counting.rules import Rules
from planview.counting.stream import Analytics
from planview.counting.totals import Counts
from planview.trajectories.table import IGNORED, Trajectories

TRUTH_ZONE_HYSTERESIS_M = 0.05
"""For true occupancy: a head sways by as much when a person stands on the outline [m]; our choice."""
_BLOCK_FRAMES = 1000
"""Frames whose rows are located at a time, so that memory does not grow with the recording (our choice)."""


def count_tracks(
    tracks: Trajectories,
    rules: Rules,
    params: AnalyticsParams | None = None,
    *,
    clock: Clock | None = None,
    n_frames: int = 0,
) -> Counts:
    """Apply rules to tracks.

    Args:
        tracks: as read from a file.
        clock: time of the frames; that of the tracks (30 frames per second without timestamps) by default.
        n_frames: length of the recording where known; otherwise it ends with the last row.
    Raises:
        InputError: the tracks have no place in the plane of a rule.
    """
    _require_positions(tracks, rules)
    clock = clock or Clock(tracks, 30.0)
    analytics = Analytics(rules, params)
    events = [
        event
        for frame, moment, rows in _frames(tracks, clock, analytics)
        for event in analytics.update_rows(frame, moment, rows)
    ]
    stays = {name: sorted(stays, key=lambda s: s.start_s) for name, stays in analytics.stays.items()}
    span = clock.span(max(n_frames, int(tracks.frame.max()) + 1 if len(tracks) else 0))
    events.sort(key=lambda e: e.timestamp_s)
    return Counts(rules, events, stays, analytics.people, span, analytics.params.interval_s)


def count_truth(
    truth: Trajectories, rules: Rules, clock: Clock, params: AnalyticsParams | None = None, n_frames: int = 0
) -> Counts:
    """The true counts: the same rules on true positions, without a minimum age and without stitching of ids.

    A crossing means the same for truth: a person that steps back within the hysteresis has not crossed, which is also
    how crossings are counted by hand. The outline of a zone is taken as it is, but for sway.

    Args:
        clock: that of the tracks, since truth carries no times.
        params: those of the tracks.
    """
    params = (params or AnalyticsParams()).model_copy(update={"stitch_s": 0.0})
    return count_tracks(
        truth.where(truth.visible != IGNORED),
        rules.of_truth(TRUTH_ZONE_HYSTERESIS_M),
        params,
        clock=clock,
        n_frames=n_frames,
    )


def _frames(tracks: Trajectories, clock: Clock, analytics: Analytics) -> Iterator[tuple[int, float, list[TrackRow]]]:
    """(frame, time, rows) of every frame in which the counts may change."""
    frames, starts = np.unique(tracks.frame, return_index=True)
    moments = clock.at(frames)
    changes = analytics.changes(tracks.frame, moments, Places.of_rows(tracks, slice(None)))
    bounds = np.append(starts, len(tracks))
    for block in np.array_split(np.flatnonzero(changes.frames), 1 + len(frames) // _BLOCK_FRAMES):
        counts = bounds[block + 1] - bounds[block]
        ends = np.cumsum(counts)
        rows = np.repeat(bounds[block + 1] - ends, counts) + np.arange(counts.sum())
        located = analytics.rows(Places.of_rows(tracks, rows), changes.rows[rows])
        for i, start, end in zip(block.tolist(), (ends - counts).tolist(), ends.tolist(), strict=True):
            yield int(frames[i]), float(moments[i]), located[start:end]


def _require_positions(tracks: Trajectories, rules: Rules) -> None:
    for rule in (*rules.tripwires, *rules.zones):
        places = tracks.box_px.sum(axis=1) if rule.plane == "image" else tracks.x_m + tracks.y_m
        if len(tracks) and not np.isfinite(places).any():
            need = "boxes (or --camera)" if rule.plane == "image" else "floor positions"
            raise InputError(
                f"{rules.source}: expected tracks with {need} for rule {rule.name!r}, found none in any row"
            )
