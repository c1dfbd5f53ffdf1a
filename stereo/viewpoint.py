"""Whether cameras still look where they looked before: corners of the background, followed in every image.

People hide some corners, and other light loses some; what is left either stays, or moves as one picture does when its
camera rotates. The explanation that more corners bear out is taken, and none where too few are left to say.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from calib.carried import Carried
from calib.images import as_grey
from calib.types import F32, F64, U8, AnyArray
from stereo.depth import median_image

WIDTH_PX = 320
"""Images are compared at this width: noise averages out, and corners are found to a twentieth of a pixel."""
BLOCK_PX = 20
"""Side of the blocks of which each gives its strongest corner."""
CORNER_MIN = 1e-4
"""Smallest eigenvalue of the structure tensor (luma from 0 to 1, 5x5 window) of a corner that can be followed."""
STAYED_PX = 0.35
"""A corner within this distance of its place has stayed, or moved along: what noise and coding move it."""
SHOWN_SHARE = 0.2
"""Least share of the corners that must move as one before a camera has rotated: people who fill the view do not."""
STAYED_SHARE = 0.3
"""Share of the corners that stay by which a camera has without doubt."""
CORNERS_MIN = 20
"""Fewest corners that must."""
BOTH_DEG = 0.5
"""Rotation of the cameras together beyond which what they show is in a false place [degrees]: 4 cm at 5 m; a mast in
the wind sways by less."""
APART_DEG = 0.1
"""Rotation of one camera of a pair against the other [degrees]: 1 px of 640 at a usual lens, a tenth of the depth at
5 m."""
_FOLLOWED: dict[str, Any] = {
    "winSize": (11, 11),
    "criteria": (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03),
}
"""How corners are followed (pyramidal Lucas-Kanade, Bouguet 2001)."""


class Viewpoint:
    """The corners of what one camera shows, by (H, W[, 3]) uint8 images of it."""

    def __init__(self, images: Sequence[U8]) -> None:
        self._shown = median_image([_small(image) for image in images]).astype(np.uint8)
        strength = cv2.cornerMinEigenVal(self._shown.astype(np.float32) / 255.0, 5)
        rows, columns = (size // BLOCK_PX for size in strength.shape)
        whole = strength[: rows * BLOCK_PX, : columns * BLOCK_PX].reshape(rows, BLOCK_PX, columns, BLOCK_PX)
        blocks = whole.swapaxes(1, 2).reshape(rows * columns, -1)
        best, block = blocks.argmax(axis=1), np.arange(rows * columns)
        places = block % columns * BLOCK_PX + best % BLOCK_PX, block // columns * BLOCK_PX + best // BLOCK_PX
        self._corners: F32 = np.column_stack(places)[blocks.max(axis=1) >= CORNER_MIN].astype(np.float32)

    def rotation(self, image: U8, focal_px: float) -> F64 | None:
        """(3,) float64 angles [rad] to the right, down and about the optical axis by which the camera of an image has
        rotated; zeros where it has not, None where too little of the view shows. ``focal_px`` is that at ``WIDTH_PX``.
        """
        still, now, corners = np.zeros(3), _small(image), self._corners
        least = max(CORNERS_MIN, SHOWN_SHARE * len(corners))
        if len(corners) < least:
            return None
        if self._stay(now):
            return still
        there, found, _ = cv2.calcOpticalFlowPyrLK(self._shown, now, corners, corners.copy(), **_FOLLOWED)
        back, again, _ = cv2.calcOpticalFlowPyrLK(now, self._shown, there, there.copy(), **_FOLLOWED)
        known = (found[:, 0] > 0) & (again[:, 0] > 0) & (np.hypot(*(back - corners).T) < STAYED_PX)
        if known.sum() < least:
            return None
        moves, along = cv2.estimateAffinePartial2D(corners[known], there[known], ransacReprojThreshold=STAYED_PX)
        stayed = (np.hypot(*(there - corners)[known].T) < STAYED_PX).sum()
        if moves is None or along.sum() < max(least, 2 * stayed):
            return still if stayed >= least else None
        # The middle of the image moves against the camera.
        middle = 0.5 * np.array(now.shape[::-1])
        shift = (moves[:, :2] @ middle + moves[:, 2] - middle) / focal_px
        turn = math.atan2(moves[1, 0], moves[0, 0])
        return np.array([-math.atan(shift[0]), -math.atan(shift[1]), -turn])

    def _stay(self, now: U8) -> bool:
        """Whether every second corner shows, without a wide search, that the camera has not moved: so it is in nearly
        all frames, and that costs a tenth of the time."""
        corners = np.ascontiguousarray(self._corners[::2])
        there, found, _ = cv2.calcOpticalFlowPyrLK(self._shown, now, corners, corners.copy(), maxLevel=0, **_FOLLOWED)
        stayed = (found[:, 0] > 0) & (np.hypot(*(there - corners).T) < STAYED_PX)
        return bool(stayed.mean() >= STAYED_SHARE)


class Viewpoints:
    """Where the cameras of a head look: one, or the two of a pair, by shots of it."""

    def __init__(self, shots: Sequence[Sequence[AnyArray]], focal_widths: float) -> None:
        """Images are (H, W[, 3]) uint8, all rectified or all as recorded, and depth among them is passed over; the
        focal length is in widths of an image."""
        self._focal_px = focal_widths * WIDTH_PX
        self._cameras = [Viewpoint(images) for images in zip(*shots, strict=True) if images[0].dtype == np.uint8]

    def moved(self, shot: Sequence[AnyArray]) -> str | None:
        """Which camera looks elsewhere in a shot, and by how much, in words; empty where none does, None where too
        little shows to say."""
        pairs = zip(self._cameras, shot, strict=False)
        known = [turn for camera, image in pairs if (turn := camera.rotation(image, self._focal_px)) is not None]
        if not known or len(known) < len(self._cameras):
            return None
        degrees = [math.degrees(float(np.linalg.norm(turn))) for turn in known]
        if len(known) == 2 and math.degrees(float(np.linalg.norm(known[1] - known[0]))) > APART_DEG:
            return (
                f"the {'right' if degrees[1] > degrees[0] else 'left'} camera has rotated by {max(degrees):.2g} degrees"
            )
        if min(degrees) > BOTH_DEG:
            return f"the camera{'s have' if len(known) == 2 else ' has'} rotated by {degrees[0]:.2g} degrees"
        return ""


def of_one_viewpoint(shots: Sequence[Sequence[AnyArray]], focal_widths: float) -> tuple[list[int], dict[int, str]]:
    """Numbers of the shots that show the view which most of them show, and, by number, how a camera looks elsewhere in
    those that show another one. Shots that show too little to tell are in neither, unless no view but one shows."""
    groups = list[tuple[Viewpoints, list[int]]]()
    for number, shot in enumerate(shots):
        for viewpoints, members in groups:
            if viewpoints.moved(shot) == "":
                members.append(number)
                break
        else:
            groups.append((Viewpoints([shot], focal_widths), [number]))
    largest = max((members for _, members in groups), key=len, default=[])
    viewpoints = Viewpoints([shots[number] for number in largest], focal_widths)
    usual = list[int]()
    elsewhere = dict[int, str]()
    for number, shot in enumerate(shots):
        moved = "" if number in largest else viewpoints.moved(shot)
        if moved:
            elsewhere[number] = moved
        elif moved == "":
            usual.append(number)
    return (usual, elsewhere) if elsewhere else ([*range(len(shots))], {})


class Standing(Carried):
    """Follows whether the cameras of a head stand where they stood when its floor was measured.

    Attributes:
        moved_frames: in how many frames they did not.
        first: the first of these and its time [s]; None for none.
        how: what had moved in it, in words.
    """

    CARRIED = "moved_frames", "first", "how", "_is_moved"

    def __init__(self, viewpoints: Viewpoints) -> None:
        self._viewpoints = viewpoints
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self.moved_frames, self.how, self._is_moved = 0, "", False
        self.first: tuple[int, float] | None = None

    def update(self, frame: int, timestamp_s: float, shot: Sequence[AnyArray]) -> bool:
        """Whether they stand there in the next frame; where too little shows, as in the frame before."""
        moved = self._viewpoints.moved(shot)
        if moved is not None:
            self._is_moved = bool(moved)
        self.moved_frames += self._is_moved
        if self._is_moved and self.first is None:
            self.first, self.how = (frame, timestamp_s), moved or ""
        return not self._is_moved


def _small(image: U8) -> U8:
    grey = as_grey(image)
    size = WIDTH_PX, max(1, round(grey.shape[0] * WIDTH_PX / grey.shape[1]))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
