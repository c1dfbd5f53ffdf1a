"""Foreground by time-adaptive per-pixel mixtures of Gaussians in colour and depth (TAPPMOG)."""

from __future__ import annotations

import math

import cv2
import numpy as np

from calib.carried import Carried
from calib.images import as_grey
from calib.types import F32, U8, AnyArray
from planview.foreground import _kernels as kernels
from planview.foreground.gain import Exposure, GainFinder
from planview.foreground.params import FOREGROUND, NO_FEEDBACK, SHADOW, ForegroundParams

BODY_M = 0.5
"""Least distance of people from the background: a step from a wall [m]."""
DARK_LEVEL = 20.0
"""Luma of the image (0-255) below which chroma is noise and only luma and depth are compared. Our choice: chroma
quantised to 1 level is then worse than 5 % of the signal."""
CLIP_LEVEL = 250.0
"""Luma of the image (0-255) at which the sensor saturates: a brighter surface looks the same. Our choice: a little
below 255, for compression noise."""
DISPARITY_NOISE_PX = 0.25
"""Smallest standard deviation of disparity [px]; in disparity a matcher's errors are the same all over the image."""
ACTIVITY_S = 1.0
"""Time constant of the mean change of luma [s]. Our choice: about one fidget."""
ACTIVITY_LEVEL = 5.0
"""Mean |Y_t - Y_(t-1)| above which a pixel is active (levels of 255). Our choice: noise of 3 levels gives 3.4."""
SAMPLED = 4
"""Step of the rows and columns sampled to see whether a frame shows anything."""
SHOWN_MIN = 0.6
DEPTH_MIN = 0.33
LIT_MIN = 0.5
"""Least parts of the usual shares of pixels: explained by the background, with depth to be compared with that of the
background, and neither dark nor saturated."""
EDGE_NOISE = 3.0
EDGES_MIN = 50
SHARP_MIN = 0.5
"""Neighbours whose luma differs by more than this many deviations of its noise are an edge; fewer edges of a background
do not show whether an image is sharp; least part of their usual share that a sharp image shows."""
COVER_S = 0.15
"""Time in which somebody who comes near covers the rest of the first share [s]."""
BACK_MIN = 0.9
"""Replaces SHOWN_MIN while the camera moves: with more than this it is back in its place."""
DAMAGE_S = 3.0
"""Longer than this no frames are damaged: the view or the light is another one [s]."""
GREY_LEVELS = 8
GREY_SHARE = 0.002
"""Channels that differ by no more, but in this share of the pixels, are an image without colour [levels of 255]."""
TURNS_MAX = 4
"""Turns in which pixels learn, at most."""
TURN_S = 0.13
"""Each pixel learns about so often [s]: video at 30 frames per second teaches no more than at 7, and costs a fraction
where only every fourth frame is written back to memory."""


