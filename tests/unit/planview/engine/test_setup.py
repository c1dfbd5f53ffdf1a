import numpy as np
import pytest

from calib.errors import InputError
from calib.types import F32
from planview.engine.setup import refuse_foreign_disparity
from stereo.matcher import DisparityRange

SHAPE, SEARCHED = (48, 64), DisparityRange(0, 64)


@pytest.fixture
def disparity() -> F32:
    """Rows from 8 to 40 px, the upper quarter unknown."""
    rows = np.linspace(8, 40, SHAPE[0], dtype=np.float32)[:, None] * np.ones((1, SHAPE[1]), dtype=np.float32)
    rows[:12] = np.nan
    return rows


def test_disparity_in_pixels_passes_unchanged(disparity: F32) -> None:
    given = disparity.copy()
    refuse_foreign_disparity(given, SHAPE, SEARCHED)
    np.testing.assert_array_equal(given, disparity)


def test_sixteenths_of_a_pixel_are_told(disparity: F32) -> None:
    with pytest.raises(InputError, match="sixteenths"):
        refuse_foreign_disparity(disparity * 16, SHAPE, SEARCHED)


def test_depth_in_millimetres_is_told(disparity: F32) -> None:
    with pytest.raises(InputError, match="or depth"):
        refuse_foreign_disparity(np.float32(54_000) / disparity, SHAPE, SEARCHED)


@pytest.mark.parametrize("none", [0.0, -1.0])
def test_number_that_stands_for_none_is_told(disparity: F32, none: float) -> None:
    with pytest.raises(InputError, match="expected NaN"):
        refuse_foreign_disparity(np.nan_to_num(disparity, nan=none), SHAPE, SEARCHED)


def test_other_shape_or_kind_of_number_is_told(disparity: F32) -> None:
    for other in (disparity[1:], disparity.astype(np.float64)):
        with pytest.raises(InputError, match="expected float32"):
            refuse_foreign_disparity(other, SHAPE, SEARCHED)
