"""Plain twin of the error of samples in ``calib.people``, for one person at a known place."""

import math

from calib.ground_camera import GroundCamera
from calib.people.model import HumanModel
from calib.people.samples import HumanSample
from calib.types import F64


def weighted_error(camera: GroundCamera, sample: HumanSample, xy: F64) -> float:
    """E = whf Ehf + wbb Ebb of one sample, written out."""
    model = HumanModel()
    left, top, width, height = model.boxes(camera, xy)
    marked_left, marked_top, marked_width, marked_height = sample.box_px
    head = math.dist(model.head(camera, xy), sample.head_px)
    foot = math.dist(model.foot(camera, xy), sample.foot_px)
    radius = (math.sqrt(width * height / math.pi) + math.sqrt(marked_width * marked_height / math.pi)) / 2
    common = max(0.0, min(left + width, marked_left + marked_width) - max(left, marked_left)) * max(
        0.0, min(top + height, marked_top + marked_height) - max(top, marked_top)
    )
    iou = common / (width * height + marked_width * marked_height - common)
    weight = min(1.0, math.dist(sample.head_px, sample.foot_px) / math.hypot(marked_width, marked_height))
    return weight * (head + foot) / 2 / radius + (1 - weight) * (1 - iou)
