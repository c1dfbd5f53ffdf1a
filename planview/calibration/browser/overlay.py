"""What is drawn over a frame, as SVG."""

from __future__ import annotations

import numpy as np

from calib.types import F64
from planview.calibration.browser.session import CalibrationSession
from planview.calibration.pictures import crowd
from planview.drawing.projection import grid_lines
from stereo.floor_camera import StereoFloorCamera

GIVEN, COMPUTED, CROWD, GRID, FLOOR = "#0a84ff", "#ff2fd0", "#b06cff", "#4cd964", "#ffcc00"


def overlay(session: CalibrationSession) -> str:
    """SVG of the floor grid, computed people, what was drawn, and the floor points; no script, only shapes."""
    return "".join([_grid(session), _computed(session), _drawn(session), _points(session)])


def _grid(session: CalibrationSession) -> str:
    if session.floor is not None and session.view is not None:
        reach = 2.0 * session.floor.height_m + 2.0
        stereo = StereoFloorCamera(session.view.geometry, session.floor.world_SE3_left)
        lines = grid_lines(stereo.project, (-reach, -reach, reach, 2 * reach), session.size)
    elif session.found is not None:
        camera = session.found.camera
        feet = camera.back_project(np.array([s.foot_px for s in session.samples]))
        feet = feet[np.isfinite(feet).all(axis=1)]
        if not len(feet):
            return ""
        low, high = feet.min(axis=0) - 2.0, feet.max(axis=0) + 2.0
        lines = grid_lines(camera.project, (*map(float, low), *map(float, high)), session.size)  # type: ignore[arg-type]
    else:
        return ""
    return "".join(_line(line.pixels, GRID, 1.0, "grid") for line in lines)


def _computed(session: CalibrationSession) -> str:
    if session.found is None:
        return ""
    camera, model = session.found.camera, session.found.model
    parts = [_hull(model.hull(camera, float(x), float(y)), CROWD, "crowd") for x, y in crowd(camera, model)]
    for sample in session.samples:
        x, y = camera.back_project(sample.foot_px)
        parts.append(_hull(model.hull(camera, float(x), float(y)), COMPUTED, "model"))
    return "".join(parts)


def _drawn(session: CalibrationSession) -> str:
    index = session.indices[session.shown]
    parts = []
    for sample in session.samples:
        faint = 1.0 if sample.frame == index else 0.45
        parts.append(_box(sample.box_px, faint, "sample"))
        parts += [_dot(point, GIVEN, "sample-point") for point in (sample.head_px, sample.foot_px)]
    if session.draft.box_px is not None:
        parts.append(_box(session.draft.box_px, 1.0, "draft"))
    parts += [_dot(p, GIVEN, "draft-point") for p in (session.draft.head_px, session.draft.foot_px) if p is not None]
    return "".join(parts)


def _points(session: CalibrationSession) -> str:
    parts = []
    for (u, v), metres in zip(session.floor_points, session.floor_metres(), strict=True):
        parts.append(_dot((u, v), FLOOR, "floor-point", 5.0))
        if metres is not None:
            parts.append(f'<text x="{u + 8:.1f}" y="{v - 8:.1f}" fill="{FLOOR}" font-size="14">')
            parts.append(f"{metres[0]:.2f}, {metres[1]:.2f} m</text>")
    return "".join(parts)


def _line(points: F64, colour: str, width: float, name: str) -> str:
    path = " ".join(f"{u:.1f},{v:.1f}" for u, v in points)
    return f'<polyline class="{name}" points="{path}" fill="none" stroke="{colour}" stroke-width="{width:g}"/>'


def _hull(hull: F64, colour: str, name: str) -> str:
    return _line(np.vstack([hull, hull[:1]]), colour, 1.5, name) if np.isfinite(hull).all() else ""


def _box(box: tuple[float, float, float, float], opacity: float, name: str) -> str:
    left, top, width, height = box
    return (
        f'<rect class="{name}" x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{height:.1f}" fill="none" '
        f'stroke="{GIVEN}" stroke-width="2" opacity="{opacity:g}"/>'
    )


def _dot(point: tuple[float, float], colour: str, name: str, radius: float = 4.0) -> str:
    return f'<circle class="{name}" cx="{point[0]:.1f}" cy="{point[1]:.1f}" r="{radius:g}" fill="{colour}"/>'
