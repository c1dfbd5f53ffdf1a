"""Parameters of the template tracker."""

from __future__ import annotations

from pydantic import Field

from calib.params import Params
from planview.tracking.body_axis import BodyAxisParams
from planview.tracking.detection import DetectionParams


class MatchParams(Params):
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
    """theta_track. Nothing at all where a body is expected scores 2; half of the body hidden scores about 1."""


class TemplateTrackerParams(Params):
    """Template tracker; values without a reference are our choice."""

    match: MatchParams = MatchParams()
    detection: DetectionParams = DetectionParams()
    axis: BodyAxisParams = BodyAxisParams()
    width_m: float = Field(0.40, gt=0.1, le=1.0)
    """W_avg, average torso width [m]; templates are 2 W_avg wide (Harville 2002, section 4)."""
    reach_m: float = Field(0.45, gt=0.1, le=1.0)
    """How far from its axis a body's points are cleared [m]: half of a shoulder breadth and a bent arm. Wider than the
    paper's template, which leaves arms behind that would be taken for somebody new."""
    acceleration_std_mps2: float = Field(2.0, gt=0.0)
    """Random acceleration [m/s^2]: walkers start and stop within about 0.7 s at 1.4 m/s."""
    position_std_m: float = Field(0.05, gt=0.0)
    """Deviation of a matched position [m]: about a cell, and the sway of a body around its path."""
    score_good: float = Field(0.75, gt=0.0)
    """Match scores up to this leave the position at ``position_std_m``; worse ones raise it by their square. A third
    of the body newly hidden, or a turn, scores about as much (our choice)."""
    speed_std_mps: float = Field(1.0, gt=0.0)
    """Deviation of the unknown velocity of somebody new [m/s]."""
    search_sigma: float = Field(3.0, gt=0.0)
    """Half side of the search rectangle in deviations of the predicted position."""
    search_max_m: float = Field(0.5, gt=0.0)
    """Largest half side of the search rectangle [m]; farther away a person is found again by detection."""
    head_reach_m: float = Field(0.30, ge=0.0, le=1.0)
    """How far from a template's match its head may be seen [m]: a bent neck and half a template's slip (our choice)."""
    template_time_s: float = Field(0.10, gt=0.0)
    """Time constant of the templates [s]: a relatively high gain (Harville 2002, section 4)."""
    confirm_s: float = Field(0.4, ge=0.0)
    """How long somebody new must be tracked without a miss before he is believed [s]."""
    ghost_m: float = Field(0.35, ge=0.0)
    """Nobody is believed while this near to somebody known [m] (stretched along the ray by depth noise): he may be an
    arm, or a far body's second clump of depth."""
    arm_m: float = Field(0.9, ge=0.0)
    """What is this near to somebody known [m] and small beside him is what he carries, or a limb: an arm's length and
    half a box (our choice)."""
    piece_area: float = Field(0.35, ge=0.0, le=1.0)
    """Small means less than this share of his visible surface (our choice: an arm, or a far body's second clump)."""
    parcel_area: float = Field(0.6, ge=0.0, le=1.0)
    """The same for what is below his shoulders: a box carried before the chest hides a part of its carrier."""
    shoulder: float = Field(0.85, gt=0.0, le=1.0)
    """Height of the shoulders over that of the body (anthropometric tables: 0.82, and a margin for depth noise)."""
    seated_m: float = Field(1.4, gt=0.0)
    """Heads of seated adults are below this [m] (anthropometric tables: seat 0.45 m, sitting height up to 0.95 m)."""
    moved_m: float = Field(0.3, ge=0.0)
    """What is as low as a seated person must have moved this far before it is believed [m]: more than matching jitters
    (our choice)."""
    sway_m: float = Field(0.1, ge=0.0)
    """Somebody not yet believed may look this much lower than the minimum of a person [m]: noise and a step's dip."""
    lost_s: float = Field(4.0, ge=0.0)
    """How long a lost person may come back [s] (Harville 2002, section 4: e.g. 4)."""
    reattach_m: float = Field(2.0, ge=0.0)
    """How near to a lost person a new one is taken for him [m] (Harville 2002, section 4: e.g. 2)."""
    speed_max_mps: float = Field(2.5, gt=0.0)
    """Nobody comes back farther away than he can have walked: a body's reach and this speed [m/s] (a fast walk)."""
    grow_max_m: float = Field(0.15, ge=0.0)
    """A new person taller than a lost one ever was by more than this [m] is somebody else."""
    slow_down_s: float = Field(2.0, gt=0.0)
    """Time constant with which the predicted velocity of a lost person decays [s]."""
    recentre_filled: float = Field(0.3, ge=0.0, le=1.0)
    """Template share with height below which it has slipped, relative to the share of a standing body, see
    ``recentre_body``. Harville 2002, section 4: around 0.3."""
    recentre_offset: float = Field(0.5, gt=0.0)
    """Centroid offset [W_avg] beyond which a template has slipped. Harville 2002, section 4: around 0.5."""
    recentre_mass: float = Field(3.0, ge=1.0)
    """A template moves to another part of the same body that shows so many times its own surface (our choice)."""
    recentre_body: float = Field(0.4, gt=0.0, le=1.0)
    """Share of a template that a fully seen body fills; the paper's 0.3 is meant for its coarse, smeared depth."""
    left_s: float = Field(1.0, ge=0.0)
    """How long somebody may come back who was lost at the border of the view [s]: he has most likely left, and who
    enters there later is somebody else. Our choice; the paper keeps him for 4 s too."""
    height_time_s: float = Field(0.3, gt=0.0)
    """Time constant of the reported height while it falls [s]: fast enough for somebody who sits down."""
    height_rise_s: float = Field(0.1, gt=0.0)
    """Time constant while it rises [s]: shorter, since a half hidden head looks lower and comes into view (our
    choice)."""
