"""Adaptive plan-view templates with Kalman prediction and re-centering (Harville 2002, section 4)."""

from planview.tracking.harville.params import HarvilleParams
from planview.tracking.harville.tracker import HarvilleTracker

__all__ = ["HarvilleParams", "HarvilleTracker"]
