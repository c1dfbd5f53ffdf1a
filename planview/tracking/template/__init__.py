"""People explained jointly with free space and occlusion: the default tracker."""

from planview.tracking.template.params import TemplateParams
from planview.tracking.template.tracker import TemplateTracker

__all__ = ["TemplateParams", "TemplateTracker"]
