"""How random people look, and the lamps, sun and exposure of a random scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from planview.synthetic.random_scenes.challenge import Challenge

_SHIRTS = ("#3a5a8a", "#b04838", "#3c6a4a", "#c8b8a0", "#24282c", "#d9a441", "#c05878", "#e0e0d8", "#6a4a8a", "#3878a0",
           "#8a5a3c", "#a8b4c0")  # fmt: skip
_TROUSERS = ("#2f3e58", "#3a3a44", "#55504a", "#6a5a44", "#24242a", "#46586e", "#8a7a60", "#403848")
_SKIN = ("#d0a080", "#e0b898", "#b98560", "#8a5a3c", "#6a4430")
_HAIR = ("#1c1a18", "#3a2a1c", "#6b4423", "#b08848", "#787470", "#c8c4bc")
_TEXTURES = ("plain", "plain", "stripes", "checks", "print")
EXPOSURE_DELAY_S = 0.7
"""Time constant with which an automatic exposure follows the light. Our choice: webcams take 0.5 to 1 s."""


def clothes(rng: np.random.Generator) -> dict[str, Any]:
    """Shirt and trousers of a person."""
    main, second = (str(c) for c in rng.choice(_SHIRTS, 2, replace=False))
    shirt: dict[str, Any] = {"texture": str(rng.choice(_TEXTURES)), "colour": main, "colour2": second}
    shirt |= {"scale_m": float(rng.uniform(0.05, 0.12)), "contrast": float(rng.uniform(0.2, 0.35))}
    trousers = {"colour": str(rng.choice(_TROUSERS)), "scale_m": 0.05, "contrast": float(rng.uniform(0.15, 0.3))}
    return {"shirt": shirt, "trousers": trousers, "skirt": bool(rng.random() < 0.15)}


def looks(rng: np.random.Generator, height_m: float) -> dict[str, Any]:
    """All of a person but clothes and movement."""
    style = str(rng.choice(("short", "short", "long", "bald"))) if height_m > 1.3 else "short"
    return {
        "height_m": float(height_m),
        "build": float(rng.uniform(0.88, 1.2)),
        "skin": str(rng.choice(_SKIN)),
        "hair": str(rng.choice(_HAIR)),
        "hair_style": style,
        "sleeves": str(rng.choice(("long", "short"))),
    }


def random_light(challenge: Challenge, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    """The scene's lights and sensor, as tables."""
    light = challenge.light
    room, lamps = challenge.room, []
    for k in range(light.lamps):
        x = room.width_m * (k + 0.5) / light.lamps + rng.uniform(-0.4, 0.4)
        at_m = (x, room.depth_m * rng.uniform(0.35, 0.75), room.height_m - 0.1)
        # One lamp throws the shadows that show; those of the others cost as much time and are filled by the first.
        lamps.append({"at_m": at_m, "level": float(rng.uniform(0.35, 0.6)), "shadows": k == 0})
    lights: dict[str, Any] = {"ambient": light.ambient, "lamps": lamps}
    if light.sun:
        lights["ambient"] = min(light.ambient, 0.3)
        side = float(rng.choice((-1.0, 1.0)))
        towards = (side * rng.uniform(0.5, 1.0), rng.uniform(-0.2, 0.5), -rng.uniform(0.45, 0.8))
        lamps.append({"kind": "sun", "towards": towards, "level": float(rng.uniform(0.6, 1.0)), "softness_deg": 0.6})
    for _ in range(light.changes):  # a lamp is dimmed for a while, at once or slowly
        lamp = lamps[int(rng.integers(len(lamps)))]
        start = float(rng.uniform(0.15, 0.75) * challenge.duration_s)
        ramp, stay, level = float(rng.choice((0.07, 0.5, 2.0))), float(rng.uniform(3, 8)), float(rng.uniform(0.15, 0.6))
        on_again = start + ramp + stay
        lamp.setdefault("dim", ((start, 1.0), (start + ramp, level), (on_again, level), (start + 2 * ramp + stay, 1.0)))
    sensor: dict[str, Any] = {
        "brightness": float(rng.uniform(0.2, 0.3)),
        "full_well_e": float(rng.uniform(6000, 16000)),
        "vignetting": float(rng.uniform(0.1, 0.3)),
        "mismatch": float(rng.uniform(0.0, 0.03)),
        "grey": challenge.camera.grey,
    }
    if light.automatic_exposure:
        sensor["exposure"] = automatic_exposure(lights, challenge.duration_s)
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
