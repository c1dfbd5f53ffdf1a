"""A rectified pair, or an image with depth, above the floor that its maps cover."""

from __future__ import annotations

from dataclasses import dataclass

from calib.floor_camera import FloorPinhole
from calib.rig import DepthSensor, Floor
from planview.maps.grid import Grid
from stereo.depth import RectifiedGeometry
from stereo.matcher import DisparityRange


@dataclass(frozen=True, eq=False)
class FloorRig:
    """A rectified pair above its floor; an image with depth stands for the pair that its noise is equivalent to.

    Attributes:
        geometry: of the rectified pair.
        floor: pose of the rectified left camera and how well it is known.
        floor_source: "found" in the recording, or the file that gave it.
        calibration: file or folder the calibration came from; empty when unknown.
        vertical_residual_px: row offset left after rectification [px]; NaN when unknown.
        disparities: range searched.
        grid: cells of the plan-view maps.
        reduction: foreground and maps use every ``reduction``-th row and column of the rectified image.
        sensor: how depth was measured; None where a pair was matched.
        correction: sentence on how the recording corrects the calibration; empty when that was not looked at.
    """

    geometry: RectifiedGeometry
    floor: Floor
    floor_source: str
    calibration: str
    vertical_residual_px: float
    disparities: DisparityRange
    grid: Grid
    reduction: int
    sensor: DepthSensor | None = None
    correction: str = ""

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of disparity and foreground at the reduced size."""
        return -(-self.geometry.height // self.reduction), -(-self.geometry.width // self.reduction)

    @property
    def camera(self) -> FloorPinhole:
        """The rectified left camera above the floor."""
        return self.geometry.above(self.floor.world_SE3_left)
