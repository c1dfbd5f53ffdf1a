"""Foreground by time-adaptive per-pixel mixtures of Gaussians in colour and depth (TAPPMOG)."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import cv2
import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import F32, U8
from planview.foreground import _mixture_kernels as kernels
from planview.foreground._block_kernels import BLOCK, N_LEAD
from planview.foreground._gaussian_kernels import N_FIELDS, UpdateConstants, Y
from planview.foreground.gain import Exposure, GainFollower
from planview.foreground.masks import FOREGROUND, NEARER, SHADOW

REBASE_GAIN = 2.0
"""The model moves to the exposure of the image when that differs by this factor: noise stays comparable."""
REBASE_OFFSET = 20.0
"""The same for the offset [levels]: beyond it ratios of luma mean little."""
BANDS = 4
"""Bands of the image that two threads share out between them."""
TURNS = 4
"""Turns in which pixels learn, at most."""
TURN_S = 0.13
"""Each pixel learns about so often [s]: video at 30 frames per second teaches no more than at 7, and costs a fraction
where only every fourth frame is written back to memory."""
MAX_STEP_S = 1.0
"""A gap in time counts as at most this much learning [s]: what happened in it was not observed."""


class ForegroundParams(Params):
    """Mixtures of Gaussians over (Y, U, V, disparity) per pixel (Harville, Gordon, Woodfill 2001)."""

    gaussians: int = Field(3, ge=2, le=5)
    """Gaussians per pixel. Harville 2001: 3 to 5."""
    beta: float = Field(12.25, ge=4, le=25)
    """Squared normalised distance below which an observation matches. Harville 2001: 2.5^2 to 3.5^2; the upper end,
    because three colour coordinates share it (chi-square, 3 degrees of freedom: 0.7 % of true matches lost)."""
    depth_relaxation: float = Field(4.0, ge=1, le=16)
    """Factor on beta for colour where depth agrees. Harville 2001: about 4."""
    min_depth_fraction: float = Field(0.2, gt=0, le=1)
    """Fraction of a Gaussian's observations that must have depth for its depth to count. Harville 2001: 0.2."""
    dark_level: float = Field(20.0, ge=0, le=128)
    """Luma of the image (0-255) below which chroma is noise and only luma and depth are compared. Our choice: chroma
    quantised to 1 level is then worse than 5 % of the signal."""
    clip_level: float = Field(250.0, ge=128, le=255)
    """Luma of the image (0-255) at which the sensor saturates: a brighter surface looks the same. Our choice: a little
    below 255, for compression noise."""
    luma_noise: float = Field(4.0, gt=0, le=50)
    """Smallest standard deviation of luma (levels of 255). Our choice: 8-bit video of a lit room has 1-3 levels of
    noise, compression and mains flicker add as much."""
    chroma_noise: float = Field(2.5, gt=0, le=50)
    """Smallest standard deviation of U and V (levels of 255). Our choice: as luma_noise, times the 0.5 of U and V."""
    disparity_noise_px: float = Field(0.25, gt=0, le=5)
    """Smallest standard deviation of disparity [px]. Semi-global matching has sub-pixel errors of 0.1 to 0.3 px on
    texture and steps towards whole pixels (pixel locking); in disparity this is the same all over the image."""
    learning_rate: float = Field(1.0 / 60.0, gt=0, le=1)
    """Rate of the weights [1/s]: something new becomes background after about -ln(1 - background_weight) over this.
    Our choice: a chair that was moved is furniture again after half a minute."""
    adaptation_rate: float = Field(0.1, gt=0, le=5)
    """Rate of means and variances of a matched Gaussian [1/s]. Our choice: daylight changes within 10 s."""
    settle_s: float = Field(3.0, gt=0, le=60)
    """Start during which every observation counts alike (rate 1/n), and the time constant at pixels that are known
    to be background or that were uncovered [s]. The recordings start with three empty seconds."""
    activity_s: float = Field(1.0, gt=0, le=30)
    """Time constant of the mean change of luma [s]. Our choice: about one fidget."""
    activity_level: float = Field(5.0, gt=0, le=100)
    """Mean |Y_t - Y_(t-1)| above which a pixel is active (levels of 255). Our choice: noise of 3 levels gives 3.4."""
    activity_slowdown: float = Field(5.0, ge=1, le=100)
    """Active pixels learn so many times slower. Harville 2001: about 5."""
    background_weight: float = Field(0.4, gt=0, lt=1)
    """The leading Gaussians up to this weight are background (T). Harville 2001: about 0.4."""
    deepest_weight: float = Field(0.2, gt=0, lt=1)
    """The deepest Gaussian with depth is background above this weight (T_D). Harville 2001: about 0.2."""
    fattening_px: int = Field(7, ge=0, le=50)
    """How far the matcher carries a disparity beyond an outline [px of the matched image]: half of the window in which
    it asks for texture. 0 leaves all that depth alone tells from the background."""
    shadow_ratio: float = Field(0.35, gt=0, le=1)
    """Darkest shadow, as a fraction of the lit luma; inverted, where depth agrees, the brightest patch of light. Our
    choice: shade outdoors keeps a third of the image level after the camera's tone curve."""
    depth: bool = True
    """Whether depth takes part, when there is one. Harville 2001 adds it to mixtures in colour; false is such a one."""
    remove_colour_shadows: bool = False
    """Remove shadows by that ratio at equal chroma where there is no depth (for one camera without depth)."""


