"""Which targets to believe, to merge, to take up again and to remove (section 4)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calib.types import F32, F64
from planview.tracking.human_model.params import HumanModelParams, LifeParams
from planview.tracking.human_model.scene import similarity
from planview.tracking.human_model.target import Target


def believable(target: Target, params: HumanModelParams) -> bool:
    """Motion salience: a person has walked into the view, and was matched while doing so."""
    return target.matches >= params.birth.min_matches and target.travel_m >= params.birth.min_travel_m


def redundant(
    targets: list[Target], params: LifeParams, now_s: float, touch: Callable[[Target, Target], bool]
) -> list[tuple[Target, Target]]:
    """Targets that add nothing to the matching score, with whom each is one.

    Others have covered it for long while all of them walked: two people who walk are rarely one behind the other
    for so long (the paper's merge rule).
    """
    found: list[tuple[Target, Target]] = []
    longest = sorted((t for t in targets if t.covered_since_s >= 0), key=lambda t: t.covered_since_s)
    for target in longest:
        gone = [pair[0] for pair in found]
        others = [t for t in targets if t is not target and t not in gone and touch(t, target)]
        clocks = [target.covered_since_s, target.moving_since_s, *(t.moving_since_s for t in others)]
        # NaN where one of the clocks does not run.
        if others and now_s - float(np.max(clocks)) >= params.merge_after_s:
            found.append((target, others[0]))
    return found


def why_remove(target: Target, params: HumanModelParams, now_s: float) -> str:
    """Why a target is not, or no longer, a person in view; empty if it stays."""
    birth, life = params.birth, params.life
    if not target.confirmed:
        if now_s - target.born_s > birth.tentative_s:
            return "never walked"
        if not target.matched:
            return "no blob before it was believed"
        if target.matches > 2 and max(row[3] for row in target.trail) < birth.min_motion:
            return "does not move"
    # Who sits was seen to stand before, as no chair does.
    person = target.seat is not None or target.travel_m >= life.walked_m
    if now_s - target.still_since_s >= (life.asleep_s if person else life.inanimate_s):
        return "stationary: a thing"
    if target.inside < life.gone_visible:
        return "left the view"
    leaving = target.inside < life.border_visible
    if not target.matched and (leaving or now_s - target.seen_s > life.patience_s * target.inside):
        return f"no blob for {now_s - target.seen_s:.1f} s"
    return ""


def same_as_lost(
    targets: list[Target], xy_m: F64, colours: F32 | None, params: HumanModelParams, now_s: float
) -> Target | None:
    """The lost target that is predicted near (2,) xy and looks alike, the nearest if there are several.

    Somebody who has just sat down and is seen to walk beside the seat did not: it was a thing that was put down.
    """
    best, best_m = None, params.life.reattach_m
    for target in targets:
        likeness = _likeness(target, colours)
        hasty = target.seat is not None and now_s - target.seat.since_s < params.posture.hasty_s
        lost = not target.matched and not likeness < params.life.alike
        if not target.confirmed or not (lost or (hasty and likeness >= params.life.alike)):
            continue
        distance = float(np.hypot(*(target.kalman.state[:2] - xy_m)))
        if distance < best_m:
            best, best_m = target, distance
    return best


def _likeness(target: Target, colours: F32 | None) -> float:
    """Similarity of colours, NaN where they are not known."""
    if target.colours is None or colours is None:
        return float("nan")
    return similarity(target.colours, colours)
