"""Shapes of the last update, for the debug views."""

from __future__ import annotations

from typing import Literal

import numpy as np

from calib.types import F32, F64
from planview.tracking.base import Drawing, TrackerDebug
from planview.tracking.ellipse_particle.planes import PlaneView

PARTICLES_SHOWN = 60


_CIRCLE = np.cos(np.linspace(0, 2 * np.pi, 33)), np.sin(np.linspace(0, 2 * np.pi, 33))


def draw(
    plane: Literal["image", "floor"], view: PlaneView, measured: F64, objects: F64, particles: F64, ids: list[int]
) -> TrackerDebug:
    """Measured ellipses, object ellipses with ids, a sample of the particles' positions, the foreground grid.

    Args:
        measured, objects: (M, 5), (N, 5) ellipses [cells].
        particles: (P, N, 7) states.
        ids: N of them.
    """
    shown = particles[:: max(1, len(particles) // PARTICLES_SHOWN), :, :2].reshape(-1, 2)
    points = view.to_plane(shown).astype(np.float32)
    return TrackerDebug(
        drawings=(
            Drawing("measurements", plane, tuple(outline(e, view) for e in measured)),
            Drawing("objects", plane, tuple(outline(e, view) for e in objects), tuple(str(i) for i in ids)),
            Drawing("particles", plane, tuple(p[None] for p in points)),
        ),
        tiles={"foreground": view.mask},
    )


def outline(ellipse: F64, view: PlaneView) -> F32:
    """(33, 2) float32 closed outline in plane units."""
    x, y, a, b, angle = (float(v) for v in ellipse)
    u, v = a * _CIRCLE[0], b * _CIRCLE[1]
    cells = np.column_stack([x + u * np.sin(angle) + v * np.cos(angle), y + u * np.cos(angle) - v * np.sin(angle)])
    return view.to_plane(cells).astype(np.float32)
