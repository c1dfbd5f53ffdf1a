"""Marks over a frame, as SVG."""

from __future__ import annotations

import numpy as np

from calib.types import F64
from planview.calibration.page.marks import Handle, Point, handle_points
from planview.calibration.page.session import CalibrationSession
from planview.calibration.people import crowd, floor_around
from planview.drawing.image import grid_lines
from stereo.depth import StereoFloorCamera

GIVEN, COMPUTED, CROWD, GRID, FLOOR = "#0a84ff", "#ff2fd0", "#b06cff", "#4cd964", "#ffcc00"
SELECTED, ODD, NEXT = "#ffffff", "#ff453a", "#30d158"


def overlay(session: CalibrationSession, everywhere: bool = False) -> str:
    """SVG of the floor grid, computed people, the marks of this frame, and the floor points; no script.

    Args:
        everywhere: also people computed all over the floor.
    """
    parts = [_grid(session), _computed(session, everywhere), _next_place(session), _drawn(session), _points(session)]
    # A pixel's centre is half a pixel from the corner that SVG counts from.
    return f'<g transform="translate(0.5 0.5)">{"".join(parts)}</g>'


def _grid(session: CalibrationSession) -> str:
    found = session.solution.found
    if session.floor is not None and session.view is not None:
        reach = 2.0 * session.floor.height_m + 2.0
        stereo = StereoFloorCamera(session.view.geometry, session.floor.world_SE3_left)
        lines = grid_lines(stereo.project, (-reach, -reach, reach, 2 * reach), session.size)
    elif found is not None:
        extent = floor_around(found.camera, session.samples)
        lines = grid_lines(found.camera.project, extent, session.size) if extent else []
    else:
        return ""
    return "".join(_line(line.pixels, GRID, 1.0, "grid") for line in lines)


def _computed(session: CalibrationSession, everywhere: bool) -> str:
    found = session.solution.found
    if found is None:
        return ""
    places = [(found.camera.back_project(s.foot_px), COMPUTED, "model") for _, s in session.here()]
    if everywhere:
        places = [(xy, CROWD, "crowd") for xy in crowd(found.camera, found.model)] + places
    return "".join(_hull(found.model.hull(found.camera, float(x), float(y)), c, name) for (x, y), c, name in places)


def _next_place(session: CalibrationSession) -> str:
    found = session.solution.found
    if found is None or found.assessment.next_sample is None or found.assessment.enough:
        return ""
    u, v = found.assessment.next_sample.foot_px
    x, y = found.camera.back_project((u, v))
    outline = _hull(found.model.hull(found.camera, float(x), float(y)), NEXT, "next-place", dashed=True)
    return outline + _dot((u, v), NEXT, "next-foot") + _text((u, v), "add a person here", NEXT)


def _drawn(session: CalibrationSession) -> str:
    odd = session.solution.found.odd if session.solution.found else ()
    parts = []
    for number, sample in session.here():
        chosen = session.selected is not None and session.selected == Handle(number, session.selected.part)
        colour = SELECTED if chosen and session.tool == "select" else ODD if number in odd else GIVEN
        parts.append(_box(sample.box_px, colour, "sample"))
        points = handle_points(sample)[: 6 if session.tool == "select" else 2]
        parts += [_dot(point, colour, "sample-point") for _, point in points]
        parts.append(_text((sample.box_px[0], sample.box_px[1]), str(number + 1), colour))
    if session.draft.box_px is not None:
        parts.append(_box(session.draft.box_px, GIVEN, "draft"))
    parts += [_dot(p, GIVEN, "draft-point") for p in (session.draft.head_px, session.draft.foot_px) if p is not None]
    return "".join(parts)


def _points(session: CalibrationSession) -> str:
    parts = []
    fit = session.solution.fit
    metres = session.solution.metres(session.floor_points)
    for number, point in enumerate(session.floor_points):
        colour, text = FLOOR, ""
        place = metres[number]
        if fit is not None and number < len(fit.used):
            colour = FLOOR if fit.used[number] else ODD
            text = f"{round(100 * fit.distance_m[number]):+d} cm" + (
                "" if fit.used[number] else " off the plane: not used"
            )
        elif place is not None:
            text = f"{place[0]:.2f}, {place[1]:.2f} m"
        if session.selected == Handle(number, "point"):
            parts.append(_dot(point, SELECTED, "selected-point", 12.0))
        parts.append(_dot(point, colour, "floor-point"))
        parts.append(_text(point, text, colour) if text else "")
    return "".join(parts)


def _line(points: F64, colour: str, width: float, name: str, dashed: bool = False) -> str:
    path = " ".join(f"{u:.1f},{v:.1f}" for u, v in points)
    dashes = ' stroke-dasharray="6 4"' if dashed else ""
    return (
        f'<polyline class="{name}" points="{path}" fill="none" stroke="{colour}" stroke-width="{width:g}" '
        f'vector-effect="non-scaling-stroke"{dashes}/>'
    )


def _hull(hull: F64, colour: str, name: str, dashed: bool = False) -> str:
    return _line(np.vstack([hull, hull[:1]]), colour, 1.5, name, dashed) if np.isfinite(hull).all() else ""


def _box(box: tuple[float, float, float, float], colour: str, name: str) -> str:
    left, top, width, height = box
    return (
        f'<rect class="{name}" x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{height:.1f}" fill="none" '
        f'stroke="{colour}" stroke-width="1.5" vector-effect="non-scaling-stroke"/>'
    )


def _dot(point: Point, colour: str, name: str, size: float = 7.0) -> str:
    """A round cap of a line without length keeps its size on the screen at any zoom."""
    return (
        f'<path class="{name}" d="M{point[0]:.2f} {point[1]:.2f}h0" stroke="{colour}" stroke-width="{size:g}" '
        'stroke-linecap="round" vector-effect="non-scaling-stroke"/>'
    )


def _text(point: Point, text: str, colour: str) -> str:
    """The viewer's style sheet keeps the size on the screen at any zoom."""
    return (
        f'<text x="{point[0]:.1f}" y="{point[1]:.1f}" dx="0.4em" dy="-0.3em" fill="{colour}" stroke="#000" '
        f'paint-order="stroke">{text}</text>'
    )
