"""Pictures and videos of a run."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from calib.errors import InputError, WorkError
from calib.images import write_image
from calib.io import PART
from calib.types import U8
from planview.counting.events import Event, inward_ways, way_words
from planview.drawing.image import ImagePainter
from planview.drawing.plan import PlanBounds, PlanPainter, Snapshot, snapshot_at
from planview.output.folder import writing
from planview.output.run_folder import RunFolder

if TYPE_CHECKING:
    from planview.output.scene import SceneFrames

HEADER_PX, LINE_PX = 30, 22
ALONE_PX = (960, 720)
"""Size of the floor where there is no image."""
_INK, _BACK, _FONT = (40, 40, 40), (255, 255, 255), cv2.FONT_HERSHEY_SIMPLEX


def tally(events: Sequence[Event], inward: Mapping[str, str], frame: int) -> list[str]:
    """What each rule of (all) events has counted up to a frame; ``inward``: the direction that is in, where there is
    one."""
    count: Counter[tuple[str, str]] = Counter(
        (event.rule, event.direction or event.kind) for event in events if event.frame <= frame
    )
    lines = []
    for rule, kind in {event.rule: event.kind for event in sorted(events, key=lambda e: e.frame)}.items():
        entries = count[rule, "entry"]
        parts = [f"{entries - count[rule, 'exit']} inside", f"{entries} entries"]
        if kind == "crossing":
            ways = ("left_to_right", "right_to_left")
            parts = [f"{count[rule, way]} {way_words(way, inward.get(rule))}" for way in ways]
        lines.append(f"{rule}: {', '.join(parts)}")
    return lines


class SceneComposer:
    """Draws frames of a run: the image with people, and the floor from above.

    Args:
        frames: of the recording; None for the floor alone.
        bounds: of the floor that is shown; where people were when None.
    """

    def __init__(
        self,
        results: RunFolder,
        frames: SceneFrames | None,
        trail_s: float = 4.0,
        *,
        plan: bool = True,
        truth: bool = True,
        bounds: PlanBounds | None = None,
    ) -> None:
        self._results = results
        self._bounds = bounds or results.bounds()
        self._trail = round(trail_s / results.clock.frame_s)
        self._truth = results.truth if truth else None
        self._with_plan = plan and results.on_floor
        self._image = ImagePainter(frames.camera if frames else None, results.rules, self._bounds)
        self._plan: PlanPainter | None = None

    def __call__(self, frame: int, image: U8 | None) -> U8:
        """(H, W, 3) uint8 BGR with even H and W; ``image``: (h, w[, 3]) uint8 BGR, None where it cannot be read."""
        snapshot = snapshot_at(self._results.tracks, frame, self._trail, self._truth)
        counted = tally(self._results.events, inward_ways(self._results.rule_counts), frame)
        panels = [] if image is None else [self._image(image, snapshot)]
        if self._with_plan or image is None:
            height = panels[0].shape[0] if panels else ALONE_PX[1]
            panels.append(self._floor(snapshot, height, counted, alone=not panels))
        picture = np.hstack(panels)
        header: U8 = np.full((HEADER_PX, picture.shape[1], 3), _BACK, dtype=np.uint8)
        time_s = float(self._results.clock.at(np.array([frame]))[0])
        people = np.count_nonzero(self._results.tracks.frame[self._results.of_people] == frame)
        text = f"frame {frame}   {time_s:.2f} s   {people} {'person' if people == 1 else 'people'}"
        if image is not None and not self._with_plan:  # which has room for what rules count
            text = "   ".join([text, *counted])
        cv2.putText(header, text, (8, HEADER_PX - 10), _FONT, 0.5, _INK, 1, cv2.LINE_AA)
        whole = np.vstack([header, picture])
        return np.ascontiguousarray(whole[: whole.shape[0] // 2 * 2, : whole.shape[1] // 2 * 2])

    def _floor(self, snapshot: Snapshot, height: int, counted: list[str], *, alone: bool) -> U8:
        """The floor from above, with the counts below it."""
        below = LINE_PX * len(counted) + (8 if counted else 0)
        # Width of the floor as a share of the image's height.
        size = ALONE_PX[0] if alone else round(0.75 * height), height - below
        if self._plan is None:
            self._plan = PlanPainter(self._bounds, size, self._results.cameras, self._results.rules)
        text: U8 = np.full((below, size[0], 3), _BACK, dtype=np.uint8)
        for n, line in enumerate(counted):
            cv2.putText(text, line, (8, LINE_PX * (n + 1) - 4), _FONT, 0.45, _INK, 1, cv2.LINE_AA)
        return np.vstack([self._plan(snapshot), text])


CODECS = {".mp4": "vp09", ".webm": "VP80", ".avi": "MJPG", ".mkv": "VP80"}
"""By ending: what OpenCV's wheels write and browsers play, VP9 in .mp4 and VP8 in .webm; they have no H.264 encoder."""


def write_video(path: Path, fps: float, pictures: Iterable[U8]) -> int:
    """Write pictures of one size into a video, which is at its place when all are written; how many there were. Raises
    InputError: the path does not end like a video. WorkError: it cannot be written."""
    codec = CODECS.get(path.suffix.lower())
    if codec is None:
        raise InputError(f"{path}: expected a video's name ({', '.join(CODECS)}), found {path.name!r}")
    part, writer, count = path.with_name(f"{path.stem}{PART}{path.suffix}"), cv2.VideoWriter(), 0
    try:
        for count, picture in enumerate(pictures, 1):
            if count == 1:
                with writing(path):
                    path.parent.mkdir(parents=True, exist_ok=True)
                if not writer.open(str(part), cv2.VideoWriter.fourcc(*codec), fps, picture.shape[1::-1]):
                    raise WorkError(f"{path}: the video cannot be written")
            writer.write(picture)
        writer.release()
        if count:
            with writing(path):
                part.replace(path)
    finally:
        writer.release()
        part.unlink(missing_ok=True)
    return count


def scene_pictures_of(
    composer: SceneComposer, frames: SceneFrames | None, first: int, last: int, every: int
) -> Iterator[U8]:
    """Pictures of every n-th frame; a frame that cannot be read shows the image before it."""
    wanted = deque(range(first, last + 1, every))
    if frames is None:
        yield from (composer(frame, None) for frame in wanted)
        return
    for index, image in frames.through(first, last):
        while wanted and wanted[0] <= index:
            yield composer(wanted.popleft(), image)


def write_still(composer: SceneComposer, frames: SceneFrames | None, frame: int, path: Path) -> None:
    """Write a picture of one frame; the floor alone where its image cannot be read."""
    image = next((image for _, image in frames.at([frame])), None) if frames is not None else None
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_image(path, composer(frame, image))
