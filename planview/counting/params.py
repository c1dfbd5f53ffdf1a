"""When a person counts."""

from pydantic import Field

from calib.params import Params


class AnalyticsParams(Params):
    """Tripwires and zones."""

    hysteresis_m: float = Field(0.25, ge=0, le=5)
    """How far beyond a line a person must be observed, on both sides, for a crossing [m]. Our choice: half a shoulder's
    breadth, so that the body is across; more than twice the position noise of a good tracker."""
    zone_hysteresis_m: float = Field(0.15, ge=0, le=5)
    """How deep inside or outside a zone a person must be observed to enter or leave it [m]. Our choice: a little more
    than the position noise of a tracker. Smaller than for a line: a crossing counted wrongly stays counted, occupancy
    is right again with the next step, and a person walking along the outline is inside all the same."""
    min_age_s: float = Field(0.5, ge=0, le=60)
    """Younger tracks count nothing yet; what they did counts once they are older [s]. Our choice: flickers of
    foreground are shorter, people crossing the view are observed for longer."""
    stitch_s: float = Field(2.0, ge=0, le=60)
    """A track that begins within this time of another one's end, where that one was heading, is the same person [s].
    Our choice: trackers re-attach by themselves over longer times (Harville 2002: 4 s), so this only bridges what they
    do not, and two people through the same door are farther apart."""
    stitch_m: float = Field(0.6, ge=0, le=5)
    """How near to the predicted place [m]. Our choice: a person that stops, or turns, within half a second at walking
    pace."""
    interval_s: float = Field(60.0, gt=0, le=86400)
    """Length of the intervals of the totals [s]. Our choice."""
