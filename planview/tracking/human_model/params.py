"""Parameters of the human-model tracker."""

from pydantic import Field

from calib.params import Params
from planview.tracking.human_model.model_map import HumanModelMapParams
from planview.tracking.identity import IdentityParams


class HumanMatchParams(Params):
    """Predicted models against foreground (Zhang et al. 2008, equation 1)."""

    acceleration_mps2: float = Field(default=2.0, gt=0, le=20)
    """Standard deviation of a walker's acceleration [m/s^2]. Our choice: starting, stopping and turning within a
    second at 1.3 m/s, with margin."""
    position_noise: float = Field(default=0.05, gt=0, le=0.5)
    """Standard deviation of a measured foot point, as a fraction of the model's height in the image. Our choice: legs
    swing by a tenth of the height."""
    ring: float = Field(default=0.5, ge=0, le=2)
    """Width beside the model, as a fraction of its width, where foreground is half covered; in half of it foreground
    starts no new target. Our choice: arms and stride reach 0.35 m from the axis, the torso cylinder 0.21 m."""
    overlap_weight: float = Field(default=0.3, ge=0, le=2)
    """Price of a pixel covered twice, in pixels. The paper's R_overlap has 1; less, since people do hide each other."""
    prior_weight: float = Field(default=0.04, ge=0, le=1)
    """Price of one squared standard deviation from the prediction, in model areas. Our choice."""
    refine_reach: float = Field(default=0.2, ge=0, le=0.4)
    """Largest error of head or foot, as a fraction of the height, that the ends of the blob may correct. Our choice:
    beyond it the blob is not this person alone."""
    learning_s: float = Field(default=0.9, gt=0, le=60)
    """Time constant with which a person's height and width are learned [s]. Our choice: about two steps."""
    coast_s: float = Field(default=1.0, gt=0, le=30)
    """Time constant with which the predicted speed of an unobserved target decays [s]. Our choice: a person hidden for
    longer has often stopped."""
    min_precision: float = Field(default=0.35, gt=0, lt=1)
    """Foreground fraction of the model's free part below which a target has no matching blob. Our choice: legs alone
    are a third of the outline."""
    min_free: float = Field(default=0.25, gt=0, lt=1)
    """Fraction of the model that no other model covers, below which a target is hidden and only predicted. Our
    choice."""


class StabilityParams(Params):
    """Motion and stability automata (section 4)."""

    window_s: float = Field(default=0.8, gt=0, le=10)
    """Time over which motion and trends are judged [s]. Our choice: about one and a half steps."""
    moving_mps: float = Field(default=0.25, gt=0, le=3)
    """Speed of the footprint from which a target is moving [m/s]. Our choice: swaying is slower, walking faster."""
    internal_motion: float = Field(default=0.04, gt=0, lt=1)
    """Fraction of the model's area in motion that is internal motion; half of it is asked of a tentative target. Our
    choice: a moving hand or head; edges that flicker in compressed video are less."""
    trend: float = Field(default=0.1, gt=0, lt=1)
    """Change of the visible fraction within the window that is appearing or disappearing. Our choice."""
    occlusion: float = Field(default=0.15, gt=0, lt=1)
    """Fraction of the model shared with other models that is an occlusion. Our choice."""
    uncertain_noise: float = Field(default=2.5, ge=1, le=20)
    """Factor on the measurement's standard deviation while disappearing or in occlusion, so that the prediction weighs
    more (section 4). Our choice."""


class PostureParams(Params):
    """Sitting: the paper's model stands, but its conference room has people on chairs (our choice)."""

    sitting: float = Field(default=0.77, gt=0.3, le=1)
    """Height of the seated model over the standing one: 0.52 of the stature from the seat to the top of the head, and a
    seat 0.45 m high. Our choice: anthropometric means."""
    place_m: float = Field(default=0.15, gt=0, le=1)
    """Standard deviation of a seated person's place [m]. Our choice: leaning and turning on a chair; a passer-by in
    front pushes the seated model aside no further."""
    rising_m: float = Field(default=0.5, gt=0, le=3)
    """Standard deviation of the place of a person who has just got up [m]. Our choice: half a second of walking."""
    empty: float = Field(default=0.5, gt=0, lt=1)
    """Share of the silhouette remembered on a seat below which it looks empty. Our choice: leaning moves less."""
    empty_s: float = Field(default=0.3, ge=0, le=10)
    """Time for which it must look so [s]. Our choice: longer than foreground flickers, shorter than two steps."""
    advantage: float = Field(default=0.1, ge=0, le=2)
    """Gain of the matching score, in standing model areas, that makes a person sit down or stand up. Our choice."""


