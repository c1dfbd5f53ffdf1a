"""Session of a person in the browser, without the browser: recording, frames, samples, floor points, results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from calib.errors import InputError, WorkError
from calib.ground_camera import save_ground_camera
from calib.images import as_grey, focal_share
from calib.io import entries, reason
from calib.people.calibration import calibrate_from_people
from calib.people.model import KnownValues
from calib.people.samples import MIN_SAMPLES, HumanSample, write_samples
from calib.rig import Floor
from calib.types import U8, Bool
from calib.world import save_world
from planview.calibration.floor import FloorDepths
from planview.calibration.page.marks import Draft, Handle, Point, Solution, fit_floor, moved, nearest, part_under_mouse
from stereo.floor import FloorSearch
from stereo.readers import OpenOptions, find_layout, find_reader, open_recording, open_video
from stereo.readers.open import OF_TWO_IMAGES
from stereo.readers.side_by_side import READER as SIDE_BY_SIDE
from stereo.recording import Recording, SingleCamera

Tool = Literal["person", "select", "floor"]
GRAB_PX = 12.0
"""A point within this distance of the mouse is picked up instead of a new one made [px of the screen]."""
LOOKED_AT = 40
"""Pictures of a video in which movement is searched (for speed)."""
PICTURES_MAX = 50
"""Pictures of a video that are kept, those read last."""
PHOTOGRAPHS = (".jpg", ".jpeg", ".heic", ".tif", ".tiff")


@dataclass
class CalibrationSession:
    """State of one calibration.

    Attributes:
        name: of the video, for messages.
        frames, indices: pictures to choose from, (H, W[, 3]) uint8, and their positions in the video.
        view, plain_floor: depth of a stereo recording and the floor found without points, None where there is none.
        walked: (height, width), where something moves in a video; None where that is not known.
        shown, tool: number of the frame shown, and what the mouse does.
        lens, known: class of table 2, None to try all, and values known besides the samples.
        draft, samples, floor_points: the person being marked, finished people, and (u, v) on the floor.
        selected, solution: what was picked up and what was computed last.
        message: for the person at the screen.
    """

    name: str
    frames: Sequence[U8] | VideoPictures
    indices: Sequence[int]
    view: FloorDepths | None = None
    plain_floor: Floor | None = None
    walked: Bool | None = None
    shown: int = 0
    tool: Tool = "person"
    lens: str | None = None
    known: KnownValues = field(default_factory=KnownValues)
    draft: Draft = field(default_factory=Draft)
    samples: list[HumanSample] = field(default_factory=list)
    floor_points: list[Point] = field(default_factory=list)
    selected: Handle | None = None
    solution: Solution = field(default_factory=Solution)
    message: str = ""
    _start: Point | None = None
    _held: Point | None = None
    _past: list[tuple[list[HumanSample], list[Point]]] = field(default_factory=list)

    def __post_init__(self) -> None:
        if not len(self.frames):
            raise InputError(f"{self.name}: expected frames to draw on, found none")
        if self.view is not None:
            self.tool = "floor"
        self.message = self.next_step()

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the pictures [px]."""
        return self.frames[0].shape[1], self.frames[0].shape[0]

    @property
    def floor(self) -> Floor | None:
        """The floor of a stereo recording: that of the points, else that found without them."""
        return self.solution.fit.floor if self.solution.fit else self.plain_floor

    def here(self) -> list[tuple[int, HumanSample]]:
        """Samples of the frame shown, with their numbers."""
        index = self.indices[self.shown]
        return [(i, s) for i, s in enumerate(self.samples) if s.frame == index]

    def show(self, number: int) -> None:
        """Show another frame; a person half marked is dropped, since it belongs to the frame before."""
        number = min(max(int(number), 0), len(self.frames) - 1)
        if number != self.shown:
            self.shown = number
            self.cancel()

    def show_sample(self, number: int) -> None:
        """Show and select a sample."""
        if self.samples[number].frame in self.indices:
            self.show(self.indices.index(self.samples[number].frame))
        self.tool = "select"
        self.selected = Handle(number, "whole")
        self.message = self.next_step()

    def choose(self, tool: Tool) -> None:
        """Take another tool into the hand."""
        self.tool = tool
        self.cancel()

    def cancel(self) -> None:
        """Drop a person half marked and the selection."""
        self.draft = Draft()
        self._start = None
        self._held = None
        self.selected = None
        self.message = self.next_step()

    def press(self, u: float, v: float, reach_px: float = GRAB_PX) -> None:
        """The mouse goes down at a pixel; a point as near as ``reach_px`` is picked up [px of the image]."""
        u, v = self._inside(u, v)
        if self.tool == "person":
            if self.draft.step == "box":
                self._start = (u, v)
                self.draft = Draft()
            else:
                setattr(self.draft, f"{self.draft.step}_px", (u, v))
            return
        self.selected = nearest(self.floor_points, (u, v), reach_px)
        if self.tool == "select" and self.selected is None:
            self.selected = part_under_mouse(self.here(), (u, v), reach_px)
        if self.tool == "floor" and self.selected is None:
            self._remember()
            self.floor_points.append((u, v))
            self.selected = Handle(len(self.floor_points) - 1, "point")
        elif self.selected is not None:
            self._remember()
        self._held = (u, v) if self.selected else None

    def drag(self, u: float, v: float) -> None:
        """The mouse moves with its button down."""
        u, v = self._inside(u, v)
        if self._held is not None:
            (u0, v0), self._held = self._held, (u, v)
            self._shift(u - u0, v - v0)
        elif self._start is not None:
            (u0, v0) = self._start
            self.draft.box_px = (min(u, u0), min(v, v0), abs(u - u0), abs(v - v0))

    def release(self, u: float, v: float) -> bool:
        """The mouse goes up: the mark is finished. Whether the result must be computed again (``solve``)."""
        self.drag(u, v)
        if self._held is not None:
            self._held = None
            unchanged = bool(self._past) and self._past[-1] == (self.samples, self.floor_points)
            del self._past[len(self._past) - unchanged :]
            self.message = self.next_step()
            return not unchanged
        if self._start is not None:
            self._start = None
            # A smaller box is a slip of the hand.
            if self.draft.box_px is None or min(self.draft.box_px[2:]) < 8.0:
                self.draft = Draft()
        draft = self.draft
        if draft.box_px and draft.head_px and draft.foot_px:
            self.draft = Draft()
            try:
                sample = HumanSample(draft.box_px, draft.head_px, draft.foot_px, self.indices[self.shown])
            except ValueError as error:
                self.message = f"that is no standing person: {error}"
                return False
            self._remember()
            self.samples.append(sample)
        self.message = self.next_step()
        return self.draft is not draft

    def nudge(self, du: float, dv: float) -> None:
        """Move what is selected by some pixels."""
        self._remember()
        self._shift(du, dv)

    def remove_selected(self) -> bool:
        """Delete the person or the floor point that is selected; whether something was."""
        if self.selected is None:
            return False
        self._remember()
        del (self.floor_points if self.selected.part == "point" else self.samples)[self.selected.number]
        self.cancel()
        return True

    def undo(self) -> bool:
        """Take back what is half marked, else the last change; whether the result must be computed again."""
        drafted = self.draft != Draft()
        self.cancel()
        if drafted or not self._past:
            return False
        self.samples, self.floor_points = self._past.pop()
        self.message = self.next_step()
        return True

    def load(self, samples: Sequence[HumanSample], size: tuple[int, int] | None) -> None:
        """Take samples from a file in place of the marks. Raises InputError: samples of another image size."""
        if size is not None and size != self.size:
            (w, h), (width, height) = size, self.size
            raise InputError(f"expected samples of images of {width}x{height} px, found {w}x{h}")
        self._remember()
        self.samples = list(samples)
        self.cancel()

    def solve(self) -> Solution:
        """The camera or the floor of the marks so far; takes up to seconds, in which marks may be added."""
        samples = tuple(self.samples)
        points = tuple(self.floor_points)
        try:
            if self.view is not None:
                return Solution(fit=fit_floor(self.view, points)) if len(points) >= 3 else Solution()
            if len(samples) < MIN_SAMPLES:
                return Solution()
            how = partial(calibrate_from_people, known=self.known, name=self.name, walked=self.walked)
            return Solution(how(samples, self.size, self.lens))
        except (InputError, WorkError) as error:
            return Solution(problem=str(error))

    def export(self, folder: Path, solution: bool = True) -> tuple[Path, ...]:
        """Write samples.json and, with ``solution``, camera.toml or world.toml as far as there is one. Raises
        InputError: nothing to write yet, or nowhere to write it."""
        found, fit = (self.solution.found, self.solution.fit) if solution else (None, None)
        written = []
        try:
            if self.samples:
                written.append(folder / "samples.json")
                write_samples(self.samples, written[-1], self.size)
            if found:
                written.append(folder / "camera.toml")
                save_ground_camera(found.camera, written[-1])
            if fit:
                written.append(folder / "world.toml")
                save_world(fit.floor, written[-1])
        except OSError as error:
            raise InputError(f"{folder}: expected a folder to write to, found {reason(error)}") from error
        if not written:
            raise InputError(f"{self.name}: expected marks before an export, found nothing")
        self.message = "wrote " + ", ".join(map(str, written))
        return tuple(written)

    def next_step(self) -> str:
        """Instruction for the person at the screen."""
        if self.tool == "select":
            return "click a person or a point; drag to move it, arrow keys by a pixel, Delete removes it"
        if self.tool == "floor":
            missing = max(0, 3 - len(self.floor_points)) if self.view is not None else 0
            return f"click {missing} more points on the floor" if missing else "click points on the floor; drag them"
        if self.draft.step != "box":
            return {"head": "click the top of the head", "foot": "click the middle between the feet"}[self.draft.step]
        missing = max(0, MIN_SAMPLES - len(self.samples))
        where = f" ({missing} more people at other places needed)" if missing else ""
        return f"draw a box around a standing person{where}"

    def _shift(self, du: float, dv: float) -> None:
        assert self.selected is not None
        number, part = self.selected
        if part == "point":
            u, v = self.floor_points[number]
            self.floor_points[number] = self._inside(u + du, v + dv)
        else:
            try:
                self.samples[number] = moved(self.samples[number], part, (du, dv))
            except ValueError as error:
                self.message = f"that is no standing person: {error}"

    def _remember(self) -> None:
        self._past.append((list(self.samples), list(self.floor_points)))

    def _inside(self, u: float, v: float) -> Point:
        width, height = self.size
        return min(max(float(u), 0.0), width - 1.0), min(max(float(v), 0.0), height - 1.0)