class Foreground:
    """What is not background, learned while watching; a fixed camera is assumed.

    Feedback (optional) is an (H, W) uint8 mask of what a tracker knows of the *current* image: NO_FEEDBACK, PERSON
    (learns nothing) or BACKGROUND (learns within settle_s); Harville 2002, ECCV.
    """

    def __init__(
        self, params: ForegroundParams, shape: tuple[int, int], disparity_noise_per_px2: float = 0.0, reduction: int = 1
    ) -> None:
        """Start without a background.

        Args:
            shape: (height, width) of all images.
            disparity_noise_per_px2: growth of the smallest disparity deviation with squared disparity [1/px], as a
                depth deviation that is the same at all depths has it; 0 for triangulated depth.
            reduction: images and disparities are every ``reduction``-th row and column of those matched.
        Raises:
            ValueError: an empty shape.
        """
        if min(shape) < 1:
            raise ValueError(f"expected a positive image size, got {shape}")
        self.params = params
        self._noise_per_px2 = disparity_noise_per_px2
        self.shape = shape
        self._reduction = reduction
        n = shape[0] * shape[1]
        n_blocks = -(-n // BLOCK)
        self._lead = np.zeros((n_blocks, N_LEAD * BLOCK), np.float32)
        self._rest = np.zeros(n * (params.gaussians - 1) * N_FIELDS, np.float32)
        self._mask = np.zeros(n, np.uint8)
        self._gain = GainFollower(shape, params.clip_level, 3 * params.luma_noise)
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="foreground")
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next image starts a new background."""
        self.shadow = np.zeros(self.shape, np.uint8)
        """(H, W) uint8, 255 where the last update removed a shadow by its colour."""
        self._turns = _Turns(self.params)
        self._size = 0
        self._gain.reset()
        self._rebased = Exposure()

    def update(self, image: U8, disparity: F32 | None, timestamp_s: float, feedback: U8 | None = None) -> U8:
        """Learn from one frame and separate its foreground.

        Args:
            image: (H, W) grey or (H, W, 3) BGR uint8; the same kind all the time.
            disparity: (H, W) float32 [px], NaN where there is none; None without depth.
            timestamp_s: time of the frame [s]; a gap counts as at most one second of learning.
            feedback: (H, W) uint8, see the class.
        Returns:
            (H, W) uint8, 255 foreground, 0 background. The first frame has no foreground.
        Raises:
            ValueError: an array of another shape or type.
        """
        flat = self._flat_image(image)
        if not self._turns.is_new and flat.size != self._size:
            raise ValueError(f"expected images of one kind, grey or BGR, got {image.shape} after another kind")
        self._size = flat.size
        disp = _flat(disparity if self.params.depth else None, self.shape, np.float32, "disparity")
        known = _flat(feedback, self.shape, np.uint8, "feedback")
        if self._turns.is_new:
            self._turns.start(timestamp_s)
            kernels.start_blocks(self._lead, self._rest, flat, disp, self._mask.size, self._constants())
            return np.zeros(self.shape, np.uint8)
        self._follow_gain(flat)
        self._run(flat, disp, known, self._constants(), self._turns.rates(timestamp_s))
        # Single pixels are noise, and single holes too.
        mask = np.asarray(cv2.medianBlur(self._mask.reshape(self.shape), 3), dtype=np.uint8)
        if self.params.remove_colour_shadows:
            self.shadow = np.asarray(cv2.inRange(mask, SHADOW, SHADOW), dtype=np.uint8)
            mask[self.shadow > 0] = 0
        return mask if disparity is None else self._without_fattening(mask)

    def _without_fattening(self, mask: U8) -> U8:
        """Foreground as 255, without what has the background's colour beside a foreground of another colour.

        A matcher that smooths carries the disparity of an outline on over the plain wall behind it (foreground
        fattening, Scharstein and Szeliski 2002).
        """
        reach = self.params.fattening_px // self._reduction
        if reach:
            other = cv2.inRange(mask, FOREGROUND, FOREGROUND)
            beside = cv2.dilate(other, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
            mask[cv2.bitwise_and(beside, cv2.inRange(mask, NEARER, NEARER)) > 0] = 0
        return np.asarray(cv2.threshold(mask, 0, FOREGROUND, cv2.THRESH_BINARY)[1], dtype=np.uint8)

    def background_luma(self) -> U8:
        """(H, W) uint8 luma of the most common background, as the current exposure shows it; zeros before an update."""
        lead = self._lead.reshape(-1, N_LEAD, BLOCK)[:, Y].reshape(-1)[: self._mask.size]
        luma = lead * np.float32(self._gain.gain) + np.float32(self._gain.offset)
        return np.clip(np.round(luma), 0, 255).astype(np.uint8).reshape(self.shape)

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
        if not 1 / REBASE_GAIN < self._gain.gain < REBASE_GAIN or abs(self._gain.offset) > REBASE_OFFSET:
            kernels.rebase(self._lead, self._rest, self._gain.gain, self._gain.offset)
            self._rebased = self.exposure
            self._gain.reset()

    def _run(self, image: U8, disparity: F32, feedback: U8, constants: UpdateConstants, rates: F32) -> None:
        """Update all blocks: this thread and a helper take bands until none is left; a late helper is not awaited."""
        limits = np.linspace(0, len(self._lead), BANDS + 1).astype(int).tolist()
        bands = iter(list(pairwise(limits)))

        def work() -> None:
            for first, last in bands:
                kernels.update_blocks(
                    self._lead, self._rest, image, disparity, feedback, self._mask, first, last, constants, rates
                )

        helper = self._worker.submit(work)
        work()
        if not helper.cancel():
            helper.result()

    def _constants(self) -> UpdateConstants:
        p = self.params
        gain, offset = self._gain.gain, self._gain.offset
        values = UpdateConstants(
            beta=p.beta,
            beta_relaxed=p.beta * p.depth_relaxation,
            min_depth_fraction=p.min_depth_fraction,
            dark=(p.dark_level - offset) / gain,
            clip=(p.clip_level - offset) / gain,
            black=-offset / gain,
            clip_image=p.clip_level,
            gain=gain,
            offset=offset,
            floor_y=(p.luma_noise / gain) ** 2,
            floor_uv=(p.chroma_noise / gain) ** 2,
            floor_d=p.disparity_noise_px**2,
            init_y=(2 * p.luma_noise / gain) ** 2,
            init_uv=(2 * p.chroma_noise / gain) ** 2,
            init_d=(2 * p.disparity_noise_px) ** 2,
            floor_d_per_d4=self._noise_per_px2**2,
            init_d_per_d4=(2 * self._noise_per_px2) ** 2,
            active=p.activity_level / gain,
            slow_active=1.0 / p.activity_slowdown,
            background_weight=p.background_weight,
            deepest_weight=p.deepest_weight,
            shadow_ratio=p.shadow_ratio,
            colour_shadow_ratio=p.shadow_ratio if p.remove_colour_shadows else 0.0,
        )
        return UpdateConstants._make(np.float32(value) for value in values)


class _Turns:
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
            rates[turn] = self._rates(min(self._now_s - self._learned_s[turn], MAX_STEP_S), age_s)
            self._learned_s[turn] = self._now_s
        return rates

    def _rates(self, dt: float, age_s: float) -> tuple[float, float, float, float]:
        p = self._params
        start = dt / (age_s + dt) if 0 < age_s <= p.settle_s else 0.0
        weight, mean, fast = _rate(dt * p.learning_rate), _rate(dt * p.adaptation_rate), _rate(dt / p.settle_s)
        return max(weight, start), max(mean, start), max(fast, start), _rate(dt / p.activity_s)


def _rate(time_constants: float) -> float:
    """Share of the new observation after so many time constants."""
    return -math.expm1(-time_constants)


def _flat(array: np.ndarray | None, shape: tuple[int, int], dtype: type, name: str) -> np.ndarray:
    if array is None:
        return np.zeros(0, dtype)
    if array.dtype != dtype or array.shape != shape:
        raise ValueError(f"expected {name} of shape {shape} and type {dtype.__name__}, got {array.shape} {array.dtype}")
    return np.ascontiguousarray(array).reshape(-1)
