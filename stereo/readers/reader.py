"""What a reader is: it recognises one layout of recordings by content and opens it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from calib.types import F64
from stereo.readers.pair import StereoRecording
from stereo.recording import RgbdRecording

AnyRecording = StereoRecording | RgbdRecording
"""What a layout opens to."""


@dataclass(frozen=True)
class OpenOptions:
    """What the caller supplies about a recording.

    Attributes:
        calibration: calibration file or folder; found in the recording when None.
        fps: frames per second, in place of the recording's own times; None takes those.
        topics: names of the left and the right (or the image's and the depth's) topic of a bag; empty: chosen.
    """

    calibration: Path | None = None
    fps: float | None = None
    topics: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Stream:
    """One camera of a recording, as it was stored.

    Attributes:
        name: "left", "right", "depth", or a topic.
        size: (width, height) [px].
        n_frames: images that are there.
        times_s: (n_frames,) float64 [s] since the recording's first stamp, in order; None without stamps of its own.
        pixels: what a pixel is, e.g. "grey", "colour", "12 bits grey in 16".
    """

    name: str
    size: tuple[int, int]
    n_frames: int
    times_s: F64 | None = None
    pixels: str = ""


class Layout(Protocol):
    """What a reader found at a path; nothing is decoded yet but a first image of each camera.

    Attributes:
        kind: images of two cameras, or images with depth.
        streams: the cameras.
        n_frames: frames announced (an upper bound).
        fps: nominal frames per second.
        unpaired: frames that one of the cameras lacks.
        notes: what the reader assumed, mended or missed, a sentence each, for the summary and run.json.
    """

    @property
    def kind(self) -> Literal["stereo", "rgbd"]: ...

    @property
    def streams(self) -> tuple[Stream, ...]: ...

    @property
    def n_frames(self) -> int: ...

    @property
    def fps(self) -> float: ...

    @property
    def unpaired(self) -> int: ...

    @property
    def notes(self) -> tuple[str, ...]: ...

    def open(self) -> AnyRecording:
        """The recording with its calibration.

        Raises:
            InputError: no calibration there, or one that does not fit.
        """


@dataclass(frozen=True)
class Reader:
    """One layout of recordings.

    Attributes:
        key: short name, for ``check --quick --json``.
        name: as messages show it.
        looks_for: what makes a path this layout, for the sentence that lists what was looked for.
        fits: whether a path looks like it; reads names and first bytes only, and never raises InputError.
        find: what is there; raises InputError when it looked like it but cannot be read.
    """

    key: str
    name: str
    looks_for: str
    fits: Callable[[Path], bool]
    find: Callable[[Path, OpenOptions], Layout]
