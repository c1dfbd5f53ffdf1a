"""What a rerun recording of a run shows where."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb

from planview.maps.view import StereoView
from planview.pipeline.engine import Engine
from planview.pipeline.heads import HeadsPipeline


def blueprint(engine: Engine) -> rrb.Blueprint:
    """Image and disparity, 3D view, both maps, decisions and series, side by side."""
    image: rrb.Spatial2DView | rrb.Tabs = rrb.Spatial2DView(origin="image", name="image, foreground, people")
    others = [rrb.Spatial2DView(origin=f"{name}/image", name=name) for name, _ in other_heads(engine)]
    if others:
        image = rrb.Tabs(image, *others, active_tab=0)
    decisions = rrb.TextLogView(origin="decisions", name="decisions")
    counts = rrb.TimeSeriesView(origin="people", name="people")
    times = rrb.TimeSeriesView(origin="time_ms", name="stage times [ms]")
    stereo = engine.stereo
    if stereo is None:
        below = rrb.Horizontal(decisions, rrb.Tabs(counts, times))
        return rrb.Blueprint(rrb.Vertical(image, below, row_shares=[3, 1]), collapse_panels=True)
    series = rrb.Tabs(rrb.TimeSeriesView(origin="score", name="match score"), counts, times, decisions)
    world = rrb.Spatial3DView(
        origin="world", name="3D", eye_controls=_eye(stereo, (0.0, -0.75, 0.55)), line_grid=False,
    )  # fmt: skip
    height, occupancy = (
        rrb.Spatial3DView(
            origin="plan", contents=[f"plan/{name}", "plan/people", "plan/search", "plan/template", "plan/ellipses"],
            name=f"{name} from above", eye_controls=_eye(stereo, (0.0, -0.001, 0.9)), line_grid=False,
        )
        for name in ("height", "occupancy")
    )  # fmt: skip
    disparity = rrb.Spatial2DView(origin="disparity", name="disparity")
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(image, world),
            rrb.Horizontal(disparity, height, occupancy, series),
            row_shares=[3, 2],
        ),
        collapse_panels=True,
    )


def other_heads(engine: Engine) -> list[tuple[str, StereoView]]:
    """Names, which are their paths in the recording, and views of all heads of a recording but the first."""
    if not isinstance(engine, HeadsPipeline):
        return []
    heads = zip(engine.recording.heads, engine.heads, strict=True)
    return [(head.name, each.stereo) for head, each in heads][1:]


def _eye(stereo: StereoView, direction: tuple[float, float, float]) -> rrb.EyeControls3D:
    """Looking at the middle of the floor in view, from a direction, the way the camera looks upwards."""
    x_min, y_min, x_max, y_max = shown_floor(stereo)
    centre = np.array([(x_min + x_max) / 2, (y_min + y_max) / 2, 0.0])
    distance = max(x_max - x_min, 1.6 * (y_max - y_min))
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=centre + distance * np.array(direction), look_target=centre,
        eye_up=(0.0, 1.0, 0.0) if abs(direction[1]) < 0.01 else (0.0, 0.0, 1.0),
    )  # fmt: skip


def shown_floor(stereo: StereoView) -> tuple[float, float, float, float]:
    """Bounds of the visible floor, else of the grid; the place below the camera included [m]."""
    grid = stereo.grid
    x_min, y_min, x_max, y_max = stereo.floor.extent_m or (grid.x_min_m, grid.y_min_m, grid.x_max_m, grid.y_max_m)
    return min(x_min, 0.0), min(y_min, 0.0), max(x_max, 0.0), max(y_max, 0.0)
