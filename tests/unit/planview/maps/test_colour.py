import numpy as np
import pytest

from planview.foreground.gain import Exposure
from planview.maps import _kernels as kernels
from planview.maps.colour import CHROMA_EDGES, CODES, LUMA_CELLS, colour_codes, smoothing
from tests.reference import maps as reference

REFERENCE = Exposure()


def codes_of(colour: tuple[int, int, int], exposure: Exposure = REFERENCE) -> int:
    image = np.full((1, 1, 3), colour, np.uint8)
    return int(colour_codes(image, np.zeros(1, np.int32), exposure)[0])


def test_colour_codes_of_grey_lie_in_the_middle_of_chroma() -> None:
    # Luma 100 is in the fourth of eight cells; U and V are in the third of five.
    assert codes_of((100, 100, 100)) == (3 * 5 + 2) * 5 + 2


def test_colour_codes_of_a_grey_image_equal_those_of_grey_colours() -> None:
    image = np.array([[10, 200]], np.uint8)
    both = colour_codes(image, np.array([0, 1], np.int32), Exposure())
    assert both.tolist() == [codes_of((10, 10, 10)), codes_of((200, 200, 200))]


def test_colour_codes_do_not_change_with_the_exposure() -> None:
    assert codes_of((110, 50, 70)) == codes_of((165, 75, 105), Exposure(1.5, 0.0))


@pytest.mark.parametrize("colour", [(0, 0, 0), (255, 255, 255), (255, 0, 0), (0, 255, 0), (0, 0, 255)])
def test_colour_codes_stay_within_their_range(colour: tuple[int, int, int]) -> None:
    assert 0 <= codes_of(colour) < CODES


def test_smoothing_keeps_the_mass_of_a_histogram() -> None:
    np.testing.assert_allclose(smoothing().sum(axis=1), 1.0, rtol=1e-5)


@pytest.mark.parametrize("channels", [1, 3])
def test_colour_kernel_equals_its_reference(channels: int) -> None:
    rng = np.random.default_rng(channels)
    image, edges = rng.integers(0, 256, 300 * channels).astype(np.uint8), np.float32(CHROMA_EDGES)
    pixels = rng.permutation(300)[:200].astype(np.int32)
    ours, theirs = np.empty(200, np.uint8), np.empty(200, np.uint8)
    for module, codes in ((kernels, ours), (reference, theirs)):
        module.encode_colours(image, channels, pixels, 1.3, -4.5, LUMA_CELLS, edges, codes)
    np.testing.assert_array_equal(ours, theirs)
