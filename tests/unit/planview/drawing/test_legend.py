"""Legends below pictures."""

import cv2
import numpy as np

from planview.drawing.style import STRIP_PX, Entry, with_colour_bar, with_legend


def test_legend_lies_below_the_picture_and_shows_each_colour() -> None:
    picture = np.full((50, 300), 128, dtype=np.uint8)
    shown = with_legend(picture, [Entry((255, 0, 0), "above"), Entry((0, 0, 255), "below")])
    assert shown.shape == (50 + STRIP_PX, 300, 3)
    assert (shown[:50] == 128).all()
    assert all((shown[50:] == colour).all(axis=2).any() for colour in ((0, 0, 255), (255, 0, 0)))


def test_legend_that_is_too_long_goes_on_in_another_strip() -> None:
    picture = np.zeros((50, 120, 3), dtype=np.uint8)
    assert with_legend(picture, [Entry((9, 9, 9), "a long meaning")] * 3).shape[0] == 50 + 3 * STRIP_PX


def test_colour_bar_goes_from_the_low_to_the_high_end() -> None:
    shown = with_colour_bar(np.zeros((50, 400, 3), dtype=np.uint8), cv2.COLORMAP_TURBO, "far", "near")
    bar = shown[50 + 12].astype(int)
    blue, red = np.argmax(bar[:, 0] - bar[:, 2]), np.argmax(bar[60:320, 2] - bar[60:320, 0]) + 60
    assert blue < red
