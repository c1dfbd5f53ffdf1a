"""Pictures of counting: models over a frame, and the number of people over time."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from calib.types import F64, I64, U8
from planview.engine.engine import FrameResult
from planview.tracking.base import Tracker, TrackerDebug

JPEG_QUALITY = 80
ENLARGED = 2
"""Factor on the frame, so that labels can be read."""
_COLOURS = {"moving": (80, 220, 80), "stopped": (60, 200, 240), "stationary": (240, 160, 80)}
"""BGR by motion state; green where there is none."""


class BusiestFrame:
    """Keeps a picture of the frame with the most people; give it every result of a run.

    Attributes:
        people: how many are on it.
        picture: (H, W, 3) uint8, None before a person was visible.
    """

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self.people = 0
        self.picture: U8 | None = None

    def __call__(self, result: FrameResult) -> None:
        people = sum(track.state == "confirmed" for track in result.tracks)
        image = result.image
        if people > self.people and image is not None and image.ndim == 3:
            self.people, self.picture = people, models_over_frame(image, self._tracker.debug())


def models_over_frame(image: U8, debug: TrackerDebug) -> U8:
    """The frame, enlarged, with all strips of the image and their labels (figure 7 of Zhang et al. 2008).

    Args:
        image: (H, W, 3) uint8 BGR.
        debug: of the tracker after that frame.
    """
    picture = cv2.resize(image, None, fx=ENLARGED, fy=ENLARGED, interpolation=cv2.INTER_CUBIC)
    for drawing in debug.drawings:
        if drawing.plane != "image":
            continue
        for number, strip in enumerate(drawing.strips):
            words = drawing.labels[number].split() if number < len(drawing.labels) else []
            colour = next((c for state, c in _COLOURS.items() if state in words), _COLOURS["moving"])
            points = np.rint(ENLARGED * strip).astype(np.int32)
            cv2.polylines(picture, [points], False, colour, 1, cv2.LINE_AA)
            if words:
                left, top = int(points[:, 0].min()), max(12, int(points[:, 1].min()) - 3)
                text = " ".join(words[:2])
                cv2.putText(picture, text, (left, top), cv2.FONT_HERSHEY_SIMPLEX, 0.4, colour, 1, cv2.LINE_AA)
    return np.asarray(picture, dtype=np.uint8)


def write_occupancy(path: Path, zone: str, times_s: F64, true: I64, found: I64) -> None:
    """Plot (N,) true and found numbers of people in a zone over time [s] as PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 3.0), layout="constrained")
    axes = figure.subplots()
    axes.grid(color="#dddddd", linewidth=0.6)
    axes.step(times_s, true, where="post", color="#888888", linewidth=3.0, label="true")
    axes.step(times_s, found, where="post", color="#c03030", linewidth=1.2, label="found")
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"people in {zone!r}")
    axes.margins(x=0)
    axes.legend(loc="upper left", frameon=False)
    figure.savefig(path, dpi=100)
