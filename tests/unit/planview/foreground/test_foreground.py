"""What the foreground stage does, told by small scenes."""

import numpy as np
import pytest
from pydantic import ValidationError

from planview.foreground.mixture import Foreground
from planview.foreground.params import BACKGROUND, PERSON, ForegroundParams

SHAPE = (24, 32)
BLOB = np.s_[6:18, 10:22]


class Scene:
    """A textured wall at disparity 10 with noise; things can be put in front of it."""

    def __init__(self, colour: bool = True, fps: float = 10.0, **params: object) -> None:
        self.rng = np.random.default_rng(1)
        wall = self.rng.uniform(60, 180, (*SHAPE, 1)) + self.rng.uniform(-20, 20, (*SHAPE, 3))
        self.wall = wall if colour else wall[..., :1]
        self.foreground = Foreground(ForegroundParams.model_validate(params), SHAPE)
        self.step_s, self.time_s = 1 / fps, 0.0

    def frame(self, things=(), gain: float = 1.0, depth: bool = True, feedback=None, invalid: float = 0.1):
        """One frame; things are (where, colour or factor on the wall, disparity)."""
        image, disparity = self.wall.copy(), np.full(SHAPE, 10.0)
        for where, look, depth_px in things:
            image[where] = image[where] * look if isinstance(look, float) else look
            disparity[where] = depth_px
        image = gain * image + self.rng.normal(0, 2, image.shape)
        disparity = disparity + self.rng.normal(0, 0.2, SHAPE)
        disparity[self.rng.random(SHAPE) < invalid] = np.nan
        image = image.clip(0, 255).astype(np.uint8)
        mask = self.foreground.update(
            image if image.shape[2] == 3 else image[..., 0],
            disparity.astype(np.float32) if depth else None,
            self.time_s,
            feedback,
        )
        self.time_s += self.step_s
        return mask

    def watch(self, seconds: float, *args, **kwargs):
        """Frames for some seconds; the last mask."""
        for _ in range(max(1, round(seconds / self.step_s))):
            mask = self.frame(*args, **kwargs)
        return mask


def share(mask: np.ndarray, where=BLOB) -> float:
    """Fraction of foreground inside a region."""
    return float((mask[where] > 0).mean())


def elsewhere(mask: np.ndarray) -> float:
    """Fraction of foreground a pixel and more away from the blob."""
    rest = mask.copy()
    rest[5:19, 9:23] = 0
    return float((rest > 0).mean())


PERSON_THERE = [(BLOB, (40.0, 60.0, 200.0), 16.0)]


@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("depth", [True, False])
def test_after_three_empty_seconds_a_person_is_foreground_and_nothing_else(colour, depth):
    scene = Scene(colour)
    assert elsewhere(scene.watch(3, depth=depth)) == 0
    mask = scene.watch(0.2, [(BLOB, (20.0, 30.0, 40.0)[: 3 if colour else 1], 16.0)], depth=depth)
    assert share(mask) > 0.95
    assert elsewhere(mask) < 0.01


def test_first_frame_has_no_foreground():
    assert not Scene().frame(PERSON_THERE).any()


def test_disparity_carried_on_beside_a_body_is_background():
    scene, body, halo = Scene(fattening_px=4), np.s_[6:18, 14:20], np.s_[6:18, 10:24]
    scene.watch(3.0)
    mask = scene.watch(0.3, [(halo, 1.0, 16.0), (body, (20, 20, 230), 16.0)])
    assert share(mask, body) > 0.9
    assert elsewhere(mask) < 0.02 and share(mask, np.s_[8:16, 10:13]) < 0.05


def test_same_colour_farther_from_a_body_than_matches_are_carried_is_foreground():
    scene, face, coat = Scene(fattening_px=4), np.s_[2:5, 14:18], np.s_[11:20, 10:22]
    scene.watch(3.0)
    mask = scene.watch(0.3, [(coat, 1.0, 16.0), (face, (20, 20, 230), 16.0)])
    assert share(mask, coat) > 0.9


def test_same_colour_in_front_of_the_wall_is_foreground():
    scene = Scene()
    scene.watch(3)
    assert share(scene.frame([(BLOB, 1.0, 16.0)], invalid=0)) > 0.9


