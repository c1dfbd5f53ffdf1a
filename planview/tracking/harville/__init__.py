"""x"""

from planview.tracking.harville.params import TemplateTrackerParams as HarvilleParams
from planview.tracking.harville.tracker import TemplateTracker as HarvilleTracker

__all__ = ["HarvilleParams", "HarvilleTracker"]
