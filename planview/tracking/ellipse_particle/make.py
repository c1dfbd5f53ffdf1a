"""Trackers of ellipses and particles for images and for plan-view maps."""

from __future__ import annotations

from calib.ground_camera import GroundCamera
from planview.tracking.ellipse_particle.floor_plane import FloorPlane
from planview.tracking.ellipse_particle.image_plane import ImagePlane
from planview.tracking.ellipse_particle.params import EllipseParticleParams
from planview.tracking.ellipse_particle.tracker import EllipseParticleTracker


def image_ellipse_tracker(
    params: EllipseParticleParams | None = None, camera: GroundCamera | None = None, seed: int = 0
) -> EllipseParticleTracker:
    """A tracker for the images of one camera; with a ``GroundCamera`` floor positions and heights are known too."""
    params = params or EllipseParticleParams()
    return EllipseParticleTracker(ImagePlane(params.image, camera), params, seed)


def floor_ellipse_tracker(params: EllipseParticleParams | None = None, seed: int = 0) -> EllipseParticleTracker:
    """A tracker for the plan-view maps of a stereo camera."""
    params = params or EllipseParticleParams()
    return EllipseParticleTracker(FloorPlane(params.floor), params, seed)
