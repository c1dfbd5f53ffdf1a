"""The real pavement clip: people who cross a line, as recorded, in half the light, and played backwards."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import cv2
import numpy as np

from benchmarks.counting import (
    WINDOW_S,
    CountingTable,
    Scorer,
    open_single,
    table_of,
    track_single,
)
from calib.types import U8
from planview.counting.events import Direction, Event
from planview.counting.geometry import RulePlane
from planview.counting.rules import parse_rules
from planview.counting.scoring import score_events
from planview.counting.totals import count_tracks
from planview.engine.factory import image_tracker
from planview.engine.single_camera_pipeline import SingleCameraPipeline
from planview.trajectories.table import read_tracks
from stereo.recording import Video, VideoFrame

UP = (96, 154, 828, 918, 1001, 1021, 1296, 1306)
DOWN = (351,)
FPS = 30.0
LAST = 1433
"""True crossings of the line y = 200 (frames), from the README of the recordings, which also gives the last frame."""
LIGHT = 0.5
"""Of the darkened clip."""

Version = Literal["as recorded", "half the light", "backwards"]


class AlteredVideo:
    """A video in another light or order; its frames are kept as PNG files in memory.

    Args:
        video: is read once.
    """

    def __init__(self, video: Video, version: Version) -> None:
        self.path, self.fps, self.size, self.skipped = video.path, video.fps, video.size, video.skipped
        self._frames = [(frame.timestamp_s, _encoded(altered(frame.image, version))) for frame in video]
        self.n_frames = len(self._frames)
        if version == "backwards":
            self._frames = [
                (then, image) for (then, _), (_, image) in zip(self._frames, reversed(self._frames), strict=True)
            ]

    def __iter__(self) -> Iterator[VideoFrame]:
        for index, (timestamp_s, png) in enumerate(self._frames):
            yield VideoFrame(index, timestamp_s, np.asarray(cv2.imdecode(png, cv2.IMREAD_UNCHANGED), dtype=np.uint8))


class Crossing(NamedTuple):
    """Of the line, in a frame."""

    frame: int
    way: Direction


def altered(image: U8, version: Version) -> U8:
    """The image in the version's light."""
    return np.asarray(image * LIGHT, dtype=np.uint8) if version == "half the light" else image


def crossings(version: Version) -> list[Crossing]:
    """Up the image is from the right of the line to its left."""
    there = [Crossing(frame, "right_to_left") for frame in UP] + [Crossing(frame, "left_to_right") for frame in DOWN]
    if version != "backwards":
        return there
    return [Crossing(LAST - c.frame, "left_to_right" if c.way == "right_to_left" else "right_to_left") for c in there]


def pavement_truth(version: Version) -> list[Event]:
    """The true crossings as events, a person for each."""
    return [
        Event(crossing.frame, crossing.frame / FPS, "y = 200", "crossing", person, crossing.way)
        for person, crossing in enumerate(crossings(version), start=1)
    ]


def score_pavement(
    clip: Path, scorer: Scorer, camera: Path | None, versions: Sequence[Version] = get_args(Version)
) -> CountingTable:
    """The clip against the crossings in the README of the recordings.

    Args:
        clip: pavement.mp4.
        camera: camera.toml of the clip; without one, the line is applied in the image to the feet of boxes.
    """
    together = CountingTable((), ())
    for version in versions:
        scorer.tell(f"tracking the pavement, {version}")
        engine = open_single(clip, scorer.config, scorer.tracker, camera)
        if version != "as recorded" and isinstance(engine, SingleCameraPipeline):
            altered_video = AlteredVideo(engine.recording, version)
            tracker = image_tracker(scorer.tracker, scorer.config, engine.camera)
            engine = SingleCameraPipeline.from_recording(altered_video, tracker, scorer.config, engine.camera)
        place = scorer.out / f"pavement {version}".replace(" ", "-")
        track_single(engine, place, scorer.tracker, None)
        wire = {"name": "y = 200", "from_px": [0.0, 200.0], "to_px": [399.0, 200.0]}
        rules = parse_rules({"tripwire": [wire]}, RulePlane(engine.camera, engine.size), "y = 200")
        found = count_tracks(read_tracks(place / "tracks.csv"), rules)
        together += table_of(f"pavement, {version}", score_events(pavement_truth(version), found, WINDOW_S))
    return together


def _encoded(image: U8) -> U8:
    _, png = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return np.asarray(png, dtype=np.uint8)
