import numpy as np

from calib.types import U8
from planview.foreground.shadow_depth import ShadowDepth, ShadowDepthParams

GROUND = np.full((40, 40), 200, np.uint8)
PARAMS = ShadowDepthParams(pixels_min=500)


def frame(shade: int, trousers: int) -> tuple[U8, U8]:
    """The image and what is called shadow in it: 30 x 30 px of shade, and 6 x 10 px of trousers apart from it."""
    image, shadow = GROUND.copy(), np.zeros((40, 40), np.uint8)
    image[:30, :30], shadow[:30, :30] = shade, 255
    image[30:, 34:], shadow[30:, 34:] = trousers, 255
    return image, shadow


def test_trousers_darker_than_the_shadows_of_the_scene_are_clothes():
    image, shadow = frame(shade=160, trousers=105)
    clothes = ShadowDepth(PARAMS).update(image, GROUND, shadow, 0.1)
    assert clothes[32:, 36:].all()
    assert not clothes[:29, :29].any()


def test_deep_shadows_stay_shadows_where_the_sun_makes_them():
    depth = ShadowDepth(PARAMS)
    for _ in range(5):
        clothes = depth.update(*frame(shade=105, trousers=105)[:1], GROUND, frame(105, 105)[1], 0.1)
    assert not clothes.any()


def test_nothing_is_told_before_enough_shadow_was_observed():
    depth = ShadowDepth(ShadowDepthParams(pixels_min=5000))
    image, shadow = frame(shade=160, trousers=105)
    assert not depth.update(image, GROUND, shadow, 0.1).any()
    assert depth.darkest() == 0


def test_no_shadow_is_no_clothes_and_a_reset_forgets():
    depth = ShadowDepth(PARAMS)
    image, shadow = frame(shade=160, trousers=105)
    depth.update(image, GROUND, shadow, 0.1)
    assert depth.darkest() > 0
    assert not depth.update(image, GROUND, np.zeros_like(shadow), 0.1).any()
    depth.reset()
    assert depth.darkest() == 0
