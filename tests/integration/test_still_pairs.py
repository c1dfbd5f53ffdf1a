"""Pairs in which nothing moved keep their disparity, whether or not the run was interrupted."""

import copy
from collections.abc import Iterator
from itertools import islice, pairwise

import numpy as np
import pytest

from calib.types import F32
from planview.engine.engine import FrameResult


def disparity_of(result: FrameResult) -> F32:
    return result.depth.disparity


@pytest.fixture(scope="module", autouse=True)
def _no_first_pairs() -> Iterator[None]:
    """The room is empty for ten frames only."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stereo.matcher.FIRST_PAIRS", 0)
        yield


@pytest.fixture(scope="module")
def disparities(engine) -> list[F32]:
    """Of all frames, without an interruption; the room is empty and still in the first ten."""
    return [disparity_of(result) for result in engine]


def test_pairs_of_an_empty_room_share_a_disparity(disparities):
    equal = [np.array_equal(*pair, equal_nan=True) for pair in pairwise(disparities)]
    matched = [n for n, same in enumerate(equal, start=1) if not same]
    assert matched == [4, 8, *range(10, len(disparities))]


def test_writing_into_the_disparity_of_a_frame_leaves_the_next_frame_as_it_is(engine, disparities):
    for result in islice(engine, 2):
        np.testing.assert_array_equal(disparity_of(result), disparities[result.frame])
        disparity_of(result)[:] = 0.0


@pytest.mark.parametrize("frame", [0, 4, 9, 10])
def test_a_resumed_run_keeps_the_disparities_that_an_uninterrupted_one_keeps(engine, disparities, frame):
    for result in engine:
        if result.frame == frame:
            state = copy.deepcopy(engine.state())
    engine.reset()
    engine.set_state(state)
    np.testing.assert_array_equal([disparity_of(r) for r in engine.after(frame)], disparities[frame + 1 :])


def test_an_iteration_that_was_left_early_continues_from_the_frame_tracked_last(engine, disparities):
    for result in islice(engine, 9):  # the person of frame 10 has been measured
        last = result.frame
    np.testing.assert_array_equal([disparity_of(r) for r in engine.after(last)], disparities[last + 1 :])
