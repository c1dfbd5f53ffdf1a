"""Boards, squares, points and values as they are typed."""

import pytest

from calib.errors import InputError
from planview.commands.calibrate import parse_board, parse_square
from planview.commands.calibrate_pose import parse_points
from planview.commands.sweep import SweepOptions, sweep, varied


@pytest.mark.parametrize(
    ("words", "named"),
    [
        *[((text, 0.03, None, None), "--board") for text in ("9", "2x6", "99x6", "charuco:", "nine by six", "9x6x2")],
        (("charuco:2x2", 0.03, None, None), "--board"),
        ((None, 0.0001, None, None), "--square"),
        ((None, 24.23, None, None), "--square"),
        (("charuco:7x5", 0.03, None, "DICT_9X9"), "--dictionary"),
        (("charuco:7x5", 0.03, "40mm", None), "markers smaller than the squares"),
    ],
)
def test_board_without_sense_or_in_a_wrong_unit_is_refused(words, named):
    with pytest.raises(InputError, match=named):
        parse_board(*words)


@pytest.mark.parametrize("text", ["25", " 24.23 ", "2,5"])
def test_square_without_unit_is_refused_with_what_to_type(text):
    with pytest.raises(InputError, match=rf"type --square {text.strip()}mm"):
        parse_square(text)


def test_points_are_pixels_or_metres_but_not_both() -> None:
    assert parse_points(["1,2", "3,4", "5,6"])[1] and not parse_points(["1,2,3", "3,4,5", "5,6,7"])[1]
    with pytest.raises(InputError, match="found both"):
        parse_points(["1,2", "3,4,5", "5,6"])


def test_varied_values_are_those_of_a_parameter_and_seeds_those_of_the_study() -> None:
    assert varied(["maps.cell_m=0.03,0.04", "seed=1,2"]) == ({"maps.cell_m": [0.03, 0.04]}, [1, 2])


def test_sweep_without_a_process_is_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="--jobs: expected at least 1"):
        sweep([tmp_path], options=SweepOptions(out=tmp_path / "out", jobs=0))
