"""Parameters of the trackers that explain every pixel by people."""

from __future__ import annotations

from pydantic import Field

from calib.params import Params


class PeopleParams(Params):
    """Assumptions about bodies and walking, and how people come and go; the same for all sensors."""

    seen_near_people: float = Field(0.3, gt=0, lt=1)
    """Share of the background's pixels that are foreground within an arm's reach of a person: arms, what is carried."""
    patch_m: float = Field(0.10, gt=0.01, le=1)
    """Errors of pixels nearer than this are one error [m]: one observation per patch (Harville's unit of occupancy)."""
    low_share: float = Field(0.1, gt=0, lt=1)
    """Share of people who sit, bend, or are children."""
    errors_s: float = Field(0.25, gt=0, le=10)
    """tau, time for which errors of the foreground stay the same [s]."""
    birth_evidence: float = Field(8.0, gt=0, le=100)
    """Log-odds of a newcomer against nothing at which it is followed: the logarithm of 1 / prior density."""
    stay_s: float = Field(50.0, gt=0.1, le=3600)
    """Mean time that an unseen person stays inside the view [s]."""
    report: float = Field(0.9, gt=0.5, lt=1)
    """Probability of existence from which a person is confirmed."""
    visible_min: float = Field(0.08, gt=0, lt=1)
    """Share of a body that must be visible for its place to be measured; a confirmed person with less is lost."""
    colour_weight: float = Field(0.7, ge=0, lt=1)
    """Weight of the colours of clothes; 0 disables them."""
    remember_s: float = Field(60.0, ge=0, le=3600)
    """Time for which a person who left is recognised [s]."""
    lag_s: float = Field(1.5, gt=0, le=60)
    """Time for which evidence of exchanged identities is kept [s]."""
