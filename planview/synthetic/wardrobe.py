"""How drawn people look: height, build, clothes, hair."""

from __future__ import annotations

from typing import Any

import numpy as np

_SHIRTS = ("#3a5a8a", "#b04838", "#3c6a4a", "#c8b8a0", "#24282c", "#d9a441", "#c05878", "#e0e0d8", "#6a4a8a", "#3878a0",
           "#8a5a3c", "#a8b4c0")  # fmt: skip
_TROUSERS = ("#2f3e58", "#3a3a44", "#55504a", "#6a5a44", "#24242a", "#46586e", "#8a7a60", "#403848")
_SKIN = ("#d0a080", "#e0b898", "#b98560", "#8a5a3c", "#6a4430")
_HAIR = ("#1c1a18", "#3a2a1c", "#6b4423", "#b08848", "#787470", "#c8c4bc")
_TEXTURES = ("plain", "plain", "stripes", "checks", "print")


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
