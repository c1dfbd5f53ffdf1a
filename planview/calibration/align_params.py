"""How heads are aligned by the people who walk before them."""

from pydantic import Field

from calib.params import Params


class AlignParams(Params):
    """How two heads are laid over each other; our choices."""

    clock_s: float = Field(10.0, ge=0.0, le=3600.0)
    """Largest difference of the times at which the two recordings begin [s]."""
    piece_s: float = Field(6.0, gt=1.0, le=60.0)
    """Length of the pieces of paths that are laid over each other [s]: a walk across a room."""
    piece_rms_m: float = Field(0.20, gt=0.0, le=1.0)
    """Pieces that fit worse are of different people [m]: twice the position error of a track."""
    meet_m: float = Field(0.40, gt=0.0, le=2.0)
    """Two positions nearer than this are of one person [m]: a torso's width."""
    height_m: float = Field(0.15, gt=0.0, le=1.0)
    """People whose heights differ by more are different [m]."""
    near_m: float = Field(0.25, gt=0.0, le=2.0)
    """The same once the motion is known [m]: farther ones are of people half hidden from one of the heads."""
    noise_m: float = Field(0.03, gt=0.0, le=1.0)
    """Differences of positions from which on they count linearly [m]."""
    shared_s: float = Field(8.0, ge=0.0)
    """Shortest time that people must be seen by both heads, added up [s]."""
    rival: float = Field(0.8, gt=0.0, le=1.0)
    """A quite different motion under which so large a share of the best one's people meet makes the result ambiguous:
    to and fro on one line is the same line turned by 180 degrees at another clock."""
    disparity_px: float = Field(0.07, ge=-2.0, le=2.0)
    """What is missing in the disparities of people [px]: they are small against the window of the matching, which mixes
    them with what is behind, so that they are found 2 to 4 cm too far away on small images, and heads that face each
    other would be found twice that apart. Measured against truth on a rendered recording of 320x240 (0.06 and 0.07)."""
    disparity_std_px: float = Field(0.05, ge=0.0, le=2.0)
    """Deviation of that from one camera to another [px]; it is a part of the deviations of x and y."""
    position_std_max_m: float = Field(0.10, gt=0.0)
    """Largest deviation of the position that is accepted [m]."""
    heading_std_max_deg: float = Field(2.0, gt=0.0)
    """Largest deviation of the heading that is accepted [deg]."""
    clock_std_max_s: float = Field(0.10, gt=0.0)
    """Largest deviation of the clock that is accepted [s]."""
