"""Adaptive plan-view templates with Kalman prediction and re-centering (Harville 2002, section 4)."""

from planview.tracking.template.params import TemplateParams
from planview.tracking.template.tracker import TemplateTracker

__all__ = ["TemplateParams", "TemplateTracker"]
