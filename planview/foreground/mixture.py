"""Foreground by time-adaptive per-pixel mixtures of Gaussians in colour and depth (TAPPMOG)."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import cv2
import numpy as np

from calib.types import F32, U8
from planview.foreground import _mixture_kernels as kernels
from planview.foreground._leader_kernels import (
    BLOCK,
    DEPTH_FRACTION,
    N_FIELDS,
    N_LEAD,
    D,
    UpdateConstants,
    Y,
    find_changes,
)
from planview.foreground.gain import Exposure, GainFollower
from planview.foreground.params import FOREGROUND, SHADOW, ForegroundParams

BODY_M = 0.5
"""How far before the background people are at the least: a step from a wall [m]."""
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
TURNS = 4
"""Turns in which pixels learn, at most."""
TURN_S = 0.13
"""Each pixel learns about so often [s]: video at 30 frames per second teaches no more than at 7, and costs a fraction
where only every fourth frame is written back to memory."""


class UpdateSchedule:
    """Whose turn it is to learn, and how much: blocks take turns, so that every pixel learns every TURN_S seconds."""

    def __init__(self, params: ForegroundParams) -> None:
        self._params = params
        self._first_s = self._now_s = math.nan
        self._learned_s = [math.nan] * TURNS
        self._frame = 0

    @property
    def is_new(self) -> bool:
        """Whether there was no frame yet."""
        return math.isnan(self._first_s)

    @property
    def settled(self) -> bool:
        """Whether the start is over."""
        return self._now_s - self._first_s > self._params.settle_s

    def start(self, timestamp_s: float) -> None:
        """Begin with a first frame."""
        self._first_s = self._now_s = timestamp_s
        self._learned_s = [timestamp_s] * TURNS

    def rates(self, timestamp_s: float) -> F32:
        """(TURNS, 4) float32: Rates of every turn at this frame; zeros where it is not due."""
        dt = max(timestamp_s - self._now_s, 0.0)
        self._now_s = max(timestamp_s, self._now_s)
        self._frame += 1
        age_s = self._now_s - self._first_s
        n = 1 if age_s <= self._params.settle_s else min(max(round(TURN_S / max(dt, 1e-3)), 1), TURNS)
        rates = np.zeros((TURNS, 4), np.float32)
        for turn in range(self._frame % n, TURNS, n):
            # A gap in time counts as at most this much learning [s]: what happened in it was not
            # observed.
            rates[turn] = self._rates(min(self._now_s - self._learned_s[turn], 1.0), age_s)
            self._learned_s[turn] = self._now_s
        return rates

    def _rates(self, dt: float, age_s: float) -> tuple[float, float, float, float]:
        p = self._params
        start = dt / (age_s + dt) if 0 < age_s <= p.settle_s else 0.0
        weight, mean, fast = _rate(dt * p.learning_rate), _rate(dt * p.adaptation_rate), _rate(dt / p.settle_s)
        return max(weight, start), max(mean, start), max(fast, start), _rate(dt / ACTIVITY_S)


def _rate(time_constants: float) -> float:
    """Share of the new observation after so many time constants."""
    return -math.expm1(-time_constants)


class Foreground:
    """What is not background, learned while watching; a fixed camera is assumed.

    Feedback (optional) is an (H, W) uint8 mask of what a tracker knows of the *current* image: NO_FEEDBACK, PERSON
    (learns nothing) or BACKGROUND (learns within settle_s); Harville 2002, ECCV.
    """

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
        self._noise_per_px2, self._body_over_metre = disparity_noise_per_px2, BODY_M / disparity_metre
        self.shape = shape
        self._reduction = reduction
        n = shape[0] * shape[1]
        n_blocks = -(-n // BLOCK)
        self._lead = np.zeros((n_blocks, N_LEAD * BLOCK), np.float32)
        self._rest = np.zeros(n * (params.gaussians - 1) * N_FIELDS, np.float32)
        self._mask = np.zeros(n, np.uint8)
        self._gain = GainFollower(shape, CLIP_LEVEL, 3 * params.luma_noise)
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="foreground")
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next image starts a new background."""
        self.shadow = np.zeros(self.shape, np.uint8)
        """(H, W) uint8, 255 where the last update removed a shadow by its colour."""
        self._schedule = UpdateSchedule(self.params)
        self._size = 0
        self._gain.reset()
        self._rebased = Exposure()
        self._gain_followed = False
        self._known_constants: tuple[float, float, UpdateConstants] | None = None

    @property
    def settled(self) -> bool:
        """Whether the start is over, during which every observation counts alike."""
        return self._schedule.settled

    def changed(self, image: U8, step: int) -> U8:
        """Where an image differs in colour from the background, or the background is not known: depth decides there.

        The exposure is followed here, and not again by the ``update`` that comes next.

        Args:
            image: the next one, as for ``update``.
            step: every n-th row and column is looked at.
        Returns:
            (h, w) uint8, 255 where changed, single pixels of noise among them.
        Raises:
            ValueError: an array of another shape or type.
        """
        flat = self._flat_image(image)
        self._follow_gain(flat)
        self._gain_followed = True
        out = np.empty(tuple(-(-n // step) for n in self.shape), np.uint8)
        rows = flat.reshape(self.shape[0], -1)
        find_changes(self._lead, rows, rows.shape[1] // self.shape[1], step, self._constants(), out)
        return out

    def update(
        self,
        image: U8,
        disparity: F32 | None,
        timestamp_s: float,
        feedback: U8 | None = None,
        measured: U8 | None = None,
    ) -> U8:
        """Learn from one frame and separate its foreground.

        Args:
            image: (H, W) grey or (H, W, 3) BGR uint8; the same kind all the time.
            disparity: (H, W) float32 [px], NaN where there is none; None without depth.
            timestamp_s: time of the frame [s]; a gap counts as at most one second of learning.
            feedback: (H, W) uint8, see the class.
            measured: (H, W) uint8, 0 where disparity was not looked for; there nothing is foreground, and depth is not
                learned.
        Returns:
            (H, W) uint8, 255 foreground, 0 background. The first frame has no foreground.
        Raises:
            ValueError: an array of another shape or type.
        """
        flat = self._flat_image(image)
        if not self._schedule.is_new and flat.size != self._size:
            raise ValueError(f"expected images of one kind, grey or BGR, got {image.shape} after another kind")
        self._size = flat.size
        followed, self._gain_followed = self._gain_followed, False
        disp = _flat(disparity if self.params.depth else None, self.shape, np.float32, "disparity")
        known = _flat(feedback, self.shape, np.uint8, "feedback")
        if self._schedule.is_new:
            self._schedule.start(timestamp_s)
            kernels.start_blocks(self._lead, self._rest, flat, disp, self._mask.size, self._constants())
            return np.zeros(self.shape, np.uint8)
        looked = _flat(measured, self.shape, np.uint8, "measured")
        if not followed:
            self._follow_gain(flat)
        self._run((flat, disp, known, looked, self._mask), self._constants(), self._schedule.rates(timestamp_s))
        # Single pixels are noise, and single holes too.
        mask: U8 = np.asarray(cv2.medianBlur(self._mask.reshape(self.shape), 3), dtype=np.uint8)
        if self.params.remove_colour_shadows:
            self.shadow = np.asarray(cv2.inRange(mask, SHADOW, SHADOW), dtype=np.uint8)
            mask[self.shadow > 0] = 0
        return mask if disparity is None else self._without_fattening(mask)

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
        levels = self._lead[:, Y * BLOCK : (Y + 1) * BLOCK].reshape(-1)[: self._mask.size]
        levels = levels * np.float32(self._gain.gain) + np.float32(self._gain.offset)
        return np.rint(np.clip(levels, 0.0, 255.0)).astype(np.uint8).reshape(self.shape)

    def background_disparity(self) -> F32:
        """(H, W) float32 [px], of the most common background; NaN where it has no depth, and before an update."""
        lead = self._lead.reshape(len(self._lead), N_LEAD, BLOCK)
        known = lead[:, DEPTH_FRACTION] >= np.float32(self.params.min_depth_fraction)
        disparity = np.where(known & (lead[:, D] > 0), lead[:, D], np.float32(np.nan)).reshape(-1)
        return np.asarray(disparity[: self._mask.size].reshape(self.shape), dtype=np.float32)

    def _flat_image(self, image: U8) -> U8:
        if image.dtype != np.uint8 or image.shape[:2] != self.shape or image.shape[2:] not in ((), (1,), (3,)):
            raise ValueError(f"expected a {self.shape} uint8 image, grey or BGR, got {image.shape} {image.dtype}")
        return np.ascontiguousarray(image).reshape(-1)

    @property
    def exposure(self) -> Exposure:
        """The camera's exposure in the last frame, relative to the first."""
        return self._rebased.after(Exposure(self._gain.gain, self._gain.offset))

    def _follow_gain(self, image: U8) -> None:
        self._gain.update(self._lead, image)
        # The model moves to the exposure of the image when that differs by a factor of 2, so that noise stays
        # comparable, or by 20 levels, beyond which ratios of luma mean little.
        if not 0.5 < self._gain.gain < 2.0 or abs(self._gain.offset) > 20.0:
            kernels.rebase(self._lead, self._rest, self._gain.gain, self._gain.offset)
            self._rebased = self.exposure
            self._gain.reset()

    def _run(self, pixels: tuple[U8, F32, U8, U8, U8], constants: UpdateConstants, rates: F32) -> None:
        """Update all blocks: this thread and a helper take bands until none is left; a late helper is not awaited."""
        # A thread that would share this one's core only interrupts it.
        threads = cv2.getNumThreads()
        # Bands of the image that two threads share out between them.
        limits = np.linspace(0, len(self._lead), (4 if threads > 1 else 1) + 1).astype(int).tolist()
        bands = iter(list(pairwise(limits)))

        def work() -> None:
            for first, last in bands:
                kernels.update_blocks(self._lead, self._rest, *pixels, first, last, constants, rates)

        helper = self._worker.submit(work) if threads > 1 else None
        work()
        if helper is not None and not helper.cancel():
            helper.result()

    def _constants(self) -> UpdateConstants:
        gain, offset = self._gain.gain, self._gain.offset
        if self._known_constants is None or self._known_constants[:2] != (gain, offset):
            values = _constants(self.params, gain, offset, self._noise_per_px2, self._body_over_metre)
            self._known_constants = gain, offset, UpdateConstants._make(map(np.float32, values))
        return self._known_constants[2]


def _constants(
    p: ForegroundParams, gain: float, offset: float, noise_per_px2: float, body_over_metre: float
) -> UpdateConstants:
    """In the exposure of the model, whose luma the image shows with a gain and an offset."""
    return UpdateConstants(
        beta=p.beta,
        beta_relaxed=p.beta * p.depth_relaxation,
        body_over_metre=body_over_metre,
        min_depth_fraction=p.min_depth_fraction,
        dark=(DARK_LEVEL - offset) / gain,
        clip=(CLIP_LEVEL - offset) / gain,
        black=-offset / gain,
        clip_image=CLIP_LEVEL,
        gain=gain,
        offset=offset,
        floor_y=(p.luma_noise / gain) ** 2,
        floor_uv=(p.chroma_noise / gain) ** 2,
        floor_d=DISPARITY_NOISE_PX**2,
        init_y=(2 * p.luma_noise / gain) ** 2,
        init_uv=(2 * p.chroma_noise / gain) ** 2,
        init_d=(2 * DISPARITY_NOISE_PX) ** 2,
        floor_d_per_d4=noise_per_px2**2,
        init_d_per_d4=(2 * noise_per_px2) ** 2,
        active=ACTIVITY_LEVEL / gain,
        slow_active=1.0 / p.activity_slowdown,
        background_weight=p.background_weight,
        deepest_weight=p.deepest_weight,
        shadow_ratio=p.shadow_ratio,
        shadow_ratio_unsure=p.shadow_ratio**0.5,
        colour_shadow_ratio=p.shadow_ratio if p.remove_colour_shadows else 0.0,
    )


def _flat(array: np.ndarray | None, shape: tuple[int, int], dtype: type, name: str) -> np.ndarray:
    if array is None:
        return np.zeros(0, dtype)
    if array.dtype != dtype or array.shape != shape:
        raise ValueError(f"expected {name} of shape {shape} and type {dtype.__name__}, got {array.shape} {array.dtype}")
    return np.ascontiguousarray(array).reshape(-1)
