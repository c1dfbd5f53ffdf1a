"""Parameters of the foreground model, and the values of the masks that go into and come out of it."""

from __future__ import annotations

from pydantic import Field

from calib.params import Params

NO_FEEDBACK = 0
PERSON = 1
BACKGROUND = 2
"""Values of a feedback mask: a tracker's label of each pixel."""

FOREGROUND = 255
NEARER = 191
SHADOW = 127
"""Values of the kernels' mask; background is 0. What is nearer than the background has its colour: only depth shows
it apart. A shadow is one that its colour alone gives away."""
WALKER = 3
"""Feedback for one camera: a person who has left the first place, and so is not a ghost of the background."""


class ForegroundParams(Params):
    """Mixtures of Gaussians over (Y, U, V, disparity) per pixel (Harville, Gordon, Woodfill 2001)."""

    gaussians: int = Field(3, ge=2, le=5)
    """Gaussians per pixel. Harville 2001: 3 to 5."""
    beta: float = Field(12.25, ge=4, le=25)
    """Squared normalised distance below which an observation matches. Harville 2001: 2.5^2 to 3.5^2; the upper end,
    because three colour coordinates share it (chi-square, 3 degrees of freedom: 0.7 % of true matches lost)."""
    depth_relaxation: float = Field(4.0, ge=1, le=16)
    """Factor on beta for colour where depth agrees. Harville 2001: about 4."""
    min_depth_fraction: float = Field(0.2, gt=0, le=1)
    """Fraction of a Gaussian's observations that must have depth for its depth to count. Harville 2001: 0.2."""
    luma_noise: float = Field(4.0, gt=0, le=50)
    """Smallest standard deviation of luma (levels of 255). Our choice: 8-bit video of a lit room has 1-3 levels of
    noise, compression and mains flicker add as much."""
    chroma_noise: float = Field(2.5, gt=0, le=50)
    """Smallest standard deviation of U and V (levels of 255). Our choice: as luma_noise, times the 0.5 of U and V."""
    learning_rate: float = Field(1.0 / 60.0, gt=0, le=1)
    """Rate of the weights [1/s]: something new becomes background after about -ln(1 - background_weight) over this.
    Our choice: a chair that was moved is furniture again after half a minute."""
    adaptation_rate: float = Field(0.1, gt=0, le=5)
    """Rate of means and variances of a matched Gaussian [1/s]. Our choice: daylight changes within 10 s."""
    settle_s: float = Field(3.0, gt=0, le=60)
    """Start during which every observation counts alike (rate 1/n), and the time constant at pixels that are known
    to be background or that were uncovered [s]. The recordings start with three empty seconds."""
    activity_slowdown: float = Field(5.0, ge=1, le=100)
    """Factor by which active pixels learn slower. Harville 2001: about 5."""
    background_weight: float = Field(0.4, gt=0, lt=1)
    """The leading Gaussians up to this weight are background (T). Harville 2001: about 0.4."""
    deepest_weight: float = Field(0.2, gt=0, lt=1)
    """The deepest Gaussian with depth is background above this weight (T_D). Harville 2001: about 0.2."""
    fattening_px: int = Field(7, ge=0, le=50)
    """Distance by which the matcher carries a disparity beyond an outline [px of the matched image]: half of the window
    in which it asks for texture. 0 leaves all that depth alone separates from the background."""
    shadow_ratio: float = Field(0.35, gt=0, le=1)
    """Darkest shadow, as a fraction of the lit luma; inverted, where depth agrees, the brightest patch of light. Our
    choice: shade outdoors keeps a third of the image level after the camera's tone curve."""
    depth: bool = True
    """Compare depth, too, when there is one, as Harville 2001 does; false compares colour alone."""
    remove_colour_shadows: bool = False
    """Remove shadows by that ratio at equal chroma where there is no depth (for one camera without depth)."""
