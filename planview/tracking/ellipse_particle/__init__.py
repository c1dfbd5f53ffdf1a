"""Ellipses and particles: Bayesian tracking without explicit association (del-Blanco, Jaureguizar, Garcia 2012)."""

from planview.tracking.ellipse_particle.params import (
    DetectionParams,
    EllipseParticleParams,
    FilterParams,
    LifeParams,
    SizeParams,
)
from planview.tracking.ellipse_particle.tracker import EllipseParticleTracker

__all__ = [
    "DetectionParams",
    "EllipseParticleParams",
    "EllipseParticleTracker",
    "FilterParams",
    "LifeParams",
    "SizeParams",
]
