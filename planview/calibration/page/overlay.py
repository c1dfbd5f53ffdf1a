"""Marks over a frame, as SVG."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined

from calib.types import F64
from planview.calibration.page.marks import Handle, handle_points
from planview.calibration.page.session import CalibrationSession
from planview.calibration.people import crowd, floor_around
from planview.drawing.image import grid_lines

GIVEN = "#0a84ff"
FLOOR = "#ffcc00"
SELECTED = "#ffffff"
ODD = "#ff453a"
_TEMPLATE = Environment(autoescape=True, undefined=StrictUndefined).from_string(
    Path(__file__).with_name("overlay.svg.j2").read_text(encoding="utf-8")
)


def overlay(session: CalibrationSession, everywhere: bool = False) -> str:
    """SVG of the floor grid, computed people (with ``everywhere`` all over the floor), the marks of this frame, and the
    floor points; no script."""
    found = session.solution.found
    people = []
    place = None
    if found is not None:

        def hull(xy_m: F64) -> F64:
            """Closed outline of a person; empty where the camera does not show it."""
            outline = found.model.hulls(found.camera, xy_m)
            return np.vstack([outline, outline[:1]]) if np.isfinite(outline).all() else outline[:0]

        people = [(hull(xy), "crowd") for xy in crowd(found.camera, found.model)] if everywhere else []
        people += [(hull(found.camera.back_project(s.foot_px)), "model") for _, s in session.here()]
        foot = found.assessment.next_sample
        if foot is not None:
            place = {"foot": foot, "hull": hull(found.camera.back_project(foot))}
    return _TEMPLATE.render(
        grid=_grid(session), people=people, next=place, samples=_samples(session), draft=session.draft,
        floor=_floor_points(session),
    )  # fmt: skip


def _grid(session: CalibrationSession) -> list[F64]:
    """Lines of the metric grid on the floor [px]."""
    found = session.solution.found
    lines = []
    if session.floor is not None and session.view is not None:
        reach = 2.0 * session.floor.height_m + 2.0
        stereo = session.view.geometry.above(session.floor.world_SE3_left)
        lines = grid_lines(stereo.project, (-reach, -reach, reach, 2 * reach), session.size)
    elif found is not None and (extent := floor_around(found.camera, session.samples)):
        lines = grid_lines(found.camera.project, extent, session.size)
    return [line.pixels for line in lines]


def _samples(session: CalibrationSession) -> list[dict[str, Any]]:
    odd = session.solution.found.odd if session.solution.found else ()
    selects = session.tool == "select"
    chosen = session.selected[0] if selects and session.selected and session.selected.part != "point" else None
    marks = []
    for number, sample in session.here():
        colour = SELECTED if number == chosen else ODD if number in odd else GIVEN
        points = [point for _, point in handle_points(sample)[: 6 if selects else 2]]
        marks.append({"box": sample.box_px, "number": number + 1, "colour": colour, "points": points})
    return marks


def _floor_points(session: CalibrationSession) -> list[dict[str, Any]]:
    solution = session.solution
    marks = []
    for number, point in enumerate(session.floor_points):
        colour = FLOOR
        text = ""
        if solution.found is not None:
            x, y = solution.found.camera.back_project(np.array(point)).tolist()
            text = f"{x:.2f}, {y:.2f} m" if math.isfinite(x + y) else ""
        elif solution.fit is not None and number < len(solution.fit.used):
            colour, off = (FLOOR, "") if solution.fit.used[number] else (ODD, " off the plane: not used")
            text = f"{round(100 * solution.fit.distance_m[number]):+d} cm{off}"
        selected = session.selected == Handle(number, "point")
        marks.append({"point": point, "text": text, "colour": colour, "selected": selected})
    return marks
