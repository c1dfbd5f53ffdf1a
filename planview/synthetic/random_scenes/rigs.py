"""Two stereo rigs that look into one room, at random: where they hang, who walks where, how their clocks differ."""

from __future__ import annotations

import math
import zlib
from typing import Any

import numpy as np

from planview.synthetic.random_scenes.appearance import clothes, looks, random_light
from planview.synthetic.random_scenes.challenge import Challenge
from planview.synthetic.write import RigScene, rigs_of

FPS = 10.0
DURATION_S = 36.0
PEOPLE = (2, 3)
MARGIN_M = 0.7
"""People walk this far from walls [m]; from those with a rig on them 1.4 m."""
LAYOUTS = ("opposite", "beside", "corner")


def random_rigs(seed: int) -> tuple[RigScene, ...]:
    """The rigs and the scene of a seed; the same seed gives the same recording."""
    rng = np.random.default_rng([seed, zlib.crc32(b"heads")])
    size = float(rng.uniform(6.5, 7.5)), float(rng.uniform(5.4, 6.2)), 2.9
    layout = LAYOUTS[seed % len(LAYOUTS)]
    challenge = Challenge.model_validate(
        {
            "description": f"two heads {layout}, people walk from one to the other",
            "covers": ["320x240"],
            "choreography": [{"kind": "wander"}],
            "room": dict(zip(("width_m", "depth_m", "height_m"), size, strict=True)),
            "light": {"lamps": 2, "ambient": float(rng.uniform(0.35, 0.6))},
        }
    )
    lights, sensor = random_light(challenge, rng)
    openings = [{"wall": wall, "from_m": 0.5 * size[1] - 1.2, "width_m": 2.4} for wall in ("west", "east")]
    table: dict[str, Any] = {
        "description": challenge.description,
        "seed": int(rng.integers(1 << 31)),
        "fps": FPS,
        "duration_s": DURATION_S,
        "room": {
            "size_m": size,
            "floor": {
                "texture": "tiles",
                "colour": "#a39a8a",
                "scale_m": float(rng.uniform(0.2, 0.5)),
                "contrast": 0.3,
            },
            "walls": {"colour": "#d6d0c2", "scale_m": 0.8, "contrast": 0.08},
            "openings": openings,
            "panels": [{"wall": wall, "from_m": float(rng.uniform(1, 4))} for wall in ("north", "south")],
        },
        "furniture": [{"kind": "plant", "at_m": (0.5, size[1] - 0.5)}, {"kind": "box", "at_m": (size[0] - 0.5, 0.5)}],
        "lights": lights,
        "sensor": sensor,
        "people": [_walker(i, size, layout, rng) for i in range(int(rng.integers(PEOPLE[0], PEOPLE[1] + 1)))],
        "head": _heads(layout, size, rng),
    }
    return rigs_of(table, f"seed {seed}")


def _heads(layout: str, size: tuple[float, float, float], rng: np.random.Generator) -> list[dict[str, Any]]:
    """Two mounts on the walls, one to one and a half shoulder-heights above people, looking across each other."""
    width, depth, _ = size
    first, second = {
        "opposite": ((0.36 * width, 0.2, 84.0), (0.64 * width, depth - 0.2, 264.0)),
        "beside": ((0.27 * width, 0.2, 80.0), (0.73 * width, 0.2, 100.0)),
        "corner": ((0.40 * width, 0.2, 88.0), (width - 0.2, 0.18 * depth, 150.0)),
    }[layout]
    starts = 0.0, float(rng.uniform(0.15, 1.4))
    return [
        {
            "name": name,
            "start_s": start,
            "rig": {
                "at_m": (x + float(rng.uniform(-0.2, 0.2)), y, float(rng.uniform(2.25, 2.55))),
                "heading_deg": heading + float(rng.uniform(-4, 4)),
                "tilt_deg": float(rng.uniform(61, 66)),
                "roll_deg": float(rng.uniform(-1.5, 1.5)),
                "width": 320,
                "height": 240,
                "focal_px": 160 / math.tan(math.radians(rng.uniform(66, 74)) / 2),
                "baseline_m": float(rng.uniform(0.14, 0.18)),
                "right_rotation_deg": tuple(float(v) for v in rng.uniform(-0.3, 0.3, 3)),
                "distortion": (-0.08, 0.02, 0.0003, -0.0002, 0.0),
            },
        }
        for name, start, (x, y, heading) in zip(("a", "b"), starts, (first, second), strict=True)
    ]


def _walker(i: int, size: tuple[float, float, float], layout: str, rng: np.random.Generator) -> dict[str, Any]:
    """A person who enters through an opening and walks about until the end."""
    width, depth, _ = size
    west = i % 2 == 0
    lane = 0.5 * depth + (-0.5, 0.5, 0.0)[i % 3]
    hidden, behind, inside = (-2.1, 0.5 * depth - 2.1), (-0.9, lane), (0.5, lane)
    way = [p if west else (width - p[0], p[1]) for p in (hidden, behind, inside)]
    north = 1.4 if layout == "opposite" else MARGIN_M
    east = 1.2 if layout == "corner" else MARGIN_M
    # The room is empty for so long, while the background is learned [s].
    return (
        looks(rng, float(rng.uniform(1.55, 1.9)))
        | clothes(rng)
        | {
            "start_m": way[0],
            "enter_s": 3.0 + 2.5 * i,
            "face_deg": 0.0 if west else 180.0,
            "steps": [{"go": way[1:], "speed_mps": 1.2}],
            "wander": {
                "area_m": (MARGIN_M, 1.4, width - east, depth - north),
                "speed_mps": (0.7, 1.3),
                "pause_s": (0.0, 1.0),
            },
        }
    )
