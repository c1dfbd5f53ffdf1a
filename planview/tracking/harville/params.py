"""Parameters of the template tracker."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from calib.params import Params
from planview.tracking.body_axis import BodyAxisParams
from planview.tracking.detection import PersonDetectionParams
from planview.tracking.identity import IdentityParams


class TemplateMatchParams(Params):
    """Match score, equation (4): every term is divided by its natural unit, so that weights compare influences."""

    height_weight: float = Field(1.0, ge=0.0)
    """alpha, on the mean height difference in units of H_max / 3 (Harville 2002: roughly equal influence)."""
    occupancy_weight: float = Field(1.0, ge=0.0)
    """beta, on the mean occupancy difference in units of the template's own mean occupancy."""
    distance_weight: float = Field(0.4, ge=0.0)
    """gamma, on the distance to the prediction in units of W_avg (Harville 2002: less than the others)."""
    separation_weight: float = Field(1.0, ge=0.0)
    """epsilon, on the Gaussian (deviation W_avg / 2) around people already placed in this frame."""
    score_max: float = Field(1.5, gt=0.0)
    """theta_track. Nothing at all where a body is expected scores 2; half of the body hidden scores about 1. Scores
    above half of it raise the deviation of the position by their square: a body that is being hidden seems to move
    towards what hides it."""


class TemplateTrackerParams(Params):
    """Template tracker; values without a reference are our choice."""

    match: TemplateMatchParams = TemplateMatchParams()
    detection: PersonDetectionParams = PersonDetectionParams()
    axis: BodyAxisParams = BodyAxisParams()
    identity: IdentityParams = IdentityParams()
    person_model: Literal["templates", "gaussian"] = "templates"
    """What is matched: the person's own adaptive templates, or a Gaussian as wide as a torso, of the person's height
    and visible surface, the simpler model that the paper argues against (Harville 2002, abstract)."""
    joint: bool = True
    """Among people in contact try every order of matching instead of the paper's (the most certain first)."""
    width_m: float = Field(0.40, gt=0.1, le=1.0)
    """W_avg, average torso width [m]; templates are 2 W_avg wide (Harville 2002, section 4)."""
    reach_m: float = Field(0.45, gt=0.1, le=1.0)
    """How far from its axis a body's points are cleared [m]: half of a shoulder breadth and a bent arm. Wider than the
    paper's template, which leaves arms behind that would be taken for a newcomer."""
    acceleration_std_mps2: float = Field(2.0, gt=0.0)
    """Random acceleration [m/s^2]: walkers start and stop within about 0.7 s at 1.4 m/s."""
    position_std_m: float = Field(0.05, gt=0.0)
    """Deviation of a matched position [m]: about a cell, and the sway of a body around its path."""
    speed_std_mps: float = Field(1.0, gt=0.0)
    """Deviation of the unknown velocity of a newcomer [m/s]."""
    search_sigma: float = Field(3.0, gt=0.0)
    """Half side of the search rectangle in deviations of the predicted position, at most ``reach_m``: farther away a
    person is reacquired by detection."""
    head_reach_m: float = Field(0.30, ge=0.0, le=1.0)
    """How far from a template's match its head may be measured [m]: a bent neck and half a template's slip."""
    template_time_s: float = Field(0.10, gt=0.0)
    """Time constant of the templates [s]: a relatively high gain (Harville 2002, section 4)."""
    confirm_s: float = Field(0.4, ge=0.0)
    """How long a newcomer must be tracked without a miss before it is confirmed [s]."""
    recognise_s: float = Field(0.5, ge=0.0)
    """How much longer a newcomer may wait to be confirmed, if it may be a person who was here before and has not been
    clearly observed yet [s]: who comes in is wholly in view after a step."""
    arm_m: float = Field(0.9, gt=0.0)
    """What is this near to a person [m] and small beside it is carried, or a limb: an arm's length and half a box."""
    part_area: float = Field(0.6, ge=0.0, le=1.0)
    """Small means less than this share of the person's visible surface: an arm, a far body's second clump, or a box
    carried before the chest, which hides a part of its carrier."""
    moved_m: float = Field(0.3, ge=0.0)
    """What is as low as a seated person must have moved this far before it is confirmed [m]: people come walking,
    things are put down; more than matching jitters."""
    lost_s: float = Field(4.0, ge=0.0)
    """How long a lost person may be reacquired [s] (Harville 2002, section 4: e.g. 4)."""
    reattach_m: float = Field(2.0, gt=0.0)
    """How near to a lost person a newcomer is taken for that person [m] (Harville 2002, section 4: e.g. 2)."""
    speed_max_mps: float = Field(2.5, gt=0.0)
    """A lost person is not reacquired farther away than a body's reach and this speed allow [m/s] (a fast walk)."""
    grow_max_m: float = Field(0.15, ge=0.0)
    """A newcomer taller than a lost person ever was by more than this [m] is another person."""
    slow_down_s: float = Field(0.7, gt=0.0)
    """Time constant with which the predicted velocity of a lost person decays [s]."""
    recentre_filled: float = Field(0.12, ge=0.0, le=1.0)
    """Template share with height below which it has slipped. Harville 2002, section 4: around 0.3, of coarse, smeared
    depth; a fully visible body fills 0.4 of a template here, and 0.3 of that has the same meaning."""
    recentre_offset: float = Field(0.5, gt=0.0)
    """Centroid offset [W_avg] beyond which a template has slipped. Harville 2002, section 4: around 0.5."""
    height_time_s: float = Field(0.3, gt=0.0)
    """Time constant of the reported height while it falls [s]: fast enough for a person who sits down. A rise is three
    times as fast, since a half hidden head looks lower and comes into view."""
