"""Tracker of one calibrated camera with a human model."""

from typing import TYPE_CHECKING, Any

from planview.tracking.human_model.params import HumanModelParams

if TYPE_CHECKING:
    from planview.tracking.human_model.tracker import HumanModelTracker

__all__ = ["HumanModelParams", "HumanModelTracker"]


def __getattr__(name: str) -> Any:
    # Every configuration holds the parameters; the tracker and its kernels are imported by runs that use it.
    if name != "HumanModelTracker":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from planview.tracking.human_model.tracker import HumanModelTracker

    return HumanModelTracker
