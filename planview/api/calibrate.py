"""Calibrations found and converted: ``planview.calibrate``."""

from planview.api.calibrate_pair import align, board, convert, ui
from planview.api.calibrate_pose import floor, human

__all__ = ["align", "board", "convert", "floor", "human", "ui"]
