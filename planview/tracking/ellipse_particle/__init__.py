"""Ellipses and particles: Bayesian tracking without explicit association (del-Blanco, Jaureguizar, Garcia 2012)."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from planview.tracking.ellipse_particle.params import (
    EllipseParticleParams,
    ExistenceParams,
    FloorPlaneParams,
    ImagePlaneParams,
    ParticleFilterParams,
)

if TYPE_CHECKING:
    from planview.tracking.ellipse_particle.floor_plane import FloorPlane
    from planview.tracking.ellipse_particle.image_plane import ImagePlane
    from planview.tracking.ellipse_particle.make import floor_ellipse_tracker, image_ellipse_tracker
    from planview.tracking.ellipse_particle.tracker import EllipseParticleTracker

__all__ = [
    "EllipseParticleParams",
    "EllipseParticleTracker",
    "ExistenceParams",
    "FloorPlane",
    "FloorPlaneParams",
    "ImagePlane",
    "ImagePlaneParams",
    "ParticleFilterParams",
    "floor_ellipse_tracker",
    "image_ellipse_tracker",
]
_HOMES = {
    "EllipseParticleTracker": "tracker",
    "FloorPlane": "floor_plane",
    "ImagePlane": "image_plane",
    "floor_ellipse_tracker": "make",
    "image_ellipse_tracker": "make",
}


def __getattr__(name: str) -> Any:
    # Every configuration holds the parameters; the tracker and its kernels are imported by runs that use it.
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
