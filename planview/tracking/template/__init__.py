"""Adaptive plan-view templates with Kalman prediction and re-centering (Harville 2002, section 4)."""

from planview.tracking.template.tracker import TemplateParams, TemplateTracker

__all__ = ["TemplateParams", "TemplateTracker"]