def open_session(path: Path, calibration: Path | None = None) -> CalibrationSession:
    """Every frame of a video of one camera to draw on, or the depth of a stereo recording, which it must be with its
    ``calibration``: also both views of a side-by-side video, and the two cameras of a bag. The focal length of
    photographs that give it is taken as known."""
    stereo = calibration is not None
    with suppress(InputError):
        find_reader(path, OF_TWO_IMAGES)
        stereo = True
    with suppress(InputError):  # the pictures of a video may be two views of one scene
        find_layout(path, readers=[SIDE_BY_SIDE])
        stereo = True
    if stereo:
        view = FloorDepths(open_recording(path, OpenOptions(calibration)), FloorSearch())
        session = CalibrationSession(str(path), [view.image], [0], view)
        with suppress(WorkError):
            session.plain_floor = view.find()
        return session
    video = open_video(path)
    if not any(True for _ in video):
        raise InputError(f"{path}: expected a video with frames, found none that can be decoded")
    session = CalibrationSession(path.name, VideoPictures(video), range(video.n_frames), walked=walked_in(video))
    session.known = known_of(path, session.size)
    return session


def walked_in(video: Recording[SingleCamera]) -> Bool | None:
    """(height, width) where pictures spread over a video differ from what is usual there; None where none does."""
    width, height = video.sensor.size
    frames = video.at(np.unique(np.linspace(0, video.n_frames - 1, LOOKED_AT).astype(int)).tolist())
    small = [cv2.resize(as_grey(frame.image), (80, 60), interpolation=cv2.INTER_AREA) for frame in frames]
    if not small:
        return None
    moved = np.abs(np.stack(small).astype(np.float32) - np.median(small, axis=0)).max(axis=0) > 20
    # As far as a step goes.
    whole = cv2.resize(cv2.dilate(moved.astype(np.uint8), np.ones((5, 5), np.uint8)), (width, height))
    return np.asarray(whole > 0, dtype=np.bool_) if moved.any() else None


class VideoPictures:
    """Every frame of a video, read on demand; grey where one cannot be decoded."""

    def __init__(self, video: Recording[SingleCamera]) -> None:
        def read(index: int) -> U8:
            frames, (width, height) = video.at([index]), video.sensor.size
            return frames[0].image if frames else np.full((height, width, 3), 128, np.uint8)

        self._n_frames = video.n_frames
        self._read = lru_cache(PICTURES_MAX)(read)

    def __len__(self) -> int:
        return self._n_frames

    def __getitem__(self, index: int) -> U8:
        return self._read(index)


def known_of(path: Path, size: tuple[int, int]) -> KnownValues:
    """The focal length of the first photograph of a folder, where it gives it."""
    photographs = [p for p in entries(path) if p.suffix.lower() in PHOTOGRAPHS] if path.is_dir() else []
    with suppress(InputError):
        if photographs:
            return KnownValues(focal_px=focal_share(photographs[0]) * math.hypot(*size))
    return KnownValues()