class NewTargetParams(Params):
    """New targets (section 4). Of the four criteria non-occlusion needs no limit of its own, since what targets claim
    is taken out first: on PETS a limit on shared pixels is worth less than 0.001 MOTA."""

    min_precision: float = Field(default=0.6, gt=0, lt=1)
    """Size and shape: foreground fraction of the model's free part. Our choice: a walker fills three quarters of the
    outline; less when clothes are partly like the floor."""
    alone_precision: float = Field(default=0.45, gt=0, lt=1)
    """The same for a blob apart from known people: beside one, it may be an arm or a shadow. Where the camera looks
    down at it by 60 degrees or more, it is a person at once: from straight above a body that is half as deep as wide
    fills three quarters of what it fills from the side, and its size in the image hardly depends on the place.
    Elsewhere, a part that lasts for half of ``states.window_s`` may be a person whose clothes are like the wall or
    whose legs are hidden; it is confirmed when it has once been observed with ``min_precision``, or has walked
    ``prune.walked_m``. Our choice."""
    min_height_px: float = Field(default=30.0, ge=0, le=1000)
    """Size and shape: longest side of a person's box in the image [px]. Our choice: the head is then under 3 px wide,
    and a person is told from a bird or a bag by size alone. Known people are followed to ``map.min_height_px``."""
    min_share: float = Field(default=0.625, ge=0, le=1)
    """Smallest such side as a share of that of a person in the middle of the image, where this is less than
    ``min_height_px``: a camera is pointed at people, however small they are there. Our choice; on drawn views of unseen
    seeds worth 0.6 % of the crossings, and all people of a view in which everybody is below 30 px."""
    min_travel_m: float = Field(default=0.4, ge=0, le=5)
    """Motion salience: distance walked before a target is confirmed [m], beyond what may be an error of measurement.
    Our choice: a torso's width."""


class ExistenceParams(Params):
    """Evidence that a person exists, in seconds: it grows while the model has foreground of its own, and is used up
    while it should have some and has none (our choice, in place of limits for tentative and for confirmed people)."""

    trust: float = Field(default=1.0, gt=0, le=10)
    """Evidence gained per second of observation [1]. Our choice: a person may be missing for as long as observed."""
    patience_s: float = Field(default=3.0, gt=0, le=60)
    """Largest evidence [s]: for so long a fully visible person without blob is predicted. Our choice: passing behind a
    car or a column."""


class PruneParams(Params):
    """Merging, losing, reacquiring and pruning (section 4)."""

    merge_alone: float = Field(default=0.2, ge=0, lt=1)
    """Gain of the matching score by a second model over one in place of two, in model areas, below which they are one
    person; and foreground of its own, as a fraction of its area, that brings a lost target back. Our choice: a head, an
    arm or noise."""
    border_visible: float = Field(default=0.6, gt=0, le=1)
    """Visible fraction when last observed below which an unobserved target has left the view. Our choice."""
    gone_visible: float = Field(default=0.25, ge=0, lt=1)
    """Visibility: fraction of the model inside the image below which nobody is looked for, and a target has left, blob
    or not. Our choice: a head and shoulders."""
    inanimate_s: float = Field(default=20.0, gt=0, le=600)
    """Time without any internal motion after which a target is a thing [s]. Our choice: seated people move a hand or
    the head more often."""
    walked_m: float = Field(default=2.0, gt=0, le=50)
    """A target that has been this far from where it was spawned is no thing that was pushed or swivelled, and may
    be motionless for much longer [m]. Our choice: a chair that is pushed back moves by half of it."""
    still_s: float = Field(default=3.0, gt=0, le=600)
    """Time without motion after which unclaimed foreground is background [s]. Our choice."""
    reacquire_m: float = Field(default=1.5, ge=0, le=10)
    """A new target this near to where a lost one is predicted, and alike, is that one [m]. Our choice: a second of
    walking."""
    vanished_m: float = Field(default=3.0, ge=0, le=20)
    """A sitter that is found this near to where a person was lost inside the view is that person, whom nobody farther
    away hides; and people who have appeared this near to one another inside the view came in by one entrance [m]. Our
    choice: two seconds of walking."""
    vanished_s: float = Field(default=30.0, ge=0, le=3600)
    """For how long a person who was lost inside the view may be found sitting there [s]. Our choice: ten times
    ``existence.patience_s``, since others pass before a seat."""
    min_likeness: float = Field(default=1e-6, ge=0, le=1)
    """Likeness of colours (exp of minus ``IdentityLayer.unlikelihood``) below which a target is another person than the
    lost one. Our choice: a Bhattacharyya coefficient of 0.6 between one frame and the memory."""


class HumanModelParams(Params):
    """The tracker of Zhang, Venetianer and Lipton 2008."""

    height_m: float = Field(default=1.76, gt=0.5, le=2.5)
    """Height of the average person [m]. Table 1."""
    height_spread: float = Field(default=0.15, ge=0, le=0.5)
    """Largest deviation of a person's height from the average, as a fraction of it. Our choice: 1.5 to 2.0 m."""
    settle_s: float = Field(default=2.0, gt=0, le=30)
    """Time for which a change is provisional [s]: a target that has not walked by then is pruned, walkers of whom one
    model accounts for both for longer are one person, and a new target beside a person who sat down less long ago is
    that person. Our choice: people who cross overlap for less, and it takes a second to walk out of what was taken for
    a sitter."""
    map: HumanModelMapParams = HumanModelMapParams()
    """Where people are expected."""
    match: HumanMatchParams = HumanMatchParams()
    """Matching."""
    states: StabilityParams = StabilityParams()
    """Motion and stability states."""
    posture: PostureParams = PostureParams()
    """Sitting down and standing up."""
    spawn: NewTargetParams = NewTargetParams()
    """New targets."""
    existence: ExistenceParams = ExistenceParams()
    """Evidence of existence."""
    prune: PruneParams = PruneParams()
    """Merging, reacquiring and pruning."""
    identity: IdentityParams = IdentityParams()
    """Identity after occlusions."""
