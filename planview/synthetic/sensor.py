"""From linear light to recorded grey levels: lens, exposure, noise, gamma."""

from __future__ import annotations

import cv2
import numpy as np

from calib.types import F32, U8
from planview.synthetic.lighting import level_at
from planview.synthetic.scene import Sensor

_BANK = 1 << 21


class SensorModel:
    """One camera's sensor; its noise depends only on the seed, the camera and the frame."""

    def __init__(self, sensor: Sensor, shape: tuple[int, int], gain: float, seed: int, camera: int) -> None:
        """``gain`` scales linear light to 1 at full scale; ``shape`` is (H, W)."""
        self._sensor, self._gain, self._seed = sensor, gain * (1.0 + camera * sensor.mismatch), (seed, camera)
        self._bank = np.random.default_rng([seed, camera, 17]).standard_normal(_BANK, np.float32)
        h, w = shape
        v, u = np.mgrid[:h, :w]
        r2 = ((u - (w - 1) / 2) ** 2 + (v - (h - 1) / 2) ** 2) / ((w / 2) ** 2 + (h / 2) ** 2)
        self._vignette = (1.0 - sensor.vignetting * r2).astype(np.float32)[:, :, None]
        level = np.linspace(0, 1, 4096)
        srgb = np.where(level <= 0.0031308, 12.92 * level, 1.055 * level ** (1 / 2.4) - 0.055)
        self._curve = np.round(255 * srgb).astype(np.uint8)

    def __call__(self, linear: F32, frame: int, t: float) -> U8:
        """(H, W, 3) uint8, or (H, W) for a grey sensor."""
        s = self._sensor
        light = linear * (self._vignette * np.float32(self._gain * level_at(s.exposure, t)))
        if s.blur_px > 0:
            light = np.asarray(cv2.GaussianBlur(light, (0, 0), s.blur_px), np.float32)
        if s.grey:
            light = (light @ np.array([0.114, 0.587, 0.299], np.float32))[:, :, None]
        # A longer exposure counts more electrons, gain steps are rare in practice: noise is of the full well.
        sigma = np.sqrt(np.maximum(light, 0) * s.full_well_e + s.read_noise_e**2) / np.float32(s.full_well_e)
        light = light + sigma * self._noise(light.shape, frame)
        image = self._curve[np.clip(light * 4095 + 0.5, 0, 4095).astype(np.int32)]
        return np.ascontiguousarray(image[:, :, 0] if s.grey else image)

    def _noise(self, shape: tuple[int, ...], frame: int) -> F32:
        """Normal numbers from a bank, from another place in each frame."""
        rng = np.random.default_rng([*self._seed, frame])
        size = int(np.prod(shape))
        out = np.empty(size, np.float32)
        at = 0
        while at < size:
            start = int(rng.integers(0, _BANK))
            n = min(size - at, _BANK - start)
            out[at : at + n] = self._bank[start : start + n]
            at += n
        return out.reshape(shape)
