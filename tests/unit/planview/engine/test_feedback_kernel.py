import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planview.engine import _feedback_kernels as kernels
from tests.reference import feedback as reference


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n_people=st.integers(0, 4))
def test_painted_feedback_equals_its_reference(seed: int, n_people: int) -> None:
    rng = np.random.default_rng(seed)
    xyz = rng.uniform((-1, -1, 0), (1, 1, 2), (50, 3)).astype(np.float32)
    pixels = rng.integers(0, 80, 50).astype(np.int32)
    people = np.column_stack([rng.uniform(-1, 1, (n_people, 2)), rng.integers(0, 2, n_people)]).astype(np.float64)
    masks = []
    for module in (kernels, reference):
        persons, ground = np.zeros(80, np.uint8), np.zeros(80, np.uint8)
        module.paint(xyz, pixels, people, 0.6, 0.3, persons, ground)
        masks.append((persons, ground))
    for ours, theirs in zip(*masks, strict=True):
        np.testing.assert_array_equal(ours, theirs)
