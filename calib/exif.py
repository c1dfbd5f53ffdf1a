"""Focal length of a photograph by what its camera wrote into it (EXIF)."""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path

from calib.errors import InputError
from calib.text import reason

FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)
"""Of the film that "focal length in 35 mm film" refers to (Exif 2.32, tag 41989: the same diagonal angle)."""
FOCAL_IN_FILM = 0xA405
EXIF = 0x8769


def focal_share(photo: Path | bytes) -> float:
    """Focal length over the diagonal of the image [1]: times the diagonal in pixels, the focal length in pixels.

    Raises:
        InputError: no photograph, or one that does not say.
    """
    from PIL import Image, UnidentifiedImageError

    name = "the photograph" if isinstance(photo, bytes) else str(photo)
    try:
        with Image.open(BytesIO(photo) if isinstance(photo, bytes) else photo) as image:
            millimetres = float(image.getexif().get_ifd(EXIF).get(FOCAL_IN_FILM, 0))
    except (OSError, UnidentifiedImageError, ValueError, TypeError, SyntaxError) as error:
        raise InputError(f"{name}: expected a photograph, found {reason(error)}") from error
    if not 5 <= millimetres <= 2000:
        raise InputError(
            f"{name}: expected EXIF with the focal length in 35 mm film, found "
            f"{f'{millimetres:g} mm' if millimetres else 'none'}"
        )
    return millimetres / FILM_DIAGONAL_MM
