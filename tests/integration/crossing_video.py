"""A small video of one camera, with people painted as the human model has them."""

import math
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from calib.ground_camera import GroundCamera
from calib.people.model import HumanModel
from calib.types import U8
from stereo.recording import Frame, OpenOptions, Shot, SingleCamera, Skipped

CAMERA = GroundCamera(160, 120, 120.0, 4.0, math.radians(62))


class CrossingVideo:
    """Two people of one camera who cross, before a noisy wall; empty for a second."""

    path, n_frames, fps, sensor = Path("crossing"), 60, 10.0, SingleCamera((160, 120))
    skipped: tuple[Skipped, ...] = ()
    notes: tuple[str, ...] = ()
    options, is_live = OpenOptions(), False
    files: tuple[Path, ...] = ()
    identity = ()

    @property
    def parts(self) -> tuple["CrossingVideo"]:
        return (self,)

    def __iter__(self) -> Iterator[Frame[Shot]]:
        rng = np.random.default_rng(5)
        for i in range(self.n_frames):
            image = np.clip(128 + rng.normal(0, 2, (120, 160, 3)), 0, 255).astype(np.uint8)
            if i >= 10:
                self._paint(image, (i - 10) / self.fps)
            yield Frame(i, i / self.fps, ((image,),))

    def _paint(self, image: U8, t: float) -> None:
        for x, y, colour in ((0.8 * t - 2, 6.0, (20, 20, 200)), (2 - 0.8 * t, 7.0, (200, 40, 20))):
            hull = HumanModel().hulls(CAMERA, (x, y))
            cv2.fillConvexPoly(image, np.rint(hull).astype(np.int32), colour)
