import pytest

from calib.errors import InputError
from calib.length import parse_length, parse_size


@pytest.mark.parametrize(
    ("text", "metres"),
    [("24.23mm", 0.02423), ("2.5 cm", 0.025), ("0.1m", 0.1), ("1in", 0.0254), ("mm", 0.001), ("3e1mm", 0.03)],
)
def test_length_with_unit_is_metres(text: str, metres: float) -> None:
    assert parse_length(text) == pytest.approx(metres)


@pytest.mark.parametrize("text", ["", "24.23", "-3mm", "0mm", "nanmm", "infm", "24,23mm", "3 parsec", "mm24", "1e999m"])
def test_length_without_sense_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--square: expected"):
        parse_length(text, "--square")


def test_size_is_width_by_height() -> None:
    assert parse_size("1280x720") == (1280, 720)


@pytest.mark.parametrize("text", ["1280", "0x5", "ax3", "-1x4", "1.5x2"])
def test_size_without_sense_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="WIDTHxHEIGHT"):
        parse_size(text)
