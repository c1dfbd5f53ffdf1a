"""The fixed yardstick: bare OpenCV stereo of every frame, with no setting of the engine in it."""

from __future__ import annotations

import cv2

from calib.images import as_grey
from calib.rig import StereoRig
from calib.types import U8, AnyArray

BLOCK_PX = 5
"""Side of the matched block [px]."""
WIDE_PX = 640
"""Images up to this width are searched over 64 disparities, wider ones over 128."""


class Yardstick:
    """OpenCV's remap of both cameras and its StereoSGBM (three-way, block 5), at the recorded size.

    Args:
        rig: calibration at the recorded size.
        grey: convert the recorded images to grey first; else both are remapped and matched in the recording's colours.
    """

    def __init__(self, rig: StereoRig, grey: bool) -> None:
        left, right, size = rig.left, rig.right, rig.left.size
        right_SE3_left = rig.right_SE3_left
        r1, r2, p1, p2 = cv2.stereoRectify(
            left.matrix, left.coefficients, right.matrix, right.coefficients, size,
            right_SE3_left.rotation, right_SE3_left.translation.reshape(3, 1), alpha=0.0,
        )[:4]  # fmt: skip
        self._grey = grey
        self._maps = [
            cv2.initUndistortRectifyMap(camera.matrix, camera.coefficients, turn, matrix, size, cv2.CV_16SC2)
            for camera, turn, matrix in ((left, r1, p1), (right, r2, p2))
        ]
        self.disparities = 64 if size[0] <= WIDE_PX else 128
        area = BLOCK_PX * BLOCK_PX * (1 if grey else 3)  # OpenCV's recommendation: 8 and 32 times channels and block
        self._sgbm = cv2.StereoSGBM.create(
            0, self.disparities, BLOCK_PX, 8 * area, 32 * area, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY
        )

    def remap(self, left: U8, right: U8) -> list[AnyArray]:
        """Both images rectified."""
        images = (as_grey(left), as_grey(right)) if self._grey else (left, right)
        return [cv2.remap(image, *maps, cv2.INTER_LINEAR) for image, maps in zip(images, self._maps, strict=True)]

    def match(self, rectified: list[AnyArray]) -> AnyArray:
        """(H, W) int16 disparity [1/16 px]."""
        return self._sgbm.compute(*rectified)

    def __call__(self, left: U8, right: U8) -> AnyArray:
        """(H, W) int16 disparity [1/16 px] of a recorded pair."""
        return self.match(self.remap(left, right))
