"""What a person does in the browser, without the browser: frames, samples, floor points, results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from calib.errors import InputError, WorkError
from calib.floor.world_file import save_world
from calib.ground_camera import LENS_K_320, save_ground_camera
from calib.human.calibration import HumanCalibration, calibrate_from_people
from calib.human.samples import MIN_SAMPLES, HumanSample, write_samples
from calib.rig import Floor
from calib.types import U8
from planview.calibration.floor import FloorView, given_floor

Tool = Literal["box", "head", "foot", "floor"]
Point = tuple[float, float]
GRAB_PX = 12.0
"""A point within this distance of the mouse is picked up instead of a new one made [px]."""
MIN_BOX_PX = 8.0
"""A smaller box is a slip of the hand."""


@dataclass
class Draft:
    """A person being drawn; what is not drawn yet is None."""

    box_px: tuple[float, float, float, float] | None = None
    head_px: Point | None = None
    foot_px: Point | None = None


@dataclass
class CalibrationSession:
    """State of one calibration.

    Attributes:
        name: of the video, for messages.
        frames: pictures to choose from, (H, W[, 3]) uint8.
        indices: their positions in the video.
        view: depth of a stereo recording, None for one camera.
        shown: number of the frame shown.
        tool: what the mouse draws.
        lens: class of table 2, None to try all.
        draft: the person being drawn.
        samples: finished people.
        floor_points: (u, v) on the floor, in the order made.
        found: camera from the samples (one camera).
        floor: floor from the points (stereo).
        message: what to tell the person at the screen.
    """

    name: str
    frames: Sequence[U8]
    indices: Sequence[int]
    view: FloorView | None = None
    shown: int = 0
    tool: Tool = "box"
    lens: str | None = None
    draft: Draft = field(default_factory=Draft)
    samples: list[HumanSample] = field(default_factory=list)
    floor_points: list[Point] = field(default_factory=list)
    found: HumanCalibration | None = None
    floor: Floor | None = None
    message: str = ""
    _start: Point | None = None
    _dragged: int | None = None

    def __post_init__(self) -> None:
        if not self.frames:
            raise InputError(f"{self.name}: expected frames to draw on, found none")
        if self.view is not None:
            self.tool = "floor"
        self.message = self._next_step()

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the pictures [px]."""
        return self.frames[0].shape[1], self.frames[0].shape[0]

    def show(self, number: int) -> None:
        """Show another frame; a person half drawn is dropped, since it belongs to the frame before."""
        number = min(max(int(number), 0), len(self.frames) - 1)
        if number != self.shown:
            self.shown, self.draft = number, Draft()
            self._start = None
            if self.view is None and self.tool != "floor":
                self.tool = "box"

    def choose_lens(self, lens: str) -> None:
        """A class of table 2, or "" to try all."""
        if lens and lens not in LENS_K_320:
            raise ValueError(f"expected one of {', '.join(LENS_K_320)}, got {lens!r}")
        self.lens = lens or None

    def press(self, u: float, v: float) -> None:
        """The mouse goes down at a pixel."""
        u, v = self._inside(u, v)
        if self.tool == "floor":
            self._dragged = self._near(u, v)
            if self._dragged is None:
                self.floor_points.append((u, v))
                self._dragged = len(self.floor_points) - 1
        elif self.tool == "box":
            self._start, self.draft = (u, v), Draft()
        elif self.tool == "head":
            self.draft.head_px = (u, v)
        else:
            self.draft.foot_px = (u, v)

    def drag(self, u: float, v: float) -> None:
        """The mouse moves with its button down."""
        u, v = self._inside(u, v)
        if self._dragged is not None:
            self.floor_points[self._dragged] = (u, v)
        elif self._start is not None:
            (u0, v0) = self._start
            self.draft.box_px = (min(u, u0), min(v, v0), abs(u - u0), abs(v - v0))

    def release(self, u: float, v: float) -> bool:
        """The mouse goes up: what was drawn is finished.

        Returns:
            Whether the result must be computed again (``solve``, up to seconds long).
        """
        self.drag(u, v)
        if self._dragged is not None:
            self._dragged = None
            self.message = self._next_step()
            return True
        added = False
        if self.tool == "box" and self._start is not None:
            self._start = None
            box = self.draft.box_px
            if box is None or min(box[2:]) < MIN_BOX_PX:
                self.draft = Draft()
            else:
                self.tool = "head"
            self.message = self._next_step()
        elif self.tool == "head" and self.draft.head_px is not None:
            self.tool = "foot"
            self.message = self._next_step()
        elif self.tool == "foot" and self.draft.foot_px is not None:
            added = self._finish_person()
        return added

    def remove_last(self) -> None:
        """Take back the last floor point or the last person, whichever tool is in the hand."""
        if self.tool == "floor":
            if self.floor_points:
                self.floor_points.pop()
        elif self.draft != Draft():
            self.draft, self.tool = Draft(), "box"
        elif self.samples:
            self.samples.pop()
        self.message = self._next_step()

    def solve(self) -> None:
        """Compute what the drawing allows; ``message`` says why not otherwise."""
        told = ""
        try:
            if self.view is not None:
                self.floor = None
                if len(self.floor_points) >= 3:
                    self.floor = given_floor(self.view, np.array(self.floor_points), pixels=True)
            else:
                self.found = None
                if len(self.samples) >= MIN_SAMPLES:
                    self.found = calibrate_from_people(list(self.samples), self.size, self.lens, name=self.name)
        except (InputError, WorkError) as error:
            told = str(error)
        told = told or self._result()
        # The next person may have been begun meanwhile: what to click must not be lost.
        begun = [self._next_step()] if not told or self.tool in ("head", "foot") else []
        self.message = "; ".join(([told] if told else []) + begun)

    def floor_metres(self) -> list[Point | None]:
        """World (x, y) of the floor points under the camera found, None where they are not on the floor."""
        if self.found is None:
            return [None] * len(self.floor_points)
        xy = self.found.camera.back_project(np.array(self.floor_points).reshape(-1, 2))
        return [(float(x), float(y)) if math.isfinite(x) and math.isfinite(y) else None for x, y in xy]

    def export(self, folder: Path) -> tuple[Path, ...]:
        """Write samples.json and camera.toml, or world.toml.

        Raises:
            InputError: nothing to write yet, or nowhere to write it.
        """
        written: list[Path] = []
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if self.samples:
                written.append(folder / "samples.json")
                write_samples(self.samples, written[-1], self.size)
            if self.found is not None:
                written.append(folder / "camera.toml")
                save_ground_camera(self.found.camera, written[-1])
            if self.floor is not None:
                written.append(folder / "world.toml")
                save_world(self.floor, written[-1])
        except OSError as error:
            raise InputError(f"{folder}: expected a folder to write to, found {error}") from error
        if not written:
            raise InputError(f"{self.name}: expected something drawn before it is exported, found nothing")
        self.message = "wrote " + ", ".join(str(path) for path in written)
        return tuple(written)

    def _finish_person(self) -> bool:
        draft, self.draft, self.tool = self.draft, Draft(), "box"
        if draft.box_px is None or draft.head_px is None or draft.foot_px is None:
            self.message = "draw box, head and foot, in this order"
            return False
        try:
            self.samples.append(HumanSample(draft.box_px, draft.head_px, draft.foot_px, self.indices[self.shown]))
        except ValueError as error:
            self.message = f"that is no standing person: {error}"
            return False
        self.message = self._next_step()
        return True

    def _inside(self, u: float, v: float) -> Point:
        width, height = self.size
        return min(max(float(u), 0.0), width - 1.0), min(max(float(v), 0.0), height - 1.0)

    def _near(self, u: float, v: float) -> int | None:
        distances = [math.hypot(u - a, v - b) for a, b in self.floor_points]
        best = int(np.argmin(distances)) if distances else -1
        return best if best >= 0 and distances[best] <= GRAB_PX else None

    def _next_step(self) -> str:
        if self.view is not None:
            missing = max(0, 3 - len(self.floor_points))
            return f"click {missing} more points on the floor; drag them to move them" if missing else ""
        if self.tool == "head":
            return "click the top of the head"
        if self.tool == "foot":
            return "click the middle between the feet"
        missing = max(0, MIN_SAMPLES - len(self.samples))
        where = f" ({missing} more people at other places needed)" if missing else " to add another"
        return f"draw a box around a standing person{where}"

    def _result(self) -> str:
        if self.floor is not None:
            return (
                f"camera {self.floor.height_m:.2f} m above the floor, tilt {math.degrees(self.floor.tilt_rad):.1f}, "
                f"roll {math.degrees(self.floor.roll_rad):.1f} degrees"
            )
        if self.found is not None:
            camera = self.found.camera
            return (
                f"camera {camera.height_m:.2f} m above the floor, tilt {math.degrees(camera.tilt_rad):.1f}, roll "
                f"{math.degrees(camera.roll_rad):.1f} degrees, focal length {camera.focal_px:.0f} px, lens "
                f"{camera.lens}, error {self.found.error:.3f}"
            )
        return ""
