"""What a rerun recording of a run shows where."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb

from planview.drawing.plan import PlanBounds
from planview.engine.engine import Engine
from planview.engine.heads import HeadsPipeline
from planview.maps.view import StereoView

_MAP_LAYERS = [
    "plan/floor", "plan/grid", "plan/people", "plan/labels", "plan/search", "plan/template", "plan/ellipses",
    "plan/truth",
]  # fmt: skip
PEOPLE_TAB = 2
"""Number of people, which every tracker of one camera gives; not all have match scores."""


def blueprint(engine: Engine, people: PlanBounds | None = None) -> rrb.Blueprint:
    """Image and disparity, 3D view, both maps, decisions and series, side by side; one camera has a layout of its own.

    Args:
        people: where people were, which the views are fitted to; the visible floor when None.
    """
    stereo = engine.stereo
    if stereo is None:
        return _single(engine, people)
    image: rrb.Spatial2DView | rrb.Tabs = rrb.Spatial2DView(origin="image", name="image, foreground, people")
    others = [rrb.Spatial2DView(origin=f"{name}/image", name=name) for name, _ in other_heads(engine)]
    if others:
        image = rrb.Tabs(image, *others, active_tab=0)
    world = rrb.Spatial3DView(
        origin="world", name="3D", eye_controls=_eye(_bounds(stereo, people), (0.0, -0.75, 0.55)), line_grid=False,
    )  # fmt: skip
    height, occupancy = (
        _plan_view(f"{name} from above", [f"plan/{name}", *_MAP_LAYERS], _bounds(stereo, people))
        for name in ("height", "occupancy")
    )
    disparity = rrb.Spatial2DView(origin="disparity", name="disparity")
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(image, world),
            rrb.Horizontal(disparity, height, occupancy, _series()),
            row_shares=[3, 2],
        ),
        rrb.TimePanel(state="collapsed", timeline="frame"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _single(engine: Engine, people: PlanBounds | None) -> rrb.Blueprint:
    """One camera: its image large; the floor from above where it is known."""
    image = rrb.Spatial2DView(origin="image", name="image, people")
    right: list[rrb.View | rrb.Container] = []
    if engine.camera is not None:
        bounds = people or PlanBounds(-8.0, 0.0, 8.0, 16.0)
        right.append(_plan_view("floor from above", ["plan/trails", *_MAP_LAYERS], bounds))
    right.append(_series(active_tab=PEOPLE_TAB))
    return rrb.Blueprint(
        rrb.Horizontal(image, rrb.Vertical(*right), column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline="frame"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _series(active_tab: int = 0) -> rrb.Tabs:
    """Curves and decisions; ``errors`` are the significant ones, where there is truth."""
    return rrb.Tabs(
        rrb.TimeSeriesView(origin="score", name="match score"),
        rrb.TextLogView(origin="decisions", name="decisions"),
        rrb.TimeSeriesView(origin="people", name="people"),
        rrb.TimeSeriesView(origin="time_ms", name="stage times [ms]"),
        rrb.TextLogView(origin="errors", name="significant errors"),
        active_tab=active_tab,
    )


def _plan_view(name: str, layers: list[str], bounds: PlanBounds) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin="plan", contents=layers, name=name, eye_controls=_eye(bounds, (0.0, -0.001, 0.9)), line_grid=False,
    )  # fmt: skip


def other_heads(engine: Engine) -> list[tuple[str, StereoView]]:
    """Names, which are their paths in the recording, and views of all heads of a recording but the first."""
    if not isinstance(engine, HeadsPipeline):
        return []
    heads = zip(engine.recording.heads, engine.heads, strict=True)
    return [(head.name, each.stereo) for head, each in heads][1:]


def _eye(bounds: PlanBounds, direction: tuple[float, float, float]) -> rrb.EyeControls3D:
    """Looking at the middle of a part of the floor, from a direction, the way the camera looks upwards."""
    centre = np.array([(bounds.x_min_m + bounds.x_max_m) / 2, (bounds.y_min_m + bounds.y_max_m) / 2, 0.0])
    distance = max(1.1 * (bounds.x_max_m - bounds.x_min_m), 1.25 * (bounds.y_max_m - bounds.y_min_m), 3.0)
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=centre + distance * np.array(direction), look_target=centre,
        eye_up=(0.0, 1.0, 0.0) if abs(direction[1]) < 0.01 else (0.0, 0.0, 1.0),
    )  # fmt: skip


def _bounds(stereo: StereoView, people: PlanBounds | None) -> PlanBounds:
    return people or PlanBounds(*shown_floor(stereo))


def shown_floor(stereo: StereoView) -> tuple[float, float, float, float]:
    """Bounds of the visible floor, else of the grid; the place below the camera included [m]."""
    grid = stereo.grid
    x_min, y_min, x_max, y_max = stereo.floor.extent_m or (grid.x_min_m, grid.y_min_m, grid.x_max_m, grid.y_max_m)
    return min(x_min, 0.0), min(y_min, 0.0), max(x_max, 0.0), max(y_max, 0.0)
