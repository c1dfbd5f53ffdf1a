"""The layout of a rerun recording."""

import re
from pathlib import Path

import planview.tracking
from planview.output.rerun_shapes import MAP_LAYERS


def test_the_maps_show_every_shape_that_a_tracker_draws_on_the_floor():
    sources = Path(planview.tracking.__path__[0]).rglob("*.py")
    names = {name for path in sources for name in re.findall(r'Drawing\("(\w+)", "floor"', path.read_text("utf-8"))}
    assert {"bodies", "footprints"} <= names
    assert {f"plan/{name}" for name in names} <= set(MAP_LAYERS)