@pytest.mark.parametrize("look", [0.5, 1.6])
@pytest.mark.parametrize("colour", [True, False])
def test_shadow_and_light_where_depth_agrees_are_background(look, colour):
    scene = Scene(colour)
    scene.watch(3)
    assert share(scene.frame([(BLOB, look, 10.0)], invalid=0)) < 0.05


def test_other_hue_where_depth_agrees_is_foreground():
    scene = Scene()
    scene.watch(3)
    assert share(scene.frame([(BLOB, (200.0, 40.0, 40.0), 10.0)])) > 0.95


def test_shadow_without_depth_is_removed_only_if_asked_for():
    shadow = [(BLOB, 0.6, 10.0)]
    for wanted in (False, True):
        scene = Scene(remove_colour_shadows=wanted)
        scene.watch(3, depth=False)
        mask = scene.frame(shadow, depth=False)
        assert (share(mask) < 0.1) == wanted
        assert (share(scene.foreground.shadow) > 0.9) == wanted


def test_chroma_of_dark_pixels_is_not_compared():
    scene = Scene()
    scene.wall[:] = 12.0
    scene.watch(3, depth=False)
    assert share(scene.frame([(BLOB, (4.0, 14.0, 14.0), 10.0)], depth=False)) < 0.05


def test_person_there_at_the_start_leaves_no_ghost():
    scene = Scene()
    scene.watch(5, PERSON_THERE)
    mask = scene.watch(2)
    assert share(mask) < 0.1
    assert share(scene.frame([(BLOB, (200.0, 90.0, 20.0), 14.0)])) > 0.9


def test_feedback_keeps_a_person_standing_for_ten_minutes():
    scene = Scene(fps=2)
    scene.watch(3)
    feedback = np.zeros(SHAPE, np.uint8)
    feedback[5:19, 9:23] = PERSON
    assert share(scene.watch(600, PERSON_THERE, feedback=feedback)) > 0.95


def test_fidgeting_slows_absorption():
    """Fidgeting: between two looks, so that luma changes all the time."""

    def stands(seconds: float, fidgets: bool) -> float:
        scene = Scene(fps=5)
        scene.watch(3)
        for i in range(round(seconds * 5)):
            look = 40.0 if fidgets and i % 2 else 20.0
            mask = scene.frame([(BLOB, (look, look, 3 * look), 16.0)])
        return share(mask)

    assert stands(60, fidgets=False) < 0.1
    assert stands(60, fidgets=True) > 0.9


def test_moved_chair_becomes_background_within_a_minute_and_its_old_place_within_two_seconds():
    scene = Scene()
    chair = [(np.s_[6:18, 2:8], (80.0, 60.0, 50.0), 14.0)]
    scene.watch(4, chair)
    moved = [(BLOB, (80.0, 60.0, 50.0), 14.0)]
    mask = scene.watch(2, moved)
    assert share(mask, chair[0][0]) < 0.1
    assert share(mask) > 0.9
    assert share(scene.watch(60, moved)) < 0.05


def test_feedback_background_is_learned_within_seconds():
    scene = Scene()
    scene.watch(10)
    feedback = np.full(SHAPE, BACKGROUND, np.uint8)
    assert share(scene.watch(5, PERSON_THERE, feedback=feedback)) < 0.05


def test_frame_rate_does_not_change_how_long_learning_takes():
    def absorbed_after(fps: float) -> float:
        scene = Scene(fps=fps)
        scene.watch(3)
        start = scene.time_s
        while share(scene.frame(PERSON_THERE, invalid=0)) > 0.5:
            assert scene.time_s < 100
        return scene.time_s - start

    slow, fast = absorbed_after(7), absorbed_after(30)
    assert slow == pytest.approx(fast, rel=0.1)
    assert 20 < slow < 60


def test_gap_in_time_teaches_at_most_a_second():
    scene = Scene()
    scene.watch(4)
    scene.watch(0.3, PERSON_THERE)
    scene.time_s += 3600
    assert share(scene.watch(0.5, PERSON_THERE)) > 0.95
    scene.time_s -= 10  # time stamps that run backwards teach nothing
    assert share(scene.watch(0.5, PERSON_THERE)) > 0.95


