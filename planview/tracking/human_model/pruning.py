"""Which targets to confirm, to reacquire and to prune (section 4)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from calib.types import F64
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.target import Target
from planview.tracking.lifecycle import LifeCycle

MIN_MATCHES = 3
"""Frames matched before a target can be found motionless: motion flickers (our choice)."""

PERSON_PATIENCE = 30.0
"""How many times longer a person may stay motionless than a thing: 10 minutes instead of 20 s, since in small images
attentive listeners show no motion for minutes (our choice)."""


def has_walked(target: Target, params: HumanModelParams) -> bool:
    """Motion salience: a person has walked into the view; one who has shown in part only, as far as no thing goes."""
    target.whole |= target.existence.observed and target.precision >= params.spawn.min_precision
    return target.build.travel_m >= (params.spawn.min_travel_m if target.whole else params.prune.walked_m)


def is_person(target: Target, params: HumanModelParams) -> bool:
    """Whether a target has gone as far as no thing goes; a person on a seat has stood before, as no chair does."""
    return target.seat is not None or target.build.travel_m >= params.prune.walked_m


def prune_reason(target: Target, params: HumanModelParams, life: LifeCycle) -> str:
    """Why a target is not, or no longer, a person in view; empty if it stays."""
    prune, who = params.prune, target.existence
    if not who.confirmed:
        if life.age_s(who) > params.settle_s * (1.0 if target.whole else 2.0):
            return "never walked"
        if target.matches >= MIN_MATCHES and target.moving_fraction < 0.5 * params.states.internal_motion:
            return "does not move"
    limit_s = prune.inanimate_s * (PERSON_PATIENCE if is_person(target, params) else 1.0)
    if life.now_s - target.still_since_s >= limit_s:
        return "stationary: a thing"
    if target.inside < prune.gone_visible:
        return "left the view"
    if not who.observed and (target.inside < prune.border_visible or target.support_s <= 0.0):
        return f"no blob for {life.unobserved_s(who):.1f} s"
    return ""


def reacquirable(
    targets: Sequence[Target], xy_m: F64, likeness: Callable[[Target], float], params: HumanModelParams, now_s: float
) -> Target | None:
    """The lost target that is predicted near (2,) xy and looks alike, the nearest if there are several.

    A person who has just sat down and reappears walking beside the seat did not: it was a thing that was put down.

    Args:
        likeness: of a target's memory to what is observed at xy; NaN where it is not known.
    """
    best, best_m = None, params.prune.reacquire_m
    for target in targets:
        like = likeness(target)
        lost = target.existence.state == "lost" and not like < params.prune.min_likeness
        hasty = target.seat is not None and now_s - target.seat.since_s < params.settle_s
        if not (lost or (hasty and like >= params.prune.min_likeness)):
            continue
        distance = math.hypot(*(target.xy_m - xy_m))
        if distance < best_m:
            best, best_m = target, distance
    return best
