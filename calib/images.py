"""Images as grey, as colour, as the content of a file; and the focal length that a photograph holds."""

from __future__ import annotations

import math
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np

from calib.errors import InputError
from calib.io import expecting, write_whole
from calib.types import U8


def as_grey(image: U8) -> U8:
    """(H, W) uint8 luma of a (H, W) or (H, W, 3) BGR image; the image itself when it has one channel."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def as_colour(image: U8) -> U8:
    """(H, W, 3) uint8 BGR of a (H, W) or (H, W, 3) image; the image itself when it has three channels."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), dtype=np.uint8) if image.ndim == 2 else image


def encode_image(image: U8, suffix: str = ".jpg", quality: int = 90) -> bytes:
    """The content of an image file. Raises ValueError: OpenCV has no such format, or the image does not fit it."""
    jpeg = [cv2.IMWRITE_JPEG_QUALITY, quality]
    settings = {".jpg": jpeg, ".jpeg": jpeg, ".png": [cv2.IMWRITE_PNG_COMPRESSION, 1]}.get(suffix.lower(), [])
    with suppress(cv2.error):
        done, data = cv2.imencode(suffix, image, settings)
        if done:
            return data.tobytes()
    raise ValueError(f"expected an image that can be encoded as {suffix!r}, found shape {image.shape}")


def write_image(path: Path, image: U8, quality: int = 90) -> None:
    """Write an image file; the ending of its name gives the format (see ``encode_image``). Raises InputError: no known
    image format. OSError: the file cannot be written."""
    try:
        content = encode_image(image, path.suffix, quality)
    except ValueError as error:
        raise InputError(f"{path}: expected a picture's name, e.g. {path.stem}.png, found {path.name!r}") from error
    write_whole(path, content)


def focal_share(photo: Path | bytes) -> float:
    """Focal length over the diagonal of the image [1]: times the diagonal in pixels, the focal length in pixels. Raises
    InputError: no photograph, or one without it."""
    from PIL import Image, UnidentifiedImageError

    name = "the photograph" if isinstance(photo, bytes) else str(photo)
    with (
        expecting(name, "a photograph", OSError, UnidentifiedImageError, ValueError, TypeError, SyntaxError),
        Image.open(BytesIO(photo) if isinstance(photo, bytes) else photo) as image,
    ):
        millimetres = float(image.getexif().get_ifd(0x8769).get(0xA405, 0))  # focal length in 35 mm film
    if not 5 <= millimetres <= 2000:
        actual = f"{millimetres:g} mm" if millimetres else "none"
        raise InputError(f"{name}: expected EXIF with the focal length in 35 mm film, found {actual}")
    # Of film, whose diagonal angle defines it (Exif 2.32, tag 41989).
    return millimetres / math.hypot(36.0, 24.0)
