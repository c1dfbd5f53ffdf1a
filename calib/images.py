"""Images as grey, as colour, and as the content of a file."""

from pathlib import Path

import cv2
import numpy as np

from calib.errors import InputError
from calib.files import write_whole
from calib.types import U8


def as_grey(image: U8) -> U8:
    """(H, W) uint8 luma of a (H, W) or (H, W, 3) BGR image; the image itself when it has one channel."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def as_colour(image: U8) -> U8:
    """(H, W, 3) uint8 BGR of a (H, W) or (H, W, 3) image; the image itself when it has three channels."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), dtype=np.uint8) if image.ndim == 2 else image


def encode_image(image: U8, suffix: str = ".jpg", quality: int = 90) -> bytes:
    """The content of an image file.

    Args:
        image: (H, W) or (H, W, 3) uint8, BGR.
        suffix: ending of the file's name, which gives the format.
        quality: of a JPEG, 0 to 100. A PNG is compressed little, which is fast.
    Raises:
        ValueError: OpenCV knows no such format, or the image does not fit it.
    """
    settings = [cv2.IMWRITE_JPEG_QUALITY, quality] if suffix.lower() in {".jpg", ".jpeg"} else []
    if suffix.lower() == ".png":
        settings = [cv2.IMWRITE_PNG_COMPRESSION, 1]
    try:
        done, data = cv2.imencode(suffix, image, settings)
    except cv2.error as error:
        raise ValueError(f"expected an image that can be encoded as {suffix!r}, found shape {image.shape}") from error
    if not done:
        raise ValueError(f"expected an image that can be encoded as {suffix!r}, found shape {image.shape}")
    return data.tobytes()


def write_image(path: Path, image: U8, quality: int = 90) -> None:
    """Write an image file; the ending of its name gives the format (see ``encode_image``).

    Raises:
        InputError: no known image format.
        OSError: the file cannot be written.
    """
    try:
        content = encode_image(image, path.suffix, quality)
    except ValueError as error:
        raise InputError(f"{path}: expected a picture's name, e.g. {path.stem}.png, found {path.name!r}") from error
    write_whole(path, content)
