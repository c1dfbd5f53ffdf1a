"""Variants of the engine for the ablation: what is switched off, and how."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.suite import Way
from calib.errors import InputError
from planview.engine.ablations import ABLATIONS
from planview.engine.maps_pipeline import FIXED_MAP_PARAMETERS, FIXED_TABLES


@dataclass(frozen=True)
class Variant:
    """One row of the table; the settings are those that ``planview run --set`` takes.

    Attributes:
        name: of the row.
        settings: overrides of the configuration like "template.joint=false".
        meaning: what the part that is switched off does.
        way: which tracks of the run are scored.
        paper: significant errors of Harville 2002, section 5, in about ten minutes; None where it has no such figure.
    """

    name: str
    settings: tuple[str, ...] = ()
    meaning: str = ""
    way: Way = "online"
    paper: int | None = None

    @property
    def tracker_only(self) -> bool:
        """Whether recorded foreground points serve: nothing that decides which points there are differs."""
        names = [setting.partition("=")[0] for setting in self.settings]
        fixed = {f"maps.{name}" for name in FIXED_MAP_PARAMETERS}
        return not any(n.split(".")[0] in FIXED_TABLES or n in fixed for n in names)


CONFIGURED = Variant("as configured", paper=1)
"""What every other variant is compared with."""

LADDER = (
    *(Variant(a.name, a.settings, a.meaning, paper=a.paper) for a in ABLATIONS.values()),
    Variant("refinement on", (), "online tracks; refined ones know the future", way="refined"),
    Variant("naive engine", (), "everything after disparity: MOG2, blobs, Hungarian method, Kalman filter", way="peer"),
)
"""Parts of the engine, each switched off alone; refinement on; and the naive engine."""

RULES = (
    Variant("head_reach_m", ("template.head_reach_m=0",), "position from the head where it is near the match"),
    Variant("reach_m", ("template.reach_m=0.4",), "clears arms too, beyond the paper's W_avg"),
    Variant("distance_weight", ("template.match.distance_weight=0",), "matches near the prediction are better"),
    Variant("separation_weight", ("template.match.separation_weight=0",), "keeps away from people already placed"),
    Variant("confirm_s", ("template.confirm_s=0",), "a newcomer is confirmed after some time only"),
    Variant("part_area", ("template.part_area=0",), "small things near a person are carried, or limbs"),
    Variant("moved_m", ("template.moved_m=0",), "low newcomers must have moved"),
    Variant("grow_max_m", ("template.grow_max_m=1000",), "a newcomer taller than a lost person is another person"),
    Variant("speed_max_mps", ("template.speed_max_mps=100",), "lost people go no faster than a fast walk"),
    Variant("slow_down_s", ("template.slow_down_s=1000",), "the predicted velocity of lost people decays"),
    Variant("lost_s", ("template.lost_s=0",), "lost people are reacquired"),
    Variant("low_m", ("template.detection.low_m=1.2",), "lost people are also found crouching"),
    Variant("head_width_max_m", ("template.detection.head_width_max_m=1000",), "doors and boards are not people"),
    Variant("separation_m", ("template.detection.separation_m=0.01",), "nothing new within shoulders of a person"),
)
"""Special rules of the template tracker, each switched off alone."""


def chosen_variants(variants: Sequence[Variant], names: Sequence[str]) -> tuple[Variant, ...]:
    """``CONFIGURED``, then the variants named; all when none is.

    Raises:
        InputError: no such variant.
    """
    known = {variant.name: variant for variant in variants}
    for name in names:
        if name not in known:
            raise InputError(f"--variant: expected one of {', '.join(known)}, found {name!r}")
    return CONFIGURED, *(known[name] for name in names or known)