@pytest.mark.parametrize("gain", [0.5, 0.8, 1.3, 2.0])
@pytest.mark.parametrize("colour", [True, False])
def test_gain_steps_raise_no_foreground_even_with_a_person_in_forty_percent_of_the_image(gain, colour):
    scene = Scene(colour)
    scene.watch(3)
    person = [(np.s_[:, 4:17], (50.0, 70.0, 30.0)[: 3 if colour else 1], 16.0)]
    scene.watch(0.5, person)
    for _ in range(5):
        mask = scene.frame(person, gain, invalid=0)
        assert (mask[:, 19:] > 0).mean() < 0.02
        assert (mask[:, 5:16] > 0).mean() > 0.9


def test_clipped_floor_that_comes_out_of_saturation_is_background():
    scene = Scene(colour=False)
    scene.wall[BLOB] = 400.0
    scene.watch(3, depth=False)
    for gain in (0.8, 0.6, 0.5):
        assert share(scene.watch(0.5, gain=gain, depth=False)) < 0.05


def test_flickering_disparity_does_not_flood_the_mask():
    scene = Scene()
    shares = []
    for i in range(120):
        mask = scene.frame(invalid=0.6)
        if i > 30:
            shares.append((mask > 0).mean())
    assert max(shares) < 0.01


def test_rarely_measured_depth_does_not_decide():
    scene = Scene()
    scene.watch(4, invalid=0.95)
    assert share(scene.frame([(BLOB, 1.0, 16.0)], invalid=0)) < 0.4


def test_reset_forgets():
    scene = Scene()
    scene.watch(3)
    scene.foreground.reset()
    assert not scene.frame(PERSON_THERE).any()


def test_same_input_gives_the_same_masks():
    def masks() -> list[np.ndarray]:
        scene = Scene(fps=30)
        scene.watch(4)
        return [scene.frame(PERSON_THERE) for _ in range(8)]

    for one, other in zip(masks(), masks(), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("measured", [None, np.full(SHAPE, 255, np.uint8)])
def test_exposure_is_followed_once_in_a_frame_whether_changes_were_asked_for_or_not(measured):
    def watched(ask: bool) -> tuple[np.ndarray, float]:
        scene, rng = Scene(), np.random.default_rng(2)
        scene.watch(3)
        for n in range(6):
            image = (scene.wall * (1 + 0.1 * n) + rng.normal(0, 2, scene.wall.shape)).clip(0, 255).astype(np.uint8)
            if ask:
                scene.foreground.changed(image, 2)
            mask = scene.foreground.update(image, np.full(SHAPE, 10, np.float32), 3 + 0.1 * n, None, measured)
        return mask, scene.foreground.exposure.gain

    (asked, asked_gain), (unasked, gain) = watched(True), watched(False)
    np.testing.assert_array_equal(asked, unasked)
    assert asked_gain == gain == pytest.approx(1.5, abs=0.05)


def test_single_pixels_are_cleaned_away():
    scene = Scene()
    scene.watch(3)
    assert not scene.frame([(np.s_[10:11, 10:11], (0.0, 0.0, 255.0), 16.0)], invalid=0).any()


@pytest.mark.parametrize(
    ("image", "disparity", "feedback", "message"),
    [
        (np.zeros((24, 31), np.uint8), None, None, "image"),
        (np.zeros(SHAPE, np.float32), None, None, "image"),
        (np.zeros((*SHAPE, 4), np.uint8), None, None, "image"),
        (np.zeros(SHAPE, np.uint8), np.zeros(SHAPE), None, "disparity"),
        (np.zeros(SHAPE, np.uint8), None, np.zeros((2, 2), np.uint8), "feedback"),
    ],
)
def test_wrong_arrays_are_refused_by_name(image, disparity, feedback, message):
    with pytest.raises(ValueError, match=message):
        Foreground(ForegroundParams(), SHAPE).update(image, disparity, 0.0, feedback)


def test_change_between_grey_and_colour_is_refused():
    foreground = Foreground(ForegroundParams(), SHAPE)
    foreground.update(np.zeros(SHAPE, np.uint8), None, 0.0)
    with pytest.raises(ValueError, match="grey"):
        foreground.update(np.zeros((*SHAPE, 3), np.uint8), None, 0.1)


def test_parameters_out_of_range_are_refused():
    with pytest.raises(ValidationError):
        ForegroundParams(gaussians=9)
    with pytest.raises(ValueError, match="size"):
        Foreground(ForegroundParams(), (0, 5))
