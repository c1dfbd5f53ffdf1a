"""Random variants of the committed room with two stereo rigs."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.random_scenes.appearance import clothes, looks
from benchmarks.random_scenes.tables import RandomScene, resolved
from planview.synthetic.write import rigs_of

MARGIN_M = 0.7
"""People walk this far from walls; from those with a rig on them 1.4 m."""
LAYOUTS = {
    "opposite": ((0.36, 0.04, 84.0), (0.64, 0.96, 264.0)),
    "side by side": ((0.27, 0.04, 80.0), (0.73, 0.04, 100.0)),
    "corner": ((0.40, 0.04, 88.0), (0.97, 0.18, 150.0)),
}
"""Where two rigs hang, as shares of width and depth, and their heading [deg]: they look across each other."""
RIG = {
    "height_m": {"min": 2.25, "max": 2.55},
    "tilt_deg": {"min": 61.0, "max": 66.0},
    "roll_deg": {"min": -1.5, "max": 1.5},
    "focal_px": {"min": 106.0, "max": 123.0},
    "baseline_m": {"min": 0.14, "max": 0.18},
    "width": 320,
    "height": 240,
    "distortion": (-0.08, 0.02, 0.0003, -0.0002, 0.0),
}


def two_rigs(table: dict[str, Any], rng: np.random.Generator) -> RandomScene:
    """Two rigs of a random layout in the committed room, whose clocks begin apart, and people who walk about."""
    layout = str(rng.choice(list(LAYOUTS)))
    width, depth, _ = table["room"]["size_m"]
    east, north = 1.2 if layout == "corner" else MARGIN_M, 1.4 if layout == "opposite" else MARGIN_M
    area = (MARGIN_M, 1.4, width - east, depth - north)
    heads: list[dict[str, Any]] = []
    for name, (x, y, heading) in zip(("a", "b"), LAYOUTS[layout], strict=True):
        rig = resolved(RIG, rng)
        rig["at_m"] = (x * width + float(rng.uniform(-0.2, 0.2)), y * depth, rig.pop("height_m"))
        rig["heading_deg"] = heading + float(rng.uniform(-4, 4))
        rig["right_rotation_deg"] = tuple(float(v) for v in rng.uniform(-0.3, 0.3, 3))
        heads.append({"name": name, "start_s": float(rng.uniform(0.15, 1.4)) if heads else 0.0, "rig": rig})
    people = [_walker(i, width, area, rng) for i in range(int(rng.integers(2, 4)))]
    rigs = rigs_of(table | {"seed": int(rng.integers(1 << 31)), "people": people, "head": heads}, "a random scene")
    return RandomScene(rigs[0].scene, rigs=rigs)


def _walker(
    i: int, width: float, area_m: tuple[float, float, float, float], rng: np.random.Generator
) -> dict[str, Any]:
    """A person who enters through an opening and walks about until the end."""
    lane = 2.9 + (-0.5, 0.5, 0.0)[i % 3]
    start, behind, inside = [(x if i % 2 == 0 else width - x, y) for x, y in ((-2.1, 0.8), (-0.9, lane), (0.5, lane))]
    # The room is empty for so long, while the background is learned [s].
    way = {"start_m": start, "enter_s": 3.0 + 2.5 * i, "steps": [{"go": [behind, inside], "speed_mps": 1.2}]}
    wander = {"area_m": area_m, "speed_mps": (0.7, 1.3), "pause_s": (0.0, 1.0)}
    return looks(rng, float(rng.uniform(1.55, 1.9))) | clothes(rng) | way | {"wander": wander}
