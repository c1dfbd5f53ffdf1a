"""How people, floors and light of random scenes look."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.random_scenes.tables import LightTable
from planview.synthetic.scene import Triple

SHIRTS = ("#3a5a8a", "#b04838", "#3c6a4a", "#c8b8a0", "#24282c", "#d9a441", "#c05878", "#e0e0d8", "#6a4a8a", "#3878a0",
          "#8a5a3c", "#a8b4c0")  # fmt: skip
TROUSERS = ("#2f3e58", "#3a3a44", "#55504a", "#6a5a44", "#24242a", "#46586e", "#8a7a60", "#403848")
SKIN = ("#d0a080", "#e0b898", "#b98560", "#8a5a3c", "#6a4430")
HAIR = ("#1c1a18", "#3a2a1c", "#6b4423", "#b08848", "#787470", "#c8c4bc")
TEXTURES = ("plain", "plain", "stripes", "checks", "print")
FLOORS = (("tiles", "#a39a8a"), ("wood", "#b98f5f"), ("carpet", "#5c6a78"), ("carpet", "#786858"),
          ("concrete", "#8f959a"))  # fmt: skip
EXPOSURE_DELAY_S = 0.7
"""Time constant with which an automatic exposure follows the light. Webcams take 0.5 to 1 s."""


def clothes(rng: np.random.Generator) -> dict[str, Any]:
    """Shirt and trousers of a person."""
    main, second = (str(c) for c in rng.choice(SHIRTS, 2, replace=False))
    shirt: dict[str, Any] = {"texture": str(rng.choice(TEXTURES)), "colour": main, "colour2": second}
    shirt |= {"scale_m": float(rng.uniform(0.05, 0.12)), "contrast": float(rng.uniform(0.2, 0.35))}
    trousers = {"colour": str(rng.choice(TROUSERS)), "scale_m": 0.05, "contrast": float(rng.uniform(0.15, 0.3))}
    return {"shirt": shirt, "trousers": trousers, "skirt": bool(rng.random() < 0.15)}


def looks(rng: np.random.Generator, height_m: float) -> dict[str, Any]:
    """All of a person but clothes and movement."""
    return {
        "height_m": float(height_m),
        "build": float(rng.uniform(0.88, 1.2)),
        "skin": str(rng.choice(SKIN)),
        "hair": str(rng.choice(HAIR)),
        "hair_style": str(rng.choice(("short", "short", "long", "bald"))) if height_m > 1.3 else "short",
        "sleeves": str(rng.choice(("long", "short"))),
    }


def floor_surface(rng: np.random.Generator, gloss: float) -> dict[str, Any]:
    """A floor that mirrors this share of the light."""
    texture, colour = FLOORS[int(rng.integers(len(FLOORS)))]
    scale_m, contrast = float(rng.uniform(0.15, 0.5)), float(rng.uniform(0.12, 0.38))
    return {"texture": texture, "colour": colour, "scale_m": scale_m, "contrast": contrast, "gloss": gloss}


def lights_and_sensor(
    light: LightTable, room_m: Triple, duration_s: float, rng: np.random.Generator
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Lights of a room of this size and the sensor, as tables of a scene."""
    width, depth, height = room_m
    lamps: list[dict[str, Any]] = []
    for k in range(light.lamps):
        x = width * (k + 0.5) / light.lamps + rng.uniform(-0.4, 0.4)
        # A lamp's level is that 2 m away: high ones are brighter. One lamp throws the shadows that show; those of the
        # others cost as much time and are filled by the first.
        level = float(rng.uniform(0.3, 0.55)) * max(1.0, (height / 2.8) ** 2)
        at_m = (x, depth * rng.uniform(0.35, 0.8), height - 0.1)
        lamps.append({"at_m": at_m, "level": level, "shadows": k == 0})
    if light.sun:
        towards = (float(rng.choice((-1, 1)) * rng.uniform(0.5, 1)), rng.uniform(-0.2, 0.5), -rng.uniform(0.45, 0.8))
        lamps.append({"kind": "sun", "towards": towards, "level": float(rng.uniform(0.6, 0.9)), "softness_deg": 0.6})
    for _ in range(light.changes if lamps else 0):
        lamp = lamps[int(rng.integers(len(lamps)))]
        start = float(rng.uniform(0.15, 0.75) * duration_s)
        ramp, stay, level = float(rng.choice((0.07, 0.5, 2.0))), float(rng.uniform(3, 8)), float(rng.uniform(0.15, 0.6))
        dark, on_again = start + ramp, start + ramp + stay
        lamp.setdefault("dim", ((start, 1.0), (dark, level), (on_again, level), (on_again + ramp, 1.0)))
    lights = {"ambient": light.ambient, "lamps": lamps}
    sensor: dict[str, Any] = {
        "brightness": light.brightness or float(rng.uniform(0.2, 0.3)),
        "full_well_e": light.full_well_e or float(rng.uniform(6000, 16000)),
        "blur_px": light.blur_px,
        "vignetting": float(rng.uniform(0.1, 0.3)),
        "mismatch": float(rng.uniform(0.0, 0.03)),
    }
    if light.automatic_exposure:
        sensor["exposure"] = automatic_exposure(lights, duration_s)
    return lights, sensor


def automatic_exposure(lights: dict[str, Any], duration_s: float) -> tuple[tuple[float, float], ...]:
    """Keyframes of the exposure that holds the room's mean level, following it with EXPOSURE_DELAY_S.

    The mean level is taken to be that of the ambient light and the lamps' levels together.
    """
    times = np.arange(0.0, duration_s, 0.1)
    total = np.full(len(times), float(lights["ambient"]))
    for lamp in lights["lamps"]:
        dim = np.array(lamp.get("dim", ((0.0, 1.0),)))
        total += lamp["level"] * np.interp(times, dim[:, 0], dim[:, 1])
    wanted, exposure = total[0] / total, np.ones(len(times))
    for k in range(1, len(times)):
        exposure[k] = exposure[k - 1] + 0.1 / EXPOSURE_DELAY_S * (wanted[k] - exposure[k - 1])
    return tuple((float(t), float(e)) for t, e in zip(times, exposure, strict=True))
