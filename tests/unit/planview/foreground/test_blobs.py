"""Connected groups of foreground pixels."""

import cv2
import numpy as np
import pytest

from planview.foreground.blobs import find_blobs


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.95, 1.0])
def test_blobs_are_those_of_opencv(share: float) -> None:
    rng = np.random.default_rng(2)
    for height, width in ((1, 1), (1, 40), (40, 1), (40, 61), (33, 130)):
        mask = np.where(rng.uniform(size=(height, width)) < share, 7, 0).astype(np.uint8)
        count, labels, stats, _ = cv2.connectedComponentsWithStatsWithAlgorithm(mask, 8, cv2.CV_32S, cv2.CCL_BBDT)
        blobs = find_blobs(mask)
        assert len(blobs) == count
        np.testing.assert_array_equal(blobs.labels, labels)
        np.testing.assert_array_equal(blobs.area_px, stats[:, cv2.CC_STAT_AREA])
        np.testing.assert_array_equal(blobs.box_px[1:], stats[1:, :4])


def test_an_empty_mask_has_background_only() -> None:
    blobs = find_blobs(np.zeros((4, 6), np.uint8))
    assert len(blobs) == 1
    assert blobs.area_px[0] == 24
    assert not blobs.labels.any()
