"""Views of cameras, compared with those before.

A view is the same, another one, or not known. Corners of the background are followed from image to image: people hide
some, other light loses some, and the others stay or move as one picture does when its camera rotates or zooms. An image
that shows too little of the view is compared with the image before, so that a scene may change bit by bit. A rotation
that lasts is a move; one that comes and goes about one mean is shaking, in which the view is still usable as long as
the rotation is small.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

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
WINDOW_PX = 11
"""Side of what is compared around a corner."""
LIGHT_PX = 31
"""Side of the surroundings whose light is taken out in a wide search: smooth shapes stay."""
LEVEL_NOISE = 4.0
"""Deviation of luma that is noise as much as texture [levels of 255]."""
STAYED_PX = 0.35
"""A corner within this distance of its place has stayed, or moved along: what noise and coding move it."""
SHOWN_SHARE = 0.2
"""Least share of the corners that must move as one before a camera has rotated: people who fill the view do not."""
STAYED_SHARE = 0.3
"""Share of the corners that stay by which a camera has without doubt."""
CORNERS_MIN = 20
"""Fewest corners that must."""
TEXTURED_SHARE = 0.5
"""Least share of the blocks that must have a corner for an image to show a view: on a plain wall all texture is
people's, and light or a cover hides most of a view."""
BOTH_DEG = 0.5
"""Rotation of the cameras together beyond which what they show is in a false place [degrees]: 4 cm at 5 m; a mast in
the wind sways by less."""
SWAY_DEG = 1.0
"""Rotation of the cameras together from which an image cannot be compared with the usual one, whether it lasts or not
[degrees]: 9 cm at 5 m, and the edges of the background show as people."""
APART_DEG = 0.1
"""Rotation of one camera of a pair against the other [degrees]: 1 px of 640 at a usual lens, a tenth of the depth at
5 m."""
LOOK_S = 0.25
"""Time between two comparisons [s]."""
CHANGED_LUMA = 8
"""Least change of luma at a corner of a camera that may have rotated since the last comparison [levels of 255]."""
CHANGED_SHARE = 0.3
"""Share of the corners that change by that: half a degree changes a third of them, in any real room that we have."""
LASTING_S = 1.0
"""Time over which rotations are averaged, and in which a view stands still that has settled [s]: masts shake faster."""
HIDDEN_S = 3.0
"""Time for which nothing of a view shows, but something that stands still, after which it is another one [s]: people
close to a camera do not stand as still, and it adapts to light sooner."""
ROUNDED_S = 5e-4
"""Slack of intervals [s]: time stamps are rounded."""
UNREST_DEG = 0.25
"""A view in which nothing rotates by more stands still [degrees]."""
LOOKS_MIN = 3
"""Fewest comparisons that are averaged."""
NEAR_SHOTS = 2
"""Shots before and after one, of those spread over a recording, with which its rotation is averaged."""
_FOLLOWED: dict[str, Any] = {
    "winSize": (WINDOW_PX, WINDOW_PX),
    "criteria": (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03),
}
"""Settings for following corners (pyramidal Lucas-Kanade, Bouguet 2001)."""


