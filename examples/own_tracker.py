"""Another tracker: the nearest height maximum, with no memory of appearance.

A tracker has ``update`` (once per frame, in order), ``reset``, ``decisions`` and ``debug``, and says what it ``needs``
(``planview.Tracker``). Everything that earlier stages know comes in the observation; here the plan-view maps are
enough, which one camera without depth does not have.

Run: python examples/own_tracker.py [RECORDING]
"""

import sys
from dataclasses import replace
from typing import Literal

import cv2
import numpy as np

import planview

MIN_HEIGHT_M = 1.2
REACH_M = 0.6


class NearestMaximum:
    """People are maxima of the height map; each takes the name of the nearest one of the frame before."""

    needs: Literal["maps"] = "maps"
    decisions: tuple[planview.Decision, ...] = ()

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all people."""
        self._people: tuple[planview.TrackState, ...] = ()
        self._next_id = 1

    def update(self, observation: planview.Observation) -> tuple[planview.TrackState, ...]:
        """People of one frame; every maximum farther than ``REACH_M`` from all people is a new person."""
        free = list(self._people)
        self._people = tuple(self._named(found, free) for found in self._maxima(observation))
        return self._people

    def debug(self) -> planview.TrackerDebug:
        """Nothing to draw."""
        return planview.TrackerDebug()

    def _named(self, found: planview.TrackState, free: list[planview.TrackState]) -> planview.TrackState:
        distances = [np.hypot(found.x_m - p.x_m, found.y_m - p.y_m) for p in free]
        if distances and min(distances) < REACH_M:
            return replace(found, track_id=free.pop(int(np.argmin(distances))).track_id)
        self._next_id += 1
        return replace(found, track_id=self._next_id - 1)

    def _maxima(self, observation: planview.Observation) -> list[planview.TrackState]:
        maps = observation.maps
        if maps is None:
            return []
        heights = cv2.GaussianBlur(maps.height, (0, 0), 2.0)
        size = 2 * round(REACH_M / 2 / maps.grid.cell_m) + 1
        highest = cv2.dilate(heights, np.ones((size, size), np.uint8))
        rows, columns = np.nonzero((heights == highest) & (heights > MIN_HEIGHT_M))
        found = []
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
            x_m, y_m = maps.grid.centre_of(float(row), float(column))
            found.append(planview.TrackState(1, "confirmed", x_m, y_m, height_m=float(maps.height[row, column])))
        return found


def main(recording: str = "data/synthetic/demo", *, frames: int | None = None) -> None:
    """Track with maxima only and score against the recording's truth."""
    tracks = planview.run(recording, tracker=NearestMaximum(), frames=frames)
    last = int(tracks.frame.max()) if len(tracks) else 0
    scores = planview.evaluate(tracks, recording, frames=(0, last)).to_json()
    print(f"nearest maximum: {len(set(tracks.track_id))} ids, mota {scores['mota']:.2f}, switches {scores['switches']}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
