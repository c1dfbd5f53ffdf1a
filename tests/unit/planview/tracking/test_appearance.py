import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planview.maps.builder import FloorPoints
from planview.maps.colour import CODES
from planview.tracking._appearance_kernels import colour_histograms
from planview.tracking.appearance import appearances
from tests.reference import appearance as reference


def points(rows: list[tuple[float, float, float]], colours: list[int]) -> FloorPoints:
    xyz = np.array(rows, np.float32).reshape(-1, 3)
    area = np.full(len(xyz), 0.01, np.float32)
    return FloorPoints(xyz, area, np.arange(len(xyz), dtype=np.int32), np.array(colours, np.uint8))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n_people=st.integers(1, 4))
def test_colour_histograms_equal_their_reference(seed: int, n_people: int) -> None:
    rng = np.random.default_rng(seed)
    xyz = rng.uniform([-1, -1, 0], [1, 1, 2], (300, 3)).astype(np.float32)
    area = rng.uniform(0.0, 0.01, 300).astype(np.float32)
    colours = rng.integers(0, CODES, 300).astype(np.uint8)
    people = rng.uniform([-1, -1, 1.0], [1, 1, 2.0], (n_people, 3))
    bounds = np.array([0.1, 0.5, 0.85])
    found = np.zeros((n_people, 3, CODES), np.float32)
    colour_histograms(xyz, area, colours, people, 0.45, bounds, found)
    expected = reference.colour_histograms(xyz, area, colours, people, 0.45, bounds, CODES)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)


def test_appearance_puts_colours_into_legs_trunk_and_head() -> None:
    body = points([(0, 0, 0.05), (0, 0, 0.5), (0, 0, 1.2), (0, 0, 1.7)], [3, 40, 80, 120])
    (person,) = appearances(body, [(0.0, 0.0)], [1.8], [1.8], 0.45)
    assert np.argmax(person.colours, axis=1).tolist() == [40, 80, 120]


def test_appearance_gives_each_point_to_the_nearest_person() -> None:
    bodies = points([(0.0, 0, 1.2), (0.5, 0, 1.2)], [10, 90])
    first, second = appearances(bodies, [(0.0, 0.0), (0.5, 0.0)], [1.7, 1.7], [1.7, 1.7], 0.45)
    assert (int(first.colours[1].argmax()), int(second.colours[1].argmax())) == (10, 90)


def test_appearance_without_colours_tells_only_the_height() -> None:
    grey = FloorPoints(np.zeros((1, 3), np.float32), np.ones(1, np.float32), np.zeros(1, np.int32))
    (person,) = appearances(grey, [(0.0, 0.0)], [1.6], [1.6], 0.45)
    assert person.height_m == 1.6 and not person.colours.any()
