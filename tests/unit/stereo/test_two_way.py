"""Matching from both ends: the lag of one pass is taken out, and masks turn with the images."""

import numpy as np
from toy_stereo import ToyWorld, toy_rig

from stereo.matcher import SgbmMatcher
from stereo.rectify import RectifiedPair, Rectifier
from stereo.two_way import TwoWayMatcher

RECTIFIER = Rectifier(toy_rig())


def pair() -> RectifiedPair:
    return RECTIFIER(*ToyWorld().pair(RECTIFIER.rig, (), 0))


def test_two_way_matching_is_the_mean_of_both_passes() -> None:
    images = pair()
    one_way = SgbmMatcher(RECTIFIER.geometry)
    down = one_way(images.left_grey, images.right_grey)
    turned = (np.ascontiguousarray(i[::-1]) for i in (images.left_grey, images.right_grey))
    up = one_way(*turned)[::-1]
    found = TwoWayMatcher(RECTIFIER.geometry)(images.left_grey, images.right_grey)
    valid = np.isfinite(found)
    assert valid.mean() > 0.5
    np.testing.assert_allclose(found[valid], (0.5 * (down + up))[valid])
    assert (np.abs(down - up)[valid] < 2.0).all()


def test_two_way_matching_loses_only_what_a_mask_covers() -> None:
    images = pair()
    mask = RECTIFIER.mask.copy()
    mask[:60] = 0
    unmasked = TwoWayMatcher(RECTIFIER.geometry)(images.left_grey, images.right_grey)
    found = TwoWayMatcher(RECTIFIER.geometry, mask=mask)(images.left_grey, images.right_grey)
    assert np.isnan(found[:60]).all()
    np.testing.assert_array_equal(found[80:], unmasked[80:])
