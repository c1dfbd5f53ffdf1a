"""Parameters of the human-model tracker."""

from __future__ import annotations

from pydantic import Field

from planview.tracking.human_model.model_map import HumanModelMapParams
from planview.tracking.joint.params import PeopleParams


class HumanModelParams(PeopleParams):
    """Assumptions about masks, bodies and walking, and how people come and go (Zhang et al. 2008; values are ours)."""

    map: HumanModelMapParams = HumanModelMapParams()
    """Where people are expected."""
    seen_on_body: float = Field(0.8, gt=0.5, lt=1)
    """pF, share of a body's pixels that are foreground."""
    seen_on_background: float = Field(0.03, gt=0, lt=0.5)
    """pB, share of the background's pixels that are foreground."""
    seen_near_people: float = Field(0.2, gt=0, lt=1)
    """The same within an arm's reach of a person: arms, shadows and what is carried."""
    hidden: float = Field(0.05, ge=0, lt=1)
    """How probably furniture hides a pixel on the lower part of somebody who stands."""
    hidden_sitting: float = Field(0.5, ge=0, lt=1)
    """The same of somebody who sits."""
    patch_m: float = Field(0.2, gt=0.01, le=1)
    """Errors of pixels nearer than this on a body are one error [m]."""
    sitting: float = Field(0.77, gt=0.3, lt=0.95)
    """Height of a person who sits over the height when standing: from the seat to the top of the head 0.52 of the
    stature, and a seat 0.45 m high."""
    birth_visible: float = Field(0.3, gt=0, le=1)
    """Visibility ratio from which newcomers are looked for (section 4: visibility criterion), and below which a person
    has left: whoever shows there next is a stranger."""
    walked_m: float = Field(0.4, ge=0, le=5)
    """Distance that a newcomer must walk to count as a person [m] (section 4: motion salience): a torso's width."""
    inanimate_s: float = Field(20.0, gt=0, le=600)
    """Time without any motion after which something that has moved by a metre is a thing [s] (section 4: the chair);
    a person who walked farther is kept for longer in proportion."""
    window_s: float = Field(0.8, gt=0, le=10)
    """Time over which motion and trends are judged [s]: one and a half steps."""
    moving_mps: float = Field(0.25, gt=0, le=3)
    """Speed from which a person is moving [m/s]: swaying is slower."""
    internal_motion: float = Field(0.04, gt=0, lt=1)
    """Share of a body in motion that is internal motion: a hand or the head."""
    trend: float = Field(0.1, gt=0, lt=1)
    """Change of the visible share within the window that is appearing or disappearing."""
    still_s: float = Field(3.0, gt=0, le=600)
    """Time without motion after which foreground that nobody explains is background [s], and a newcomer a thing."""
