"""Images as grey, colour and file content, and the focal length that a photograph holds."""

from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from calib.errors import InputError
from calib.images import as_colour, as_grey, encode_image, focal_share, write_image

BLUE = np.full((2, 3, 3), (255, 0, 0), np.uint8)
GREY = np.arange(6, dtype=np.uint8).reshape(2, 3)


def test_grey_and_colour_of_an_image() -> None:
    np.testing.assert_array_equal(as_grey(BLUE), np.full((2, 3), 29))
    assert as_grey(GREY) is GREY
    np.testing.assert_array_equal(as_colour(GREY), np.dstack([GREY] * 3))


def test_png_holds_the_image_exactly(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", BLUE)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.png")), BLUE)


def test_jpeg_of_lower_quality_is_smaller() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (64, 64), dtype=np.uint8)
    assert len(encode_image(noise, quality=50)) < len(encode_image(noise, quality=95))


@pytest.mark.parametrize("name", ["floor.toml", "floor"])
def test_picture_of_no_known_format_is_refused_by_name(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=rf"e\.g\. floor\.png, found '{name}'"):
        write_image(tmp_path / name, BLUE)
    assert not (tmp_path / name).exists()


def photograph(millimetres: int | None) -> bytes:
    image, exif = Image.new("RGB", (40, 30)), Image.Exif()
    if millimetres is not None:
        exif.get_ifd(0x8769)[0xA405] = millimetres
    content = BytesIO()
    image.save(content, "JPEG", exif=exif)
    return content.getvalue()


def test_focal_length_of_film_is_relative_to_its_diagonal() -> None:
    assert focal_share(photograph(26)) == pytest.approx(26 / 43.267, rel=1e-4)


@pytest.mark.parametrize("content", [photograph(None), b"no photograph", b""])
def test_photograph_without_a_focal_length_is_refused(content: bytes) -> None:
    with pytest.raises(InputError, match="expected"):
        focal_share(content)
