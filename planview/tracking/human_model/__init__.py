"""Tracker of one calibrated camera with a human model."""

from planview.tracking.human_model.explanation import HumanModelParams
from planview.tracking.human_model.tracker import HumanModelTracker

__all__ = ["HumanModelParams", "HumanModelTracker"]
