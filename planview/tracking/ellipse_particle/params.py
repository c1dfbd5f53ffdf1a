"""Parameters of the ellipse-particle tracker."""

from __future__ import annotations

from pydantic import Field

from calib.params import Params


class EllipseSizeParams(Params):
    """How large people are in the image."""

    person_height_px: float | None = Field(None, ge=4, le=20_000)
    """Height of a person in the image [px], the same in all rows; None learns it, row by row."""


class ParticleFilterParams(Params):
    """The particle filter of sections III and IV."""

    particles: int = Field(1000, ge=10, le=20_000)
    """Hypotheses N_s of equation (9). Our choice."""
    speed_mps: float = Field(1.2, gt=0, le=20)
    """Deviation of each velocity component of a new object [m/s]: walking speed."""


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
    moving: float = Field(0.05, ge=0, lt=1)
    """Share of an object's ellipse that must move in a frame which speaks for a new object: limbs and edges of a walker
    do; where a person of the first frames has left, nothing does. Our choice."""
    patience_s: float = Field(2.0, gt=0, le=600)
    """Mean N_t of the Gamma distribution: time without measurement after which an object has left [s]; twice as long
    where it shares its measurement with an older one (occlusion). Our choice."""


class EllipseParticleParams(Params):
    """All parameters of ``EllipseParticleTracker``."""

    size: EllipseSizeParams = EllipseSizeParams()
    """Sizes."""
    filter: ParticleFilterParams = ParticleFilterParams()
    """Particles."""
    existence: ExistenceParams = ExistenceParams()
    """When objects exist."""
