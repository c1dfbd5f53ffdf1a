"""Number of people in view, frame by frame, against truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planview.trajectories.table import Trajectories

VISIBLE_MIN = 0.25
"""A person counts as visible from this share of the body on: a head and shoulders, or one in a row of people."""


@dataclass(frozen=True)
class FrameCounts:
    """How often the number of people was wrong.

    Attributes:
        recording: name.
        frames: how many were compared.
        wrong: frames with another number of confirmed tracks than people who show.
        too_few: those of them with fewer tracks.
    """

    recording: str
    frames: int
    wrong: int
    too_few: int

    @property
    def error(self) -> float:
        """Share of frames with the wrong number (the counting error of del-Blanco et al. 2012, table I)."""
        return self.wrong / self.frames if self.frames else 0.0


def count_frames(recording: str, tracks: Trajectories, truth: Trajectories, n_frames: int) -> FrameCounts:
    """Compare the number of confirmed tracks with that of people who show, in frames 0 to n_frames - 1.

    Args:
        truth: with ``visible``; people without it count as seen.
    """
    shown = truth.frame[~(truth.visible < VISIBLE_MIN)]
    confirmed = tracks.frame[tracks.state == "confirmed"]
    found, true = (np.bincount(f[f < n_frames], minlength=n_frames) for f in (confirmed, shown))
    return FrameCounts(recording, n_frames, int((found != true).sum()), int((found < true).sum()))
