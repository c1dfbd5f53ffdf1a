"""When fragments are one person, and how paths are filled and smoothed."""

from pydantic import Field

from calib.params import Params


class RefineParams(Params):
    """Offline refinement; values without a reference are our choice."""

    join_s: float = Field(3.0, ge=0, le=60)
    """Longest time between two fragments of one person [s]. Below Harville's 4 s (2002, section 4) of being gone: the
    longer the time, the more likely that another person came."""
    speed_max_mps: float = Field(2.5, gt=0, le=10)
    """Fastest mean speed between fragments, and over a gap that is filled [m/s]: a jog."""
    position_std_m: float = Field(0.05, gt=0, le=1)
    """Deviation of a position in the tracks [m]: about a cell of the plan-view map."""
    acceleration_std_mps2: float = Field(2.0, gt=0, le=20)
    """Random acceleration of the constant-velocity model [m/s^2], that of the template tracker."""
    speed_std_mps: float = Field(1.0, gt=0, le=10)
    """Deviation of the unknown velocity at the start of a track [m/s]."""
    drift_mps: float = Field(0.4, gt=0, le=5)
    """Growth of the deviation of a prediction over the time between fragments [m/s]: a person slows down or turns."""
    height_std_m: float = Field(0.06, gt=0, le=1)
    """Deviation of the median height of a fragment [m]: posture and depth noise."""
    cost_max: float = Field(9.0, gt=0, le=100)
    """Largest sum of squared normalised differences of a join: three deviations."""
    doubt_s: float = Field(15.0, ge=0, le=600)
    """How long before it was mended an exchange may have happened [s]: as long as the identity layer is in doubt."""
    contact_m: float = Field(0.6, gt=0, le=5)
    """Two people must have been this near for their ids to be exchanged [m]: bodies that touch, and their errors."""
    fill_s: float = Field(2.0, ge=0, le=60)
    """Longest gap that is filled [s]; beyond it the path is a guess and rows stay lost."""