class Foreground(Carried):
    """Separates what is not background, learned while watching; a fixed camera is assumed.

    Feedback (optional) is an (H, W) uint8 mask of a tracker's labels of the *current* image: NO_FEEDBACK, PERSON
    (learns nothing) or BACKGROUND (learns within settle_s); Harville 2002, ECCV.
    """

    CARRIED = (
        "shadow", "shows", "_model", "_exposure", "_rebased", "_first_s", "_now_s", "_learned_s", "_frame", "_usual",
        "_shown_s", "sharp", "_usual_edges", "_sharp_s",
    )  # fmt: skip
    RECORDS = kernels.PixelMixtures, Exposure

    def __init__(
        self,
        params: ForegroundParams,
        shape: tuple[int, int],
        disparity_noise_per_px2: float = 0.0,
        reduction: int = 1,
        disparity_metre: float = 1e-3,
    ) -> None:
        """Start without a background.

        Args:
            shape: (height, width) of all images.
            disparity_noise_per_px2: growth of the smallest disparity deviation with squared disparity [1/px], as a
                depth deviation that is the same at all depths has it; 0 for triangulated depth.
            disparity_metre: disparity of one metre [px m]; by default so small that depth always separates bodies.
            reduction: images and disparities are every ``reduction``-th row and column of those matched.
        Raises:
            ValueError: an empty shape.
        """
        if min(shape) < 1:
            raise ValueError(f"expected a positive image size, got {shape}")
        self.params = params
        self._noise_per_px2 = disparity_noise_per_px2
        self._body_over_metre = BODY_M / disparity_metre
        self.shape = shape
        self._reduction = reduction
        self._model = kernels.PixelMixtures(
            np.zeros((params.gaussians, *shape), kernels.GAUSSIAN),
            np.zeros(shape, np.float32),
            np.zeros(shape, np.float32),
        )
        self._gain = GainFinder(shape, CLIP_LEVEL, 3 * params.luma_noise)
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next image starts a new background."""
        self.shadow = np.zeros(self.shape, np.uint8)
        """(H, W) uint8, 255 where the last update removed a shadow by its colour."""
        for array in self._model:
            array[:] = 0
        self._first_s = self._now_s = math.nan
        self._learned_s = np.zeros(TURNS_MAX)
        self._frame = 0
        self._exposure = self._rebased = Exposure()
        self.shows = True
        """True if the last image showed anything that is known: else nothing was learned from it."""
        self._usual = (0.0, 0.0, 0.0)
        self._shown_s = math.nan
        self.sharp = True
        """True if the last image showed the edges of the background: else colours of bodies and background mix."""
        self._usual_edges = 0.0
        self._sharp_s = math.nan

    @property
    def is_settled(self) -> bool:
        """True if the start is over, during which every observation counts alike."""
        return self._now_s - self._first_s > self.params.settle_s

    def update(
        self, image: U8, disparity: F32 | None, timestamp_s: float, feedback: U8 | None = None, steady: bool = True
    ) -> U8:
        """Learn from one frame and separate its foreground; see ``shows``.

        Args:
            image: (H, W) grey or (H, W, 3) BGR uint8.
            disparity: (H, W) float32 [px], NaN where there is none; None without depth.
            timestamp_s: time of the frame [s]; a gap counts as at most one second of learning.
            feedback: (H, W) uint8, see the class.
            steady: False while the camera is known to move.
        Returns:
            (H, W) uint8, 255 foreground, 0 background. The first frame has no foreground.
        Raises:
            ValueError: an array of another shape or type.
        """
        image = self._require_image(image)
        is_first = math.isnan(self._first_s)
        frame = kernels.FrameArrays(
            image,
            self._require(disparity if self.params.depth else None, np.nan, np.float32, "disparity"),
            self._require(feedback, NO_FEEDBACK, np.uint8, "feedback"),
        )
        if not is_first:
            before = self._exposure
            self._exposure = self._gain(self._model.gaussians[0], image, self._exposure)
            self.shows = self._judge(frame, timestamp_s, steady)
            if not self.shows:
                # Of a background that was forgotten, the exposure is too.
                self._exposure = Exposure() if math.isnan(self._first_s) else before
                self.shadow[:] = 0
                return np.zeros(self.shape, np.uint8)
            self._rebase()
            is_first = math.isnan(self._first_s)
        self._shown_s = timestamp_s
        self._look_for_edges(image, timestamp_s)
        mask: U8 = np.empty(self.shape, np.uint8)
        kernels.update(self._model, frame, mask, self._constants(), self._rates(timestamp_s))
        if is_first:
            return np.zeros_like(mask)
        # Single pixels are noise, and single holes too.
        mask = np.asarray(cv2.medianBlur(mask, 3), dtype=np.uint8)
        if self.params.remove_colour_shadows:
            self.shadow = np.asarray(cv2.inRange(mask, SHADOW, SHADOW), dtype=np.uint8)
            mask[self.shadow > 0] = 0
        if disparity is None:
            return mask
        return self._without_fattening(mask)

    def _judge(self, frame: kernels.FrameArrays, timestamp_s: float, steady: bool) -> bool:
        """True if a frame shows nearly as much as usual of what the background can be compared with.

        No person covers the rest of the view, or takes the depth of it, from one frame to the next. What lasts is no
        damage but another light, or another view, which begins a new background.
        """
        if not steady and not self.is_settled:  # what has been learned is of another view
            self.reset()
            return False
        n, lit, shown, compared = kernels.count_shown(self._model, frame, self._constants(), SAMPLED)
        shares = shown / max(lit, 1), compared / n, lit / n
        gap_s = timestamp_s - self._shown_s
        covered = SHOWN_MIN ** max(1.0, gap_s / COVER_S) if self.shows else SHOWN_MIN
        least = covered if steady else BACK_MIN, DEPTH_MIN, LIT_MIN
        if self.is_settled and any(now < a * usual for now, a, usual in zip(shares, least, self._usual, strict=True)):
            if not steady or gap_s < DAMAGE_S:
                return False
            if shares[0] < 0.5 * self._usual[0]:
                self.reset()
        if steady:
            self._usual = shares
        return True

    def _look_for_edges(self, image: U8, timestamp_s: float) -> None:
        """Judge whether a (H, W, 1 or 3) image is sharp: where the background has an edge it has half of one, nearly
        as often as usual. What stays blurred for longer than damage lasts is another focus."""
        rows = np.ascontiguousarray(image[::SAMPLED])
        edge = EDGE_NOISE * self.params.luma_noise
        luma = as_grey(rows if image.shape[2] == 3 else rows[..., 0])
        there = np.abs(np.diff(self._model.gaussians["y"][0, ::SAMPLED], axis=1)) > edge
        here = cv2.absdiff(luma[:, 1:], luma[:, :-1]) > 0.5 * edge * self._exposure.gain
        edges = np.count_nonzero(there)
        shown = np.count_nonzero(there & here) / edges if edges >= EDGES_MIN else 1.0
        self.sharp = not shown < SHARP_MIN * self._usual_edges or timestamp_s - self._sharp_s > DAMAGE_S
        if self.sharp:
            self._usual_edges = shown
            self._sharp_s = timestamp_s

    def _without_fattening(self, mask: U8) -> U8:
        """Foreground as 255, without what has the background's colour next to a foreground of another colour.

        A matcher that smooths carries the disparity of an outline on over the plain wall behind it (foreground
        fattening, Scharstein and Szeliski 2002).
        """
        reach = self.params.fattening_px // self._reduction
        left, top, width, height = cv2.boundingRect(mask)
        inside = mask[top : top + height, left : left + width]
        kept = inside > 0
        if reach and inside.size:
            other = inside == FOREGROUND
            around = cv2.dilate(other.view(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
            kept &= other | (around == 0)
        np.multiply(kept, np.uint8(FOREGROUND), out=inside)
        return mask

    def background_luma(self) -> U8:
        """(H, W) uint8 luma of the most common background, as the current exposure shows it; zeros before an update."""
        gain, offset = map(np.float32, self._exposure)
        levels = self._model.gaussians["y"][0] * gain + offset
        return np.asarray(np.rint(np.clip(levels, 0.0, 255.0)), np.uint8)

    def background_disparity(self) -> F32:
        """(H, W) float32 [px], of the most common background; NaN where it has no depth, and before an update."""
        leader = self._model.gaussians[0]
        has_depth = (leader["depth_fraction"] >= np.float32(self.params.min_depth_fraction)) & (leader["d"] > 0)
        return np.where(has_depth, leader["d"], np.float32(np.nan))

    def _require_image(self, image: U8) -> U8:
        """(H, W, 1) of an image without colour, else (H, W, 3)."""
        if image.dtype != np.uint8 or image.shape[:2] != self.shape or image.shape[2:] not in ((), (1,), (3,)):
            raise ValueError(f"expected a {self.shape} uint8 image, grey or BGR, got {image.shape} {image.dtype}")
        image = np.ascontiguousarray(image).reshape(*self.shape, -1)
        if image.shape[2] == 1:
            return image
        planes = np.ascontiguousarray(image[::SAMPLED, ::SAMPLED].transpose(2, 0, 1))
        spread = planes.max(axis=0) - planes.min(axis=0)
        is_grey = np.count_nonzero(spread > GREY_LEVELS) <= GREY_SHARE * spread.size
        if is_grey:
            return np.ascontiguousarray(image[..., 1:2])
        return image

    @property
    def exposure(self) -> Exposure:
        """The camera's exposure in the last frame, relative to the first."""
        return self._rebased.after(self._exposure)

    def _rebase(self) -> None:
        gain, offset = self._exposure
        # The model moves to the exposure of the image when that differs by a factor of 2, so that noise stays
        # comparable, or by 20 levels, beyond which ratios of luma mean little.
        if 0.5 < gain < 2.0 and abs(offset) <= 20.0:
            return
        gaussians, activity, last_y = self._model
        for luma in (gaussians["y"], last_y):
            luma[:] = np.float32(gain) * luma + np.float32(offset)
        for scaled in (gaussians["u"], gaussians["v"], activity):
            scaled *= np.float32(gain)
        for name in ("var_y", "var_u", "var_v"):
            gaussians[name] *= np.float32(gain) * np.float32(gain)
        self._rebased = self.exposure
        self._exposure = Exposure()

    def _rates(self, timestamp_s: float) -> F32:
        """(TURNS_MAX, 4) float32 rates of the rows of each turn at the next frame; zeros where it is not due."""
        p = self.params
        if math.isnan(self._first_s):
            self._first_s = self._now_s = timestamp_s
            self._learned_s[:] = timestamp_s
            return np.array([[1.0, 1.0, 1.0, 0.0]] * TURNS_MAX, np.float32)
        self._frame += 1
        dt = max(timestamp_s - self._now_s, 0.0)
        self._now_s = max(timestamp_s, self._now_s)
        age_s = self._now_s - self._first_s
        n = min(max(round(TURN_S / max(dt, 1e-3)), 1), TURNS_MAX) if self.is_settled else 1
        due = np.arange(self._frame % n, TURNS_MAX, n)
        # A gap in time counts as at most this much learning [s]: what happened in it was not observed.
        dt_s = np.minimum(self._now_s - self._learned_s[due], 1.0)
        self._learned_s[due] = self._now_s
        rates = np.zeros((TURNS_MAX, 4), np.float32)
        rates[due] = -np.expm1(-np.outer(dt_s, [p.learning_rate, p.adaptation_rate, 1 / p.settle_s, 1 / ACTIVITY_S]))
        if 0 < age_s <= p.settle_s:
            rates[:, :3] = np.maximum(rates[:, :3], (dt_s / (age_s + dt_s))[:, None])
        return rates

    def _constants(self) -> kernels.Constants:
        """Constants in the exposure of the model, whose luma the image shows with a gain and an offset."""
        p = self.params
        gain, offset = self._exposure
        least = min(1.0 / gain, self._rebased.gain, 1.0)
        values = kernels.Constants(
            beta=p.beta,
            beta_relaxed=p.beta * p.depth_relaxation,
            body_over_metre=self._body_over_metre,
            min_depth_fraction=p.min_depth_fraction,
            dark=(DARK_LEVEL - offset) / gain,
            clip=(CLIP_LEVEL - offset) / gain,
            black=-offset / gain,
            clip_image=CLIP_LEVEL,
            gain=gain,
            offset=offset,
            floor_y=(p.luma_noise / gain) ** 2,
            floor_uv=(p.chroma_noise / gain) ** 2,
            least_y=(p.luma_noise * least) ** 2,
            least_uv=(p.chroma_noise * least) ** 2,
            floor_d=DISPARITY_NOISE_PX**2,
            floor_d_per_d4=self._noise_per_px2**2,
            active=ACTIVITY_LEVEL / gain,
            slow_active=1.0 / p.activity_slowdown,
            background_weight=p.background_weight,
            deepest_weight=p.deepest_weight,
            shadow_ratio=p.shadow_ratio,
            shadow_ratio_unsure=p.shadow_ratio**0.5,
            colour_shadow_ratio=p.shadow_ratio if p.remove_colour_shadows else 0.0,
        )
        return kernels.Constants._make(map(np.float32, values))

    def _require(self, array: AnyArray | None, default: float, dtype: type, name: str) -> AnyArray:
        if array is None:
            return np.full(self.shape, default, dtype)
        if array.dtype != dtype or array.shape != self.shape:
            raise ValueError(
                f"expected {name} of shape {self.shape} and type {dtype.__name__}, got {array.shape} {array.dtype}"
            )
        return np.ascontiguousarray(array)
