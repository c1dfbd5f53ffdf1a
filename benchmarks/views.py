"""Random views of one camera (``data/synthetic/views``): scenes of a seed, what to count in them, and their truth."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from benchmarks.random_scenes.views import RandomView, random_view
from calib.errors import InputError
from calib.io import parse_toml, read_text
from calib.params import first_problem
from planview.synthetic.assets import SCENES
from planview.trajectories.table import Trajectories, read_truth

VIEWS = SCENES / "views"
"""The committed tables of views, one TOML each."""
FULL_BOX = ("full_left_px", "full_top_px", "full_width_px", "full_height_px")


def view_of_seed(path: Path, seed: int, changes: Mapping[str, Mapping[str, Any]] | None = None) -> RandomView:
    """The view of a table and a seed, with some values changed (see ``random_view``). Raises InputError: unreadable, or
    a value out of its range."""
    try:
        return random_view(parse_toml(read_text(path, "a view in TOML")), seed, path.stem, changes)
    except ValidationError as error:
        raise InputError(f"{path}: {first_problem(error)}") from error


def rules_of(view: RandomView, size: tuple[int, int]) -> dict[str, Any]:
    """The line of a view, and a zone in its middle: three quarters of its width and height, where there is floor."""
    camera = view.scene.camera
    assert camera is not None  # a view has one
    horizon = (camera.height - 1) / 2 - camera.focal_px / max(math.tan(math.radians(camera.tilt_deg)), 1e-6)
    left, right, bottom = size[0] / 8, 7 * size[0] / 8, size[1] - 1.0
    top = max(size[1] / 4, horizon + 0.05 * size[1])
    zone = {"name": "middle", "polygon_px": [[left, top], [right, top], [right, bottom], [left, bottom]]}
    return {
        "tripwire": [{"name": "line", "from_px": list(view.wire_px[0]), "to_px": list(view.wire_px[1])}],
        "zone": [zone],
    }


def full_truth(path: Path) -> Trajectories:
    """``truth.csv`` with the boxes of whole silhouettes inside the image, whatever hides them."""
    truth = read_truth(path)
    with path.open(newline="", encoding="utf-8") as file:
        rows = [[float(row[name] or "nan") for name in FULL_BOX] for row in csv.DictReader(file)]
    truth.box_px[:] = np.array(rows).reshape(-1, 4)
    return truth
