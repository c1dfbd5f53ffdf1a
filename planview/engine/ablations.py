"""Parts of the engine that can be switched off by name, to see what each is worth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from calib.errors import InputError
from planview.engine.config import Config, load_config


class Ablation(NamedTuple):
    """One part of the engine switched off.

    Attributes:
        name: what remains, or what is off.
        settings: overrides of the configuration like "template.joint=false", as ``planview run --set`` takes them.
        meaning: what the part does.
        paper: significant errors of Harville 2002, section 5, in about ten minutes; None where it has no such figure.
    """

    name: str
    settings: tuple[str, ...]
    meaning: str
    paper: int | None = None


_ABLATIONS = (
    Ablation(
        "height only",
        ("maps.statistic=height", "maps.occupancy_min=0", "template.match.occupancy_weight=0"),
        "without occupancy, which prunes heights, finds newcomers and is matched",
        paper=17,
    ),
    Ablation(
        "occupancy only",
        ("maps.statistic=occupancy", "template.match.height_weight=0"),
        "without height, which refuses what is no person, re-centers and is matched",
        paper=25,
    ),
    Ablation("Gaussian person model", ("template.person_model=gaussian",), "adaptive templates, a person's own shape"),
    Ablation("joint search off", ("template.joint=false",), "every order of matching among people in contact"),
    Ablation("identity layer off", ("template.identity.enabled=false",), "mends exchanges by appearance"),
    Ablation(
        "re-centering off",
        ("template.recentre_filled=0", "template.recentre_offset=1000"),
        "moves a slipped template to the nearest occupancy maximum",
    ),
    Ablation("feedback off", ("feedback.enabled=false",), "tracked people are not learned as background"),
    Ablation("activity off", ("foreground.activity_slowdown=1",), "active pixels learn more slowly"),
    Ablation("deepest surface off", ("foreground.deepest_weight=0.99",), "the deepest Gaussian is background early"),
    Ablation("foreground in colour", ("foreground.depth=false",), "depth in the foreground's mixture"),
)

ABLATIONS: Mapping[str, Ablation] = {ablation.name: ablation for ablation in _ABLATIONS}
"""By name; the first two are those of Harville 2002, section 5, the next four switch off parts of the template tracker
(section 4), the rest those of its foreground (Harville, Gordon and Woodfill 2001)."""


def ablated(name: str, config: Config | None = None) -> Config:
    """A configuration with one part of the engine switched off.

    Args:
        name: one of ``ABLATIONS``.
        config: what is changed; the defaults when None.
    Raises:
        InputError: no such ablation.
    """
    if name not in ABLATIONS:
        raise InputError(f"ablation: expected one of {', '.join(ABLATIONS)}, found {name!r}")
    return load_config(None, ABLATIONS[name].settings, config)
