"""Parameters of the ellipse-particle tracker."""

from __future__ import annotations

from pydantic import Field

from calib.params import Params


class EllipseSizeParams(Params):
    """How large people are in the image."""

    columns: int = Field(320, ge=40, le=2000)
    """Columns of foreground that are enough [px]. Our choice; it bounds the time per frame."""
    cells: float = Field(28.0, ge=8, le=200)
    """Cells of the grid, at least a pixel of foreground each, along a person in the middle row. Our choice: legs are a
    cell wide, and an ellipse takes the same time whatever the image."""
    person_height_px: float | None = Field(None, gt=0, le=20_000)
    """Height of a person in the image [px], the same in all rows; None learns it, row by row."""
    learn_s: float = Field(60.0, gt=0, le=3600)
    """Time over which the size is learned [s]: the first minute of a recording, before it is tracked."""


class EllipseFitParams(Params):
    """How foreground becomes ellipses (section II)."""

    size_spread: float = Field(0.12, gt=0, le=1)
    """Deviation of the logarithm of an object's length and width from what is expected; at most three are measured. Our
    choice: the height of adults varies by 7 %, a walker's silhouette by about 10 % over a step."""
    background_weight: float = Field(0.4, ge=0, le=1)
    """Cost of covering a background cell, against 1 gained per foreground cell. Our choice: less than 1, because a
    silhouette fills only two thirds of its ellipse and detection leaves holes in people, seldom people in holes."""
    min_gain: float = Field(0.2, gt=0, lt=1)
    """Smallest gain that an ellipse must add on its own, as a share of its area. Our choice: a silhouette that fills
    two thirds gains 0.53, so a person hidden by half is measured, and a bag or a shadow of a third of a person is not.
    """
    cell_deviation: float = Field(0.7, gt=0, le=10)
    """Deviation of a cell's residual, correlation of neighbouring cells included. Our choice: a residual of 0.35 per
    cell (holes, limbs), the same over patches of 2 x 2 cells: 0.35 sqrt(4)."""


class ParticleFilterParams(Params):
    """The particle filter of sections III and IV."""

    particles: int = Field(1000, ge=10, le=100_000)
    """Hypotheses N_s of equation (9). Our choice."""
    acceleration_mps2: float = Field(2.0, gt=0, le=50)
    """Deviation of the acceleration in the constant-velocity model [m/s^2]: walkers stop and turn within a second."""
    speed_mps: float = Field(1.2, gt=0, le=20)
    """Deviation of each velocity component of a new object [m/s]: walking speed."""
    shape_spread: float = Field(0.08, gt=0, le=1)
    """Stationary deviation of ln length and ln width of an object's ellipse about the expected. Our choice."""
    overlap_deviation: float = Field(0.12, gt=0, le=10)
    """Deviation of the area difference in equation (8), as a share of one object's area. Our choice: a measured
    ellipse moved by a fifth of its width."""


class ExistenceParams(Params):
    """When an object exists and when it has left (section V)."""

    false_alarms: float = Field(2.0, gt=0, le=1000)
    """Expected false measurements for each object that enters, the parameter of the binomial. Our choice."""
    detection: float = Field(0.85, gt=0, lt=1)
    """Probability of measuring a present object. Our choice."""
    repetition: float = Field(0.4, gt=0, lt=1)
    """Probability that a false measurement repeats in the same place. Our choice: legs that come into view before the
    body repeat for some frames; a person counted twice is worse than 0.2 s of delay."""
    probability: float = Field(0.8, gt=0.5, lt=1)
    """Of being an object, above which a new one is confirmed, and of having left, above which it is pruned."""
    min_overlap: float = Field(0.35, gt=0, lt=1)
    """Share of an object's ellipse that measurements must cover to count as measured; a measurement of which objects
    cover less than this share is uncovered. Our choice."""
    moving: float = Field(0.05, ge=0, lt=1)
    """Share of an object's ellipse that must move in a frame which speaks for a new object: limbs and edges of a walker
    do; where a person of the first frames has left, nothing does. Our choice."""
    patience_s: float = Field(2.0, gt=0, le=600)
    """Mean N_t of the Gamma distribution: time without measurement after which an object has left [s]; twice as long
    where it shares its measurement with an older one (occlusion). Our choice."""
    reach_m: float = Field(1.5, ge=0, le=20)
    """Farthest a lost object is found again from its prediction [m]. Harville 2002 uses 2 m from the last sight."""


class EllipseParticleParams(Params):
    """All parameters of ``EllipseParticleTracker``."""

    size: EllipseSizeParams = EllipseSizeParams()
    """Sizes."""
    fit: EllipseFitParams = EllipseFitParams()
    """Ellipses."""
    filter: ParticleFilterParams = ParticleFilterParams()
    """Particles."""
    existence: ExistenceParams = ExistenceParams()
    """Who exists."""
