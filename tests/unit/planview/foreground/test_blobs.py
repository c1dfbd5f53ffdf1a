"""Connected groups of foreground pixels."""

import numpy as np
import pytest

from planview.foreground.blobs import find_blobs


def test_diagonal_neighbours_are_one_blob_and_others_two() -> None:
    mask = np.array([[7, 0, 0, 0, 9], [0, 7, 0, 0, 9], [0, 0, 0, 0, 0]], np.uint8)
    blobs = find_blobs(mask)
    assert blobs.labels.tolist() == [[1, 0, 0, 0, 2], [0, 1, 0, 0, 2], [0, 0, 0, 0, 0]]
    assert blobs.area_px.tolist() == [11, 2, 2]
    assert blobs.box_px[1:].tolist() == [[0, 0, 2, 2], [4, 0, 1, 2]]


@pytest.mark.parametrize("value", [0, 255])
def test_label_0_is_the_background_where_there_are_no_blobs_or_nothing_else(value: int) -> None:
    blobs = find_blobs(np.full((4, 6), value, np.uint8))
    assert blobs.area_px.tolist() == ([24] if value == 0 else [0, 24])
    assert (blobs.labels == (value > 0)).all()
