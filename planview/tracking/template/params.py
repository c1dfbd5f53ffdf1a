"""Parameters of the tracker of Harville 2002, section 4."""

from __future__ import annotations

from pydantic import Field

from calib.params import Params


class TemplateParams(Params):
    """The paper's thresholds; every term of equation (4) is divided by its natural unit, so that weights compare
    influences. A weight of 0 leaves a term out: height alone and occupancy alone are two of the paper's variants, for
    which score_max is halved, since nothing at all then scores 1."""

    height_weight: float = Field(1.0, ge=0.0)
    """alpha, on the mean height difference in units of H_max / 3 (Harville 2002, section 4: all equal)."""
    occupancy_weight: float = Field(1.0, ge=0.0)
    """beta, on the mean occupancy difference in units of the template's own mean occupancy (as alpha)."""
    distance_weight: float = Field(0.4, ge=0.0)
    """gamma, on the distance to the prediction in units of W_avg (Harville 2002, section 4: less than the others)."""
    separation_weight: float = Field(1.0, ge=0.0)
    """epsilon, on the Gaussian around people already placed in this frame (as alpha)."""
    score_max: float = Field(1.2, gt=0.0)
    """theta_track (our choice; the paper gives no value). Nothing at all where a body is expected scores 2, half of the
    body hidden about 1: half a body is still a match, less is not."""
    width_m: float = Field(0.40, gt=0.1, le=1.0)
    """W_avg, average torso width [m]; templates are 2 W_avg wide (Harville 2002, section 4: about 0.4)."""
    acceleration_std_mps2: float = Field(2.0, gt=0.0, le=20.0)
    """Random acceleration [m/s^2]: walkers start and stop within about 0.7 s at 1.4 m/s."""
    template_s: float = Field(0.10, gt=0.0, le=60.0)
    """Time constant of the templates [s] (Harville 2002, section 4: a relatively high gain)."""
    recentre_filled: float = Field(0.12, ge=0.0, le=1.0)
    """theta_HTcount, share of the template with height below which it has slipped. Harville 2002, section 4: around
    0.3, of coarse, smeared depth; a fully visible body fills 0.4 of a template here, and 0.3 of that is the same."""
    recentre_offset: float = Field(0.5, gt=0.0)
    """theta_HTcentroid, offset of the centroid [W_avg] beyond which a template has slipped (Harville 2002, section 4:
    around 0.5)."""
    area_min_m2: float = Field(0.10, gt=0.0)
    """Visible surface of a newcomer within a square of side W_avg [m^2] (the paper: high occupancy): a
    head and shoulders."""
    height_min_m: float = Field(1.2, ge=0.1, le=2.5)
    """Smallest height of a newcomer [m] (the paper: some plausible minimum): chairs reach 1.1 m."""
    confirm_s: float = Field(0.4, ge=0.0, le=60.0)
    """How long a newcomer must be tracked without a miss before it is a person [s] (the paper: some minimum number of
    consecutive frames)."""
    lost_s: float = Field(4.0, ge=0.0, le=600.0)
    """How long a lost person is looked for [s] (Harville 2002, section 4: e.g. 4)."""
    reattach_m: float = Field(2.0, ge=0.0)
    """How near to a lost person a newcomer continues that person [m] (Harville 2002, section 4: e.g. 2)."""