class Viewpoint:
    """The corners of what one camera shows, by (H, W[, 3]) uint8 images of it.

    Attributes:
        is_textured: there are corners all over the image.
    """

    def __init__(self, images: Sequence[U8]) -> None:
        shown = median_image([_small(image) for image in images]).astype(np.uint8)
        self._shown = _even(shown, LIGHT_PX)
        self._details = _even(shown, WINDOW_PX)
        strength = cv2.cornerMinEigenVal(shown.astype(np.float32) / 255.0, 5)
        rows, columns = (size // BLOCK_PX for size in strength.shape)
        whole = strength[: rows * BLOCK_PX, : columns * BLOCK_PX].reshape(rows, BLOCK_PX, columns, BLOCK_PX)
        blocks = whole.swapaxes(1, 2).reshape(rows * columns, -1)
        row, column = np.divmod(np.arange(len(blocks)), columns)
        down, across = np.divmod(blocks.argmax(axis=1), BLOCK_PX)
        corners = np.column_stack([column * BLOCK_PX + across, row * BLOCK_PX + down])
        textured = blocks.max(axis=1) >= CORNER_MIN
        self.is_textured = float(textured.mean()) >= TEXTURED_SHARE
        self._corners: F32 = corners[textured].astype(np.float32)
        self._least = max(CORNERS_MIN, SHOWN_SHARE * len(self._corners))

    def turn(self, image: U8, focal_px: float) -> F64 | None:
        """(4,) float64 angles [rad] about its x, y and z axis by which the camera of an image has rotated, and the
        logarithm of its zoom; zeros where it has not moved, None where too little of the view shows.

        ``focal_px``: focal length in an image of width ``WIDTH_PX``.
        """
        if len(self._corners) < self._least:
            return None
        small = _small(image)
        if self._stays(_even(small, WINDOW_PX)):
            return np.zeros(4)
        now = _even(small, LIGHT_PX)
        turn = self._follow(now, focal_px, np.zeros(2))
        if turn is None:
            window = cv2.createHanningWindow(now.shape[::-1], cv2.CV_32F)
            shift, _ = cv2.phaseCorrelate(self._shown.astype(np.float32), now.astype(np.float32), window)
            turn = self._follow(now, focal_px, np.array(shift))
        return turn

    def may_have_turned(self, before: U8, now: U8) -> bool:
        """True if so many corners have changed between two images of width ``WIDTH_PX`` that ``turn`` is worth its
        time."""
        columns, rows = self._corners.astype(np.intp).T
        changes = cv2.absdiff(before, now)[rows, columns]
        return bool((changes > CHANGED_LUMA).sum() > CHANGED_SHARE * len(changes))

    def _stays(self, now: U8) -> bool:
        """True if every second corner shows, without a wide search, that the camera has not moved."""
        corners = np.ascontiguousarray(self._corners[::2])
        there, is_there, _ = cv2.calcOpticalFlowPyrLK(
            self._details, now, corners, corners.copy(), maxLevel=0, **_FOLLOWED
        )
        stayed = (is_there[:, 0] > 0) & (_apart(there, corners) < STAYED_PX)
        return bool(stayed.mean() >= STAYED_SHARE)

    def _follow(self, now: U8, focal_px: float, shift_px: F64) -> F64 | None:
        """``turn``, from where the corners are that moved by about a shift."""
        corners = self._corners
        guess = shift_px.astype(np.float32)
        how: dict[str, Any] = _FOLLOWED | {"flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
        there, is_there, _ = cv2.calcOpticalFlowPyrLK(self._shown, now, corners, corners + guess, **how)
        back, is_back, _ = cv2.calcOpticalFlowPyrLK(now, self._shown, there, there - guess, **how)
        followed = (is_there[:, 0] > 0) & (is_back[:, 0] > 0) & (_apart(back, corners) < STAYED_PX)
        if followed.sum() < self._least:
            return None
        corners = corners[followed]
        there = there[followed]
        homography, along = cv2.findHomography(corners, there, cv2.RANSAC, STAYED_PX)
        stayed = (_apart(there, corners) < STAYED_PX).sum()
        if homography is None or along.sum() < max(self._least, 2 * stayed):
            return np.zeros(4) if stayed >= self._least else None
        height, width = now.shape
        pinhole = np.array([[focal_px, 0.0, 0.5 * width], [0.0, focal_px, 0.5 * height], [0.0, 0.0, 1.0]])
        return _turn_of(np.linalg.inv(pinhole) @ homography @ pinhole)


def _apart(points: AnyArray, others: AnyArray) -> F64:
    """(N,) distances of (N, 2) points from others."""
    return np.asarray(np.hypot(*(points - others).T))


def _turn_of(moved: AnyArray) -> F64:
    """``Viewpoint.turn`` of the homography of rays, (3, 3), by which the picture has moved."""
    moved = moved / moved[2, 2]
    middle = moved[:2, 2]
    around = moved[:2, :2] - np.outer(middle, moved[2, :2])  # derivative in the middle
    roll = math.atan2(around[1, 0] - around[0, 1], around[0, 0] + around[1, 1])
    zoom = 0.5 * math.log(max(float(np.linalg.det(around)), 1e-6))
    # The picture moves against the camera.
    return np.array([math.atan(middle[1]), -math.atan(middle[0]), -roll, zoom])


class Viewpoints:
    """Views of the cameras of a sensor: one, or the two of a pair, by shots of it; none without shots.

    Attributes:
        cameras: of each the corners.
    """

    def __init__(self, shots: Sequence[Sequence[AnyArray]], focal_widths: float) -> None:
        """Images are (H, W[, 3]) uint8, all rectified or all as recorded; the focal length is in widths of
        an image."""
        self.focal_widths = focal_widths
        self.cameras = [Viewpoint(images) for images in zip(*shots, strict=True)]

    @property
    def are_textured(self) -> bool:
        """True if every camera shows corners all over its image."""
        return all(camera.is_textured for camera in self.cameras)

    def turns(self, shot: Sequence[AnyArray]) -> F64 | None:
        """(cameras, 4) float64 ``Viewpoint.turn`` of the images of a shot; None where one of them shows too little."""
        turns = list[F64]()
        for camera, image in zip(self.cameras, shot, strict=False):
            turn = camera.turn(image, self.focal_widths * WIDTH_PX)
            if turn is None:
                return None
            turns.append(turn)
        return np.array(turns)


class Sway(NamedTuple):
    """Rotation of a sensor to and fro [degrees]: its cameras together, and one against the other."""

    together_deg: float = 0.0
    apart_deg: float = 0.0

    @staticmethod
    def of(turns: F64) -> Sway:
        """Sway of (cameras, 4) turns about none."""
        together = np.linalg.norm(turns.mean(axis=0))
        apart = np.linalg.norm(turns[-1] - turns[0])
        return Sway(math.degrees(float(together)), math.degrees(float(apart)))

    @staticmethod
    def of_three(before: F64, between: F64, after: F64) -> Sway:
        """Sway of turns that follow each other about a line: even motion counts as none."""
        return Sway.of((before - 2.0 * between + after) / math.sqrt(6.0))

    def move(self, mean: F64, now: F64) -> str:
        """Sentence on which camera looks elsewhere and by how much now, from (cameras, 4) turns now and their mean over
        a time; empty where the mean is no more than the sensor sways."""
        turned = Sway.of(mean)
        if turned.apart_deg > APART_DEG + self.apart_deg:
            side = int(np.argmax(np.linalg.norm(mean, axis=1)))
            return f"the {('left', 'right')[side]} camera has {_turn_words(now[side])}"
        if turned.together_deg > min(BOTH_DEG + self.together_deg, SWAY_DEG):
            return f"the camera{'s have' if len(now) == 2 else ' has'} {_turn_words(now[0])}"
        return ""


def _turn_words(turn: F64) -> str:
    angle = float(np.linalg.norm(turn[:3]))
    if abs(turn[3]) > angle:
        return f"zoomed by {abs(math.expm1(turn[3])):.1%}"
    return f"rotated by {math.degrees(angle):.2g} degrees"


def _another_view(cameras: int) -> str:
    return "the cameras show another view" if cameras == 2 else "the camera shows another view"


class SpreadView(NamedTuple):
    """Views of the cameras of a recording, from shots that are spread over it.

    Attributes:
        shots: how many there are.
        usual: numbers of the shots with the view that most of them show.
        elsewhere: by number, how a camera looks elsewhere in those that show another view which lasts. Shots that show
            too little are in neither, unless no view but one shows.
        sway: how far the view comes and goes.
    """

    shots: int
    usual: list[int]
    elsewhere: dict[int, str]
    sway: Sway


STANDS = Sway()
"""Sway of cameras that stand still."""


def view_of_most(shots: Sequence[Sequence[AnyArray]], focal_widths: float) -> SpreadView:
    """The view that most of some shots show; arguments are those of ``Viewpoints``."""
    groups = list[tuple[Viewpoints, list[int]]]()
    for number, shot in enumerate(shots):
        for viewpoints, members in groups:
            turns_of = viewpoints.turns(shot)
            if turns_of is not None and not STANDS.move(turns_of, turns_of):
                members.append(number)
                break
        else:
            groups.append((Viewpoints([shot], focal_widths), [number]))
    largest = max((members for _, members in groups), key=len, default=[])
    viewpoints = Viewpoints([shots[number] for number in largest], focal_widths)
    everything = [*range(len(shots))]
    seen = dict[int, F64]()
    for number in everything:
        turns_of = viewpoints.turns(shots[number])
        if turns_of is not None:
            seen[number] = turns_of
    if len(seen) < 3:
        return SpreadView(len(shots), everything, {}, STANDS)
    elsewhere = dict[int, str]()
    for other, members in groups:
        lasts = len(members) > NEAR_SHOTS and other.are_textured
        if lasts and seen.keys().isdisjoint(members):
            elsewhere |= dict.fromkeys(members, _another_view(len(other.cameras)))
    turns = np.stack([*seen.values()])
    means = np.stack([turns[max(0, k - NEAR_SHOTS) : k + NEAR_SHOTS + 1].mean(axis=0) for k in range(len(turns))])
    sways = [Sway.of_three(*three) for three in zip(turns, turns[1:], turns[2:], strict=False)]
    sway = Sway(*np.quantile(sways, 0.5, axis=0, method="lower").tolist())
    usual = list[int]()
    for (number, now), mean in zip(seen.items(), means, strict=True):
        if not sway.move(now, now):
            usual.append(number)
        elif how := sway.move(mean, now):
            elsewhere[number] = how
    return SpreadView(len(shots), usual if elsewhere else everything, elsewhere, sway)


class Standing(Carried):
    """Follows whether the cameras of a sensor look where they looked at first, or when their floor was measured.

    Attributes:
        moved_frames: in how many frames they did not.
        first: the first of these and its time [s]; None for none.
        how: what had moved in it, in words.
        swayed_frames: in how many others they had swayed by ``SWAY_DEG`` and were not back within ``BOTH_DEG``.
    """

    CARRIED = (
        "moved_frames", "swayed_frames", "first", "how", "_is_moved", "_is_still", "_sways", "_looked_s", "_last",
        "_compared", "_turns", "_since_s", "_is_linked", "_sway", "_accepted",
    )  # fmt: skip

    def __init__(self, viewpoints: Viewpoints) -> None:
        """Start with the view of some viewpoints; without cameras with the first view that two shots show."""
        self._given = viewpoints
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self.moved_frames = 0
        self.swayed_frames = 0
        self.first: tuple[int, float] | None = None
        self.how = ""
        self._is_moved = False
        self._is_still = False  # for LASTING_S
        self._looked_s = -math.inf
        self._sways = False
        self._last: list[U8] = []  # of the last look
        self._compared: list[U8] = []  # last
        self._turns: deque[tuple[float, F64]] = deque()
        self._since_s = 0.0  # since when turns go on
        self._is_linked = True  # turns are from the usual view, by images in between; else from the first of another
        self._sway = np.zeros(3)  # of the squares of the deviations, and their number
        self._accepted: list[U8] = []
        self._viewpoints = self._given

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Continue from a state, with the view that was accepted in it."""
        super().set_state(state)
        self._viewpoints = self._of(self._accepted) if self._accepted else self._given

    @property
    def sway(self) -> Sway:
        """Sway of the view so far."""
        return Sway(*np.sqrt(self._sway[:2] / max(self._sway[2], 1.0)).tolist())

    @property
    def is_settled(self) -> bool:
        """True if another view than the usual one has stood still for LASTING_S."""
        return self._is_moved and self._is_still

    def update(self, frame: int, timestamp_s: float, shot: Sequence[AnyArray]) -> bool:
        """True if they look there in the next frame; where too little shows, as in the frame before."""
        images = [_small(image) for image in shot]
        if timestamp_s >= self._looked_s + LOOK_S - ROUNDED_S:
            self._looked_s = timestamp_s
            how = self._look(timestamp_s, images)
            if how is not None and bool(how) != self._is_moved:
                self._is_moved = bool(how)
                self._turns = deque([*self._turns][-1:] * LOOKS_MIN)
            if how and self.first is None:
                self.first, self.how = (frame, timestamp_s), how
        elif any(map(Viewpoint.may_have_turned, self._viewpoints.cameras, self._compared, images)):
            self._watch_for_sway(images, self._viewpoints.turns(images))
        if self._is_moved:
            self.moved_frames += 1
            return False
        self.swayed_frames += self._sways
        return not self._sways

    def _watch_for_sway(self, images: list[U8], turns: F64 | None) -> None:
        """Judge how far the view is from the usual one, by the turns of some images from it."""
        self._compared = images
        if turns is None:
            return
        together_deg = Sway.of(turns).together_deg
        if together_deg >= SWAY_DEG:
            self._sways = True
        elif together_deg < BOTH_DEG:
            self._sways = False

    def accept(self) -> None:
        """Take the view of the last look for the usual one."""
        self._accepted = self._last
        self._viewpoints = self._of(self._last)
        self._turns.clear()
        self._is_moved = self._is_still = False
        self._sways = False

    def _look(self, now_s: float, images: list[U8]) -> str | None:
        """Sentence on how the view of some images is another one, empty where it is the usual one, None where that
        cannot be said."""
        before, self._last = self._last, images
        if not self._viewpoints.cameras:
            return self._first_view(before, images)
        turns = self._viewpoints.turns(images)
        self._watch_for_sway(images, turns)
        is_linked = turns is not None
        if turns is None and self._turns:
            step = self._of(before).turns(images)
            if step is not None:
                turns = self._turns[-1][1] + step
                is_linked = self._is_linked
        is_new = turns is None or is_linked != self._is_linked or not self._turns
        self._is_linked = is_linked
        if turns is None:
            turns = np.zeros((len(images), 4))
        if is_new:
            # As if there had been looks before, of the view so far.
            assumed = turns if self._is_moved else np.zeros_like(turns)
            self._turns = deque([(now_s, assumed)] * (LOOKS_MIN - 1))
            self._since_s = now_s
        self._turns.append((now_s, turns))
        mean = np.mean([each for _, each in self._turns], axis=0)
        self._forget_old(now_s)
        shown_s = now_s - self._turns[0][0] + ROUNDED_S
        unrest_deg = max(Sway.of(each - mean).together_deg for _, each in self._turns)
        self._is_still = shown_s >= LASTING_S and unrest_deg < UNREST_DEG
        if is_linked:
            return self.sway.move(mean, turns)
        if self._is_still and now_s - self._since_s >= HIDDEN_S - ROUNDED_S and self._of(images).are_textured:
            return _another_view(len(images))
        return None

    def _first_view(self, before: list[U8], images: list[U8]) -> str | None:
        """Take the view of two shots between which nothing has moved; else as ``_look``."""
        viewpoints = self._of(before)
        turns = viewpoints.turns(images)
        if not before or turns is None or not viewpoints.are_textured:
            return None
        how = STANDS.move(turns, turns)
        if not how:
            self.accept()
        return how

    def _of(self, images: list[U8]) -> Viewpoints:
        return Viewpoints([images], self._given.focal_widths)

    def _forget_old(self, now_s: float) -> None:
        """Forget turns of more than LASTING_S ago; those of the usual view show how far it sways."""
        while len(self._turns) > LOOKS_MIN and self._turns[1][0] <= now_s - LASTING_S + ROUNDED_S:
            (_, before), (_, between), (_, after), *_ = self._turns
            self._turns.popleft()
            if self._is_linked and not self._is_moved:
                self._sway += [*np.square(Sway.of_three(before, between, after)), 1.0]


def _small(image: U8) -> U8:
    grey = as_grey(image)
    size = WIDTH_PX, max(1, round(grey.shape[0] * WIDTH_PX / grey.shape[1]))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _even(image: U8, side_px: int) -> U8:
    """(H, W) uint8, less its mean around each pixel, over its deviation there: the same in another light."""
    window = side_px, side_px
    levels = image.astype(np.float32)
    levels -= cv2.blur(levels, window)
    deviations = np.sqrt(np.maximum(cv2.blur(levels * levels, window), 0.0)) + np.float32(LEVEL_NOISE)
    return np.asarray(np.clip(128.0 + 40.0 * levels / deviations, 0.0, 255.0), dtype=np.uint8)
