"""Ellipses and particles: Bayesian tracking without explicit association (del-Blanco, Jaureguizar, Garcia 2012)."""

from typing import TYPE_CHECKING, Any

from planview.tracking.ellipse_particle.params import EllipseParticleParams

if TYPE_CHECKING:
    from planview.tracking.ellipse_particle.tracker import EllipseParticleTracker

__all__ = ["EllipseParticleParams", "EllipseParticleTracker"]


def __getattr__(name: str) -> Any:
    # Every configuration holds the parameters; the tracker and its kernels are imported by runs that use it.
    if name != "EllipseParticleTracker":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from planview.tracking.ellipse_particle.tracker import EllipseParticleTracker

    return EllipseParticleTracker
