"""Parameters of the human-model tracker."""

from pydantic import Field

from calib.params import Params
from planview.tracking.human_model.model_map import HumanModelMapParams


class MatchParams(Params):
    """Predicted models against foreground (Zhang et al. 2008, equation 1)."""

    acceleration_mps2: float = Field(default=2.0, gt=0, le=20)
    """Standard deviation of a walker's acceleration [m/s^2]. Our choice: starting, stopping and turning within a
    second at 1.3 m/s, with margin."""
    position_noise: float = Field(default=0.05, gt=0, le=0.5)
    """Standard deviation of an observed foot point, as a fraction of the model's height in the image. Our choice: legs
    swing by a tenth of the height."""
    search_sigmas: float = Field(default=2.5, gt=0, le=6)
    """Search radius in standard deviations of the prediction. Our choice: 1 % of the true positions lie outside."""
    sweeps: int = Field(default=2, ge=1, le=10)
    """Rounds of the joint maximisation over all targets. Our choice: the second settles who owns shared pixels."""
    ring: float = Field(default=0.5, ge=0, le=2)
    """Width beside the model, as a fraction of its width, where foreground is half explained. Our choice: arms and
    stride reach 0.35 m from the axis, the torso cylinder 0.21 m."""
    claim: float = Field(default=0.25, ge=0, le=2)
    """Width beside the model, as a fraction of its width, whose foreground starts no new target. Our choice: less than
    ring, or two people side by side would never be told apart."""
    overlap_weight: float = Field(default=0.3, ge=0, le=2)
    """Price of a pixel covered twice, in pixels. The paper's R_overlap has 1; less, since people do hide each other."""
    prior_weight: float = Field(default=0.04, ge=0, le=1)
    """Price of one squared standard deviation from the prediction, in model areas. Our choice."""
    refine_reach: float = Field(default=0.3, ge=0, le=0.4)
    """Largest error of head or foot, as a fraction of the height, that the ends of the blob may correct. Our choice:
    beyond it the blob is not this person alone."""
    refine_height: float = Field(default=0.2, ge=0, le=1)
    """Largest difference between the blob's height and the model's for that. Our choice: legs or head are hidden."""
    height_gain: float = Field(default=0.05, ge=0, le=1)
    """Share of a frame in the learned height of a person. Our choice: about a second at 20 frames per second."""
    coast_s: float = Field(default=1.0, gt=0, le=30)
    """Time constant with which the predicted speed of a target without blob decays [s]. Our choice: who is hidden for
    longer has often stopped."""
    min_precision: float = Field(default=0.35, gt=0, lt=1)
    """Foreground fraction of the model's free part below which a target has no matching blob. Our choice: legs alone
    are a third of the outline."""
    min_free: float = Field(default=0.25, gt=0, lt=1)
    """Fraction of the model that no other model covers, below which a target is hidden and only predicted."""


class StateParams(Params):
    """Motion and stability automata (section 4)."""

    window_s: float = Field(default=0.8, gt=0, le=10)
    """Time over which motion and trends are judged [s]. Our choice: about one and a half steps."""
    moving_mps: float = Field(default=0.25, gt=0, le=3)
    """Speed of the footprint from which a target is moving [m/s]. Our choice: swaying is slower, walking faster."""
    internal_motion: float = Field(default=0.04, gt=0, lt=1)
    """Fraction of the model's area in motion that is internal motion. Our choice: a moving hand or head; edges that
    flicker in compressed video are less."""
    trend: float = Field(default=0.1, gt=0, lt=1)
    """Change of the visible fraction within the window that is appearing or disappearing. Our choice."""
    occlusion: float = Field(default=0.15, gt=0, lt=1)
    """Fraction of the model shared with other models that is an occlusion. Our choice."""
    uncertain_noise: float = Field(default=2.5, ge=1, le=20)
    """Factor on the observation's standard deviation while disappearing or in occlusion, so that the prediction weighs
    more (section 4). Our choice."""


class PostureParams(Params):
    """Sitting: the paper's model stands, but its conference room has people on chairs (our choice)."""

    sitting: float = Field(default=0.72, gt=0.3, le=1)
    """Height of the seated model over the standing one. Our choice: 1.27 m from the floor to the top of the head."""
    place_m: float = Field(default=0.15, gt=0, le=1)
    """Standard deviation of a seated person's place [m]. Our choice: leaning and turning on a chair; whoever passes in
    front pushes the seated model aside no further."""
    apart_m: float = Field(default=0.4, ge=0, le=2)
    """Least distance between two people who sit [m]. Our choice: a shoulder's breadth."""
    empty: float = Field(default=0.5, gt=0, lt=1)
    """Share of the silhouette remembered on a seat below which it looks empty. Our choice: leaning moves less."""
    empty_s: float = Field(default=0.3, ge=0, le=10)
    """Time for which it must look so [s]. Our choice: longer than foreground flickers, shorter than two steps."""
    hasty_s: float = Field(default=2.0, ge=0, le=10)
    """Time after sitting down in which somebody alike who walks nearby is that person [s]. Our choice: it takes a
    second to walk out of what was taken for somebody sitting."""
    rising_m: float = Field(default=0.5, gt=0, le=3)
    """Standard deviation of where somebody is who has just got up [m]. Our choice: half a second of walking."""
    advantage: float = Field(default=0.1, ge=0, le=2)
    """Gain of the matching score, in standing model areas, that makes a person sit down or stand up."""


