"""Adaptive plan-view templates with Kalman prediction and re-centering (Harville 2002, section 4)."""

from planview.tracking.harville.params import TemplateTrackerParams
from planview.tracking.harville.tracker import TemplateTracker

__all__ = ["TemplateTracker", "TemplateTrackerParams"]
