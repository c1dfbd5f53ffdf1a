"""The focal length that a phone writes into a photograph."""

from io import BytesIO

import pytest
from PIL import Image

from calib.errors import InputError
from calib.exif import focal_share


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