class BirthParams(Params):
    """New targets (section 4, the four criteria)."""

    min_precision: float = Field(default=0.6, gt=0, lt=1)
    """Size and shape: foreground fraction of the model's visible area, for a blob on its own. Our choice: a walker
    fills three quarters of the outline; less when clothes are partly like the floor."""
    split_precision: float = Field(default=0.65, gt=0, lt=1)
    """The same for what is left of a blob that another target has a part of. Our choice: arms, bags and prams fill less
    of an outline."""
    min_recall: float = Field(default=0.45, ge=0, lt=1)
    """Size and shape: fraction of the unexplained blob around the model that the model covers."""
    min_core: float = Field(default=0.25, ge=0, le=1)
    """Size and shape: fraction of the model that is foreground proper, not less salient (shadow-like)."""
    min_height_px: float = Field(default=30.0, ge=0, le=1000)
    """Size and shape: longest side of a person's box in the image [px]. Our choice: the head is then under 3 px wide,
    and a person is told from a bird or a bag by size alone. Who is known is followed to ``map.min_height_px``."""
    min_visible: float = Field(default=0.4, gt=0, le=1)
    """Visibility: fraction of the model inside the image."""
    min_motion: float = Field(default=0.02, ge=0, lt=1)
    """Motion salience: fraction of the model's foreground in motion while it is tentative. Our choice: walking towards
    the camera moves a hand or a foot at least; a ghost of somebody who left moves nothing."""
    min_travel_m: float = Field(default=0.4, ge=0, le=5)
    """Motion salience: distance walked before a target is believed [m]. Our choice: a torso's width."""
    min_matches: int = Field(default=3, ge=1, le=100)
    """Frames matched before a target is believed. Our choice."""
    max_shared: float = Field(default=0.3, ge=0, le=1)
    """Non-occlusion: fraction of the model that existing targets may cover."""
    tentative_s: float = Field(default=2.0, gt=0, le=30)
    """Time after which a target that was never believed is dropped [s]. Our choice."""


class LifeParams(Params):
    """Merging, splitting, losing and removing (section 4)."""

    merge_alone: float = Field(default=0.2, ge=0, lt=1)
    """Foreground that only this model covers, as a fraction of its area, below which the target adds nothing to the
    matching score. Our choice: a head, an arm or noise."""
    merge_after_s: float = Field(default=2.0, gt=0, le=30)
    """It and those that cover it must have been moving for so long [s]. Our choice: people who cross overlap for
    less."""
    patience_s: float = Field(default=3.0, gt=0, le=60)
    """How long a fully visible target without blob is predicted [s]. Our choice: passing behind a car or a column."""
    border_visible: float = Field(default=0.6, gt=0, le=1)
    """Visible fraction when last seen below which a disappearing target has left the view. Our choice."""
    gone_visible: float = Field(default=0.25, ge=0, lt=1)
    """Fraction of the model inside the image below which a disappearing target has left, blob or not. Our choice."""
    inanimate_s: float = Field(default=20.0, gt=0, le=600)
    """Time without any internal motion after which a target is a thing [s]. Our choice: seated people move a hand or
    the head more often."""
    walked_m: float = Field(default=2.0, gt=0, le=50)
    """Who has been this far from where they came in is no thing that was pushed or swivelled [m]. Our choice: a chair
    that is pushed back moves by half of it."""
    asleep_s: float = Field(default=600.0, gt=0, le=36000)
    """Time without any internal motion after which even who walked so far is a thing [s]. Our choice: in small images
    attentive listeners show no motion for minutes."""
    still_s: float = Field(default=3.0, gt=0, le=600)
    """Time without motion after which unexplained foreground is background [s]. Our choice."""
    looks: int = Field(default=3, ge=1, le=100)
    """Frames in which both people are seen alone again before their colours are compared. Our choice."""
    doubt_s: float = Field(default=5.0, gt=0, le=60)
    """Time after an occlusion for which identities stay in doubt [s]. Our choice."""
    swap_gain: float = Field(default=0.08, gt=0, le=1)
    """Mean gain of colour similarity (Bhattacharyya, 0 to 1) for which two people are swapped. Our choice: the same
    person seen again differs by about 0.1."""
    reattach_m: float = Field(default=1.5, ge=0, le=10)
    """A new target this near to where a lost one is predicted, and alike, is that one [m]. Our choice: a second of
    walking."""
    alike: float = Field(default=0.6, ge=0, le=1)
    """Smallest similarity (Bhattacharyya) of colours of the same person. Our choice."""


class HumanModelParams(Params):
    """The tracker of Zhang, Venetianer and Lipton 2008."""

    height_m: float = Field(default=1.76, gt=0.5, le=2.5)
    """Height of the average person [m]. Table 1."""
    min_height: float = Field(default=0.85, gt=0.2, le=1)
    """Smallest height of a person, as a fraction of the average. Our choice: 1.5 m."""
    max_height: float = Field(default=1.15, ge=1, le=2)
    """Largest height of a person, as a fraction of the average. Our choice: 2.0 m."""
    map: HumanModelMapParams = HumanModelMapParams()
    """Where people are expected."""
    match: MatchParams = MatchParams()
    """Matching."""
    states: StateParams = StateParams()
    """Motion and stability states."""
    posture: PostureParams = PostureParams()
    """Sitting down and standing up."""
    birth: BirthParams = BirthParams()
    """New targets."""
    life: LifeParams = LifeParams()
    """Merging and removing."""
