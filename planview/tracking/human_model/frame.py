"""One frame as the tracker's modules see it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.errors import InputError
from calib.types import U8
from planview.foreground.blobs import Blobs, find_blobs
from planview.tracking.base import Observation

LESS_SALIENT, SALIENT = np.uint8(1), np.uint8(2)
"""Evidence of what may be foreground (removed as a shadow), and of foreground proper."""


@dataclass(frozen=True, eq=False)
class ModelFrame:
    """Attributes:
    now_s: time of the frame [s].
    image: (H, W, 3) uint8, None where there is no colour.
    evidence: (H, W) uint8: 2 foreground, 1 less salient (removed as a shadow), 0 neither.
    motion: (H, W) uint8, 255 where consecutive frames differ.
    blobs: of the evidence.
    """

    now_s: float
    image: U8 | None
    evidence: U8
    motion: U8
    blobs: Blobs


def frame_of(observation: Observation, size: tuple[int, int]) -> ModelFrame:
    """Check an observation against the camera's (width, height).

    Raises:
        InputError: images of another size.
        ValueError: foreground or motion are missing.
    """
    foreground, motion, image = observation.foreground, observation.motion, observation.image
    if foreground is None or motion is None:
        raise ValueError("the human-model tracker needs foreground and motion")
    if foreground.shape != size[::-1]:
        raise InputError(
            f"expected images of {size[0]}x{size[1]} px, for which the camera was calibrated, "
            f"found {foreground.shape[1]}x{foreground.shape[0]}"
        )
    evidence = salience(foreground, observation.shadow)
    colour = image if image is not None and image.ndim == 3 else None
    return ModelFrame(observation.timestamp_s, colour, evidence, motion, find_blobs(evidence))


def salience(foreground: U8, shadow: U8 | None) -> U8:
    """(H, W) uint8: 2 where foreground, 1 where less salient (removed as a shadow), else 0."""
    salient = (foreground > 0).astype(np.uint8) * SALIENT
    return salient if shadow is None else np.maximum(salient, (shadow > 0).astype(np.uint8))
