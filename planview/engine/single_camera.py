"""One camera without depth: frames to observations (foreground and motion)."""

from __future__ import annotations

import math
from collections import deque

import cv2
import numpy as np
from pydantic import Field

from calib.errors import InputError
from calib.images import as_grey
from calib.params import Params
from calib.types import U8
from planview.checks.camera import Steadiness, Steady
from planview.checks.check import Check
from planview.foreground.blobs import find_blobs
from planview.foreground.ghosts import GhostParams, find_ghosts, find_still, find_uncovered, moved_lately
from planview.foreground.masks import BACKGROUND, PERSON, WALKER
from planview.foreground.mixture import Foreground
from planview.foreground.params import ForegroundParams
from planview.tracking.base import Observation
from stereo.recording import VideoFrame


class SingleCameraParams(Params):
    """Foreground and motion of one camera (Zhang et al. 2008, section 2)."""

    foreground: ForegroundParams = Field(
        default=ForegroundParams.model_validate(
            {"remove_colour_shadows": True, "shadow_ratio": 0.5, "luma_noise": 3.0, "chroma_noise": 1.8}
        )
    )
    """The mixture model, here without depth: shadows are removed by their colour, at most twice as dark as the ground
    (as OpenCV's MOG2 has it), since dark clothes are like deeper shadows. The least noise is that of the sensor alone:
    where colours are all there is, clothes like the wall behind must be told from it, and noise above is learned."""
    ghosts: GhostParams = GhostParams()
    """Foreground without a person: where a person of the first frames, learned as background, has left."""
    motion_level: float = Field(default=10.0, gt=0, le=255)
    """Change of luma, averaged over 3x3 pixels, between two frames that is motion (levels of 255). Our choice: 8-bit
    video has a noise of 3 to 4 levels, 1.3 in the average and 1.9 between two frames; five times that."""
    motion_interval_s: float = Field(default=0.12, gt=0, le=2)
    """Time between the two frames compared [s]; at least one frame. Our choice: a hand at 0.2 m/s moves 2.4 cm in it,
    about a pixel, whatever the frame rate."""


