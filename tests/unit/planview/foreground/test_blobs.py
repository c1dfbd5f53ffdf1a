"""Connected groups of foreground pixels."""

import cv2
import numpy as np

from planview.foreground.blobs import find_blobs


def test_blobs_are_those_of_the_whole_image() -> None:
    mask = np.zeros((40, 60), np.uint8)
    mask[11:31, 7:50] = np.random.default_rng(2).uniform(size=(20, 43)) > 0.7
    count, labels, stats, _ = cv2.connectedComponentsWithStatsWithAlgorithm(mask, 8, cv2.CV_32S, cv2.CCL_BBDT)
    blobs = find_blobs(mask)
    assert len(blobs) == count > 10
    np.testing.assert_array_equal(blobs.labels, labels)
    np.testing.assert_array_equal(blobs.area_px, stats[:, cv2.CC_STAT_AREA])
    np.testing.assert_array_equal(blobs.box_px[1:], stats[1:, :4])


def test_an_empty_mask_has_background_only() -> None:
    blobs = find_blobs(np.zeros((4, 6), np.uint8))
    assert len(blobs) == 1
    assert blobs.area_px[0] == 24
    assert not blobs.labels.any()
