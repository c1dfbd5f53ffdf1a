"""People explained jointly with free space and occlusion: the default tracker."""

from planview.tracking.joint.ranges import JointParams
from planview.tracking.joint.tracker import JointTracker

__all__ = ["JointParams", "JointTracker"]
