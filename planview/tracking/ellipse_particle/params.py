"""Parameters of the ellipse-particle tracker."""

from __future__ import annotations

from pydantic import Field

from calib.params import Params
from planview.tracking.ellipse_particle.fit.ellipses import EllipseFitParams


class ImagePlaneParams(Params):
    """Ellipses in the image: the grid, the size and posture of people in it."""

    columns: int = Field(160, ge=40, le=2000)
    """Ellipses are fitted on a grid of at most about this many columns: a person 1/8 of the image high is then still
    15 cells high. Our choice; it is what bounds the time per frame."""
    person_height_px: float | None = Field(None, gt=0, le=20_000)
    """Height of a person in the image [px], the same in all rows; None learns it, row by row."""
    aspect: float = Field(0.36, gt=0, le=1)
    """Width over height of an object when its size is given. Our choice: 0.6 m of arms and stride over 1.7 m."""
    learn_s: float = Field(60.0, gt=0, le=3600)
    """Time over which the size is learned [s]: the first minute of a recording, before it is tracked."""
    outside_weight: float = Field(1.0, ge=0, le=10)
    """Weight of the added term of the likelihood: object area outside every measurement, against measured area that
    no object covers. Equation (8) alone does not punish it, so objects could drift off wherever another one covers
    their measurement. 1 treats both ways of disagreeing alike; 0 is the paper's equation, with which 7 instead of 8
    people are counted up the pavement clip."""
    newcomer_length: float = Field(0.4, ge=0, le=1)
    """Share of a person's length that must show of a new object, outside what others cover. Our choice: head and
    torso of a person whom another one hides in part; a suitcase has 0.3."""
    min_length: float = Field(0.5, ge=0, le=1)
    """The same of a known object; what is shorter shares its measurement with an older one (occlusion), or is a thing,
    and is pruned after twice ``existence.patience_s``. Our choice: a person from the hips up."""


class FloorPlaneParams(Params):
    """Ellipses on the plan-view occupancy map: the size of bodies from above, and who may be new."""

    person_area_m2: float = Field(0.4, gt=0, le=5)
    """Surface that a person shows to one camera [m^2] (1.7 m by 0.4 m, less gaps). Our choice; occupancy at half its
    mean density over the person's ellipse counts as full foreground."""
    half_length_m: float = Field(0.26, gt=0, le=2)
    """Half the shoulder width, arms included [m]."""
    aspect: float = Field(0.75, gt=0, le=1)
    """Depth over width of a body; between a standing adult's 0.55 and the 1.0 of a stride. Our choice."""
    separation_m: float = Field(0.42, ge=0, le=1)
    """Smallest distance between two people [m], a shoulder breadth less what clothes give."""
    height_min_m: float = Field(1.2, gt=0, le=2.5)
    """Until confirmed, a person must reach so high [m]: a seated adult; chairs and shadows do not."""
    arm_m: float = Field(0.9, ge=0, le=5)
    """What is this near to a confirmed person [m] and small beside that person is carried, or a limb: an arm's length
    and half a box."""
    piece_area: float = Field(0.35, ge=0, le=1)
    """Small means less than this share of that person's visible surface."""


class ParticleFilterParams(Params):
    """The particle filter of sections III and IV."""

    particles: int = Field(1000, ge=10, le=100_000)
    """Hypotheses N_s of equation (9). Our choice."""
    joint: bool = False
    """True: one joint filter over all objects, as in the paper. False: objects whose ellipses or measurements can
    overlap are filtered jointly and the rest apart, since a joint filter of many objects has few particles for each."""
    acceleration_mps2: float = Field(2.0, gt=0, le=50)
    """Deviation of the acceleration in the constant-velocity model [m/s^2]: walkers stop and turn within a second."""
    spawn_speed_mps: float = Field(1.2, gt=0, le=20)
    """Deviation of each velocity component of a new object [m/s]: walking speed."""
    shape_spread: float = Field(0.08, gt=0, le=1)
    """Stationary deviation of ln length and ln width of an object's ellipse about the prior. Our choice."""
    overlap_deviation: float = Field(0.12, gt=0, le=10)
    """Deviation of the area difference in equation (8), as a share of one object's area. Our choice: a measured
    ellipse moved by a fifth of its width."""


class ExistenceParams(Params):
    """When an object exists and when it has left (section V)."""

    false_alarms: float = Field(0.2, gt=0, le=100)
    """Expected false measurements per frame, the paper's parameter of the binomial. Our choice."""
    entries: float = Field(0.1, gt=0, le=100)
    """Expected new objects per frame; with ``false_alarms`` the prior that an uncovered measurement is an object."""
    detection: float = Field(0.85, gt=0, lt=1)
    """Probability of measuring a present object. Our choice."""
    repetition: float = Field(0.4, gt=0, lt=1)
    """Probability that a false measurement repeats in the same place. Our choice: legs that come into view before the
    body repeat for some frames; a person counted twice is worse than 0.2 s of delay."""
    confirm_probability: float = Field(0.8, gt=0.5, lt=1)
    """Probability of being an object above which a new one is confirmed, and of having left above which it is
    pruned."""
    min_overlap: float = Field(0.35, gt=0, lt=1)
    """Share of an object's ellipse that measurements must cover to count as measured; a measurement of which objects
    cover less than this share is uncovered. Our choice."""
    patience_s: float = Field(2.0, gt=0, le=600)
    """Mean N_t of the Gamma distribution: time without measurement after which an object has left [s];
    twice as long where it shares its measurement with another one (occlusion). Our choice."""
    reattach_m: float = Field(1.5, ge=0, le=20)
    """Farthest a lost object is reacquired from its prediction [m]. Harville 2002 uses 2 m from the last sight."""


class EllipseParticleParams(Params):
    """All parameters of ``EllipseParticleTracker``; which plane it works in is up to the recording."""

    image: ImagePlaneParams = ImagePlaneParams()
    """In the image of one camera."""
    floor: FloorPlaneParams = FloorPlaneParams()
    """On the floor below a stereo camera."""
    fit: EllipseFitParams = EllipseFitParams()
    """Ellipses."""
    filter: ParticleFilterParams = ParticleFilterParams()
    """Particles."""
    existence: ExistenceParams = ExistenceParams()
    """Who exists."""
