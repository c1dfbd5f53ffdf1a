"""From linear light to recorded grey levels: lens, exposure, noise, gamma."""

from __future__ import annotations

import cv2
import numpy as np

from calib.types import F32, U8
from planview.synthetic.lighting import level_at
from planview.synthetic.scene import Capture, Sensor

_BANK = 1 << 21


class SensorModel:
    """One camera's sensor; its noise depends only on the seed, the camera and the frame."""

    def __init__(
        self,
        sensor: Sensor,
        shape: tuple[int, int],
        gain: float,
        seed: tuple[int, int],
        capture: Capture | None = None,
    ) -> None:
        """``gain`` scales linear light to 1 at full scale; ``shape`` is (H, W); the last of ``seed`` is the camera."""
        self._capture, self._empty_level = capture or Capture(), sensor.brightness
        self._sensor, self._gain, self._seed = sensor, gain * (1.0 + seed[1] * sensor.mismatch), seed
        self._bank = np.random.default_rng([*seed, 17]).standard_normal(_BANK, np.float32)
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
        light = self._automatic(light)
        if s.blur_px > 0:
            light = np.asarray(cv2.GaussianBlur(light, (0, 0), s.blur_px), np.float32)
        if s.grey:
            light = (light @ np.array([0.114, 0.587, 0.299], np.float32))[:, :, None]
        # A longer exposure counts more electrons, gain steps are rare in practice: noise is of the full well.
        sigma = np.sqrt(np.maximum(light, 0) * s.full_well_e + s.read_noise_e**2) / np.float32(s.full_well_e)
        light = light + sigma * self._noise(light.shape, frame)
        image = self._curve[np.clip(light * 4095 + 0.5, 0, 4095).astype(np.int32)]
        return self._compressed(np.ascontiguousarray(image[:, :, 0] if s.grey else image))

    def _automatic(self, light: F32) -> F32:
        """Exposure and colours as the camera's automatics set them for this frame."""
        c = self._capture
        if c.auto_exposure > 0:
            level = max(float(light.mean()), 1e-4)
            light = light * np.float32((self._empty_level / level) ** c.auto_exposure)
        if c.auto_white_balance > 0:
            means = np.maximum(light.mean(axis=(0, 1)), 1e-4)
            light = light * ((means.mean() / means) ** c.auto_white_balance).astype(np.float32)
        return light

    def _compressed(self, image: U8) -> U8:
        if not self._capture.jpeg_quality:
            return image
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, self._capture.jpeg_quality])
        flag = cv2.IMREAD_GRAYSCALE if image.ndim == 2 else cv2.IMREAD_COLOR
        return np.asarray(cv2.imdecode(data, flag), dtype=np.uint8)

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
