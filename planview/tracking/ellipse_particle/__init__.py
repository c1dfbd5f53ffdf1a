"""Ellipses and particles: Bayesian tracking without explicit association (del-Blanco, Jaureguizar, Garcia 2012)."""

from planview.tracking.ellipse_particle.tracker import EllipseParticleParams, EllipseParticleTracker

__all__ = ["EllipseParticleParams", "EllipseParticleTracker"]