class SingleCamera:
    """Turns the frames of one camera into observations; ``observe`` once per frame, in order."""

    def __init__(self, params: SingleCameraParams, size: tuple[int, int], columns: int | None = None) -> None:
        """Start without a background.

        Args:
            size: (width, height) of all frames [px].
            columns: foreground and motion of so many columns are enough; wider frames are reduced by the smallest
                whole factor that does it, and averaged pixels are less noisy. None: those of the frames.
        """
        self.params = params
        self.size = size
        factor = 1 if columns is None else -(-size[0] // columns)
        self._reduced = max(1, size[0] // factor), max(1, size[1] // factor)
        shape = self._reduced[::-1]
        self._foreground = Foreground(params.foreground, shape)
        self._past: deque[tuple[float, U8]] = deque()
        self._ghosts: U8 = np.zeros(shape, np.uint8)
        self._moved_s = np.zeros(shape, np.float32)
        self._searched_s, self._first_s = -math.inf, math.nan
        self._steadiness = Steadiness()

    def reset(self) -> None:
        """Forget all frames."""
        self._forget_background()
        self._steadiness = Steadiness()

    def _forget_background(self) -> None:
        self._foreground.reset()
        self._past.clear()
        self._ghosts[:] = 0
        self._moved_s[:] = 0.0
        self._searched_s, self._first_s = -math.inf, math.nan

    def checks(self) -> list[Check]:
        """Whether the camera stands still and shows one scene, from the frames so far."""
        return self._steadiness.checks()

    def observe(self, frame: VideoFrame, feedback: U8 | None = None) -> Observation:
        """Foreground and motion of one frame; none while the camera moves and when the scene is cut.

        Args:
            frame: the next frame.
            feedback: (H, W) uint8, a tracker's labels of the frame's pixels (see ``Foreground``), or None.
        Raises:
            InputError: a frame of another size.
        """
        height, width = frame.image.shape[:2]
        if (width, height) != self.size:
            raise InputError(f"frame {frame.index}: expected {self.size[0]}x{self.size[1]} px, found {width}x{height}")
        image = self._resized(frame.image, cv2.INTER_AREA)
        grey = as_grey(image)
        steady = self._steadiness.update(frame.index, frame.timestamp_s, grey)
        if steady is Steady.BREAK:
            nothing = np.zeros(image.shape[:2], np.uint8)
            return Observation(frame.index, frame.timestamp_s, frame.image, nothing, nothing, shadow=nothing)
        if steady is not Steady.STILL:
            # The background begins anew with this frame, whatever a tracker says of the view before.
            self._forget_background()
            feedback = None
        known = self._known(feedback)
        mask = self._foreground.update(image, None, frame.timestamp_s, known)
        motion = self._motion(frame.timestamp_s, grey)
        if math.isnan(self._first_s):
            self._first_s = frame.timestamp_s
        self._search_ghosts(frame.timestamp_s, grey, mask, motion, feedback)
        if cv2.countNonZero(self._ghosts):
            mask &= ~self._ghosts
        return Observation(frame.index, frame.timestamp_s, frame.image, mask, motion, shadow=self._foreground.shadow)

    def _search_ghosts(self, now_s: float, grey: U8, mask: U8, motion: U8, feedback: U8 | None) -> None:
        """Where people of the first frames have left: from time to time, and in every frame while they set out."""
        params = self.params.ghosts
        starting = now_s - self._first_s <= params.start_s
        if not starting and now_s - self._searched_s < params.interval_s - 5e-4:
            return
        self._searched_s = now_s
        background = self._foreground.background_luma()
        blobs = find_blobs(mask)
        self._ghosts = find_ghosts(grey, background, blobs, motion, params)
        if starting:
            self._ghosts |= find_uncovered(grey, background, mask, params)
            moved = moved_lately(motion, now_s - self._first_s, params.still_s, self._moved_s)
            self._ghosts |= find_still(blobs, moved, params)
        if feedback is not None:
            np.copyto(self._ghosts, np.uint8(0), where=self._resized(feedback, cv2.INTER_NEAREST) == WALKER)

    def _resized(self, image: U8, interpolation: int) -> U8:
        if self._reduced == self.size:
            return image
        return np.asarray(cv2.resize(image, self._reduced, interpolation=interpolation), dtype=np.uint8)

    def _known(self, feedback: U8 | None) -> U8 | None:
        """What the tracker and the search for ghosts know of the reduced frame's pixels.

        Ghosts are background even where a person is tracked, unless that person has been seen to walk.
        """
        haunted = cv2.countNonZero(self._ghosts) > 0
        if feedback is None and not haunted:
            return None
        known = np.zeros(self._ghosts.shape, np.uint8)
        if feedback is not None:
            known[:] = self._resized(feedback, cv2.INTER_NEAREST)
        if haunted:
            known[(self._ghosts > 0) & (known != WALKER)] = BACKGROUND
        np.copyto(known, np.uint8(PERSON), where=known == WALKER)
        return known

    def _motion(self, now_s: float, grey: U8) -> U8:
        """(H, W) uint8, 255 where the smoothed luma differs from that of motion_interval_s ago."""
        smooth = np.asarray(cv2.blur(grey, (3, 3)), dtype=np.uint8)
        # Half a millisecond of slack: time stamps are rounded.
        while len(self._past) > 1 and self._past[1][0] <= now_s - self.params.motion_interval_s + 5e-4:
            self._past.popleft()
        before = self._past[0][1] if self._past else smooth
        self._past.append((now_s, smooth))
        _, motion = cv2.threshold(cv2.absdiff(smooth, before), self.params.motion_level, 255, cv2.THRESH_BINARY)
        return np.asarray(motion, dtype=np.uint8)
