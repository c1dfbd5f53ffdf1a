"""The time from frame to frame, from the timestamps of a table."""

from __future__ import annotations

import numpy as np

from planview.trajectories.table import Trajectories


def frame_period_s(table: Trajectories, fallback_s: float) -> float:
    """Median time per frame [s] over rows with timestamps.

    The mean where most frames share a timestamp; ``fallback_s`` where fewer than two frames have one or time stands.
    """
    known = np.isfinite(table.timestamp_s)
    frames, first = np.unique(table.frame[known], return_index=True)
    times = table.timestamp_s[known][first]
    if len(frames) < 2 or times[-1] <= times[0]:
        return fallback_s
    period = float(np.median(np.diff(times) / np.diff(frames)))
    return period if period > 0 else float((times[-1] - times[0]) / (frames[-1] - frames[0]))
