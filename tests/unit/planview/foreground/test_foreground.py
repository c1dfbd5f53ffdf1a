"""Foreground, gain and ghosts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from reference import gain as reference

from calib.types import U8
from planview.engine.config import SingleCameraParams
from planview.engine.one_camera import ImageStages
from planview.foreground import _gain_kernels as kernels
from planview.foreground.blobs import find_blobs
from planview.foreground.ghosts import find_ghosts, find_still, find_uncovered
from planview.foreground.mixture import Foreground
from planview.foreground.params import BACKGROUND, PERSON, ForegroundParams
from stereo.recording import VideoFrame

SHAPE = (24, 32)
BLOB = np.s_[6:18, 10:22]


class Scene:
    """A textured wall at disparity 10 with noise; things can be put in front of it."""

    def __init__(self, colour: bool = True, fps: float = 10.0, disparity_metre: float = 1e-3, **params: object) -> None:
        self.rng = np.random.default_rng(1)
        wall = self.rng.uniform(60, 180, (*SHAPE, 1)) + self.rng.uniform(-20, 20, (*SHAPE, 3))
        self.wall = wall if colour else wall[..., :1]
        self.foreground = Foreground(ForegroundParams.model_validate(params), SHAPE, disparity_metre=disparity_metre)
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
    assert share(mask) > 0.95 and elsewhere(mask) < 0.01


def test_first_frame_has_no_foreground_nor_has_the_first_after_a_reset():
    scene = Scene()
    assert not scene.frame(PERSON_THERE).any()
    scene.watch(3)
    scene.foreground.reset()
    assert not scene.frame(PERSON_THERE).any()


def test_disparity_carried_on_beside_a_body_is_background():
    scene, body, halo = Scene(fattening_px=4), np.s_[6:18, 14:20], np.s_[6:18, 10:24]
    scene.watch(3.0)
    mask = scene.watch(0.3, [(halo, 1.0, 16.0), (body, (20, 20, 230), 16.0)])
    assert share(mask, body) > 0.9 and elsewhere(mask) < 0.02 and share(mask, np.s_[8:16, 10:13]) < 0.05


def test_same_colour_farther_from_a_body_than_matches_are_carried_is_foreground():
    scene, face, coat = Scene(fattening_px=4), np.s_[2:5, 14:18], np.s_[11:20, 10:22]
    scene.watch(3.0)
    mask = scene.watch(0.3, [(coat, 1.0, 16.0), (face, (20, 20, 230), 16.0)])
    assert share(mask, coat) > 0.9


def test_same_colour_in_front_or_another_hue_is_foreground_and_single_pixels_are_cleaned_away():
    scene = Scene()
    scene.watch(3)
    assert not scene.frame([(np.s_[10:11, 10:11], (0.0, 0.0, 255.0), 16.0)], invalid=0).any()
    assert share(scene.frame([(BLOB, 1.0, 16.0)], invalid=0)) > 0.9
    assert share(scene.frame([(BLOB, (200.0, 40.0, 40.0), 10.0)])) > 0.95


@pytest.mark.parametrize("look", [0.5, 1.6])
@pytest.mark.parametrize("colour", [True, False])
def test_shadow_and_light_where_depth_agrees_are_background(look, colour):
    scene = Scene(colour)
    scene.watch(3)
    assert share(scene.frame([(BLOB, look, 10.0)], invalid=0)) < 0.05


@pytest.mark.parametrize(("wall_m", "look", "found"), [(4.0, 0.45, False), (15.0, 0.45, True), (15.0, 0.8, False)])
def test_far_away_depth_does_not_excuse_the_colours_of_somebody_by_the_wall(wall_m, look, found):
    scene = Scene(disparity_metre=10.0 * wall_m)
    scene.watch(3.0)
    mask = scene.frame([(BLOB, look, 10.0)])
    assert share(mask) > 0.9 if found else share(mask) < 0.15


def test_shadow_without_depth_is_removed_only_if_asked_for():
    shadow = [(BLOB, 0.6, 10.0)]
    for wanted in (False, True):
        scene = Scene(remove_colour_shadows=wanted)
        scene.watch(3, depth=False)
        mask = scene.frame(shadow, depth=False)
        assert (share(mask) < 0.1) == wanted and (share(scene.foreground.shadow) > 0.9) == wanted


def test_chroma_of_dark_pixels_is_not_compared():
    scene = Scene()
    scene.wall[:] = 12.0
    scene.watch(3, depth=False)
    assert share(scene.frame([(BLOB, (4.0, 14.0, 14.0), 10.0)], depth=False)) < 0.05


def test_person_there_at_the_start_leaves_no_ghost():
    scene = Scene()
    scene.watch(5, PERSON_THERE)
    mask = scene.watch(2)
    assert share(mask) < 0.1 and share(scene.frame([(BLOB, (200.0, 90.0, 20.0), 14.0)])) > 0.9


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

    assert stands(60, fidgets=False) < 0.1 and stands(60, fidgets=True) > 0.9


def test_moved_chair_becomes_background_within_a_minute_and_its_old_place_within_two_seconds():
    scene = Scene()
    chair = [(np.s_[6:18, 2:8], (80.0, 60.0, 50.0), 14.0)]
    scene.watch(4, chair)
    moved = [(BLOB, (80.0, 60.0, 50.0), 14.0)]
    mask = scene.watch(2, moved)
    assert share(mask, chair[0][0]) < 0.1 and share(mask) > 0.9 and share(scene.watch(60, moved)) < 0.05


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
    assert slow == pytest.approx(fast, rel=0.1) and 20 < slow < 60


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
        assert (mask[:, 19:] > 0).mean() < 0.02 and (mask[:, 5:16] > 0).mean() > 0.9


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


def test_same_input_gives_the_same_masks():
    def masks() -> list[np.ndarray]:
        scene = Scene(fps=30)
        scene.watch(4)
        return [scene.frame(PERSON_THERE) for _ in range(8)]

    for one, other in zip(masks(), masks(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_brighter_exposure_is_followed():
    scene, rng = Scene(), np.random.default_rng(2)
    scene.watch(3)
    for n in range(6):
        image = (scene.wall * (1 + 0.1 * n) + rng.normal(0, 2, scene.wall.shape)).clip(0, 255).astype(np.uint8)
        scene.foreground.update(image, np.full(SHAPE, 10, np.float32), 3 + 0.1 * n)
    assert scene.foreground.exposure.gain == pytest.approx(1.5, abs=0.05)


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


DAMAGE = {
    "noise": lambda rng: rng.integers(0, 256, (*SHAPE, 3), np.uint8),
    "black": lambda rng: np.zeros((*SHAPE, 3), np.uint8),
    "white": lambda rng: np.full((*SHAPE, 3), 255, np.uint8),
    "decoder's grey": lambda rng: np.full((*SHAPE, 3), 128, np.uint8),
}


@pytest.mark.parametrize("kind", DAMAGE)
@pytest.mark.parametrize("depth", [True, False])
def test_frames_that_show_nothing_are_no_foreground_and_teach_nothing(kind, depth):
    scene = Scene()
    scene.watch(4, depth=depth)
    scene.watch(1, PERSON_THERE, depth=depth)
    model = scene.foreground._model.gaussians.copy()
    none = np.full(SHAPE, np.nan, np.float32) if depth else None
    for _ in range(8):
        assert not scene.foreground.update(DAMAGE[kind](scene.rng), none, scene.time_s).any()
        assert not scene.foreground.shows
        scene.time_s += 0.1
    np.testing.assert_array_equal(scene.foreground._model.gaussians, model)
    mask = scene.frame(PERSON_THERE, depth=depth)
    assert scene.foreground.shows and share(mask) > 0.9 and elsewhere(mask) < 0.05


def test_depth_that_is_gone_at_once_shows_nothing():
    scene = Scene()
    scene.watch(4)
    assert scene.foreground.shows
    scene.frame(invalid=0.95)
    assert not scene.foreground.shows


def test_another_view_begins_a_new_background_after_a_while():
    scene = Scene()
    scene.watch(4)
    scene.wall = scene.wall[::-1, ::-1].copy()
    scene.watch(1)
    assert not scene.foreground.shows
    scene.watch(3)
    assert scene.foreground.shows and share(scene.watch(4, PERSON_THERE)) < 0.1 and share(scene.frame([])) < 0.1
    assert elsewhere(scene.frame([])) < 0.02


@pytest.mark.parametrize("grey_first", [True, False])
@pytest.mark.parametrize("channels", [1, 3])
def test_a_camera_that_turns_grey_and_back_shows_no_foreground(grey_first, channels):
    scene = Scene()
    colour = scene.wall
    grey = np.repeat(colour.mean(axis=2, keepdims=True), channels, axis=2)
    for n, wall in enumerate([grey, colour, grey, colour] if grey_first else [colour, grey, colour]):
        scene.wall = wall
        mask = scene.watch(4 if n == 0 else 2)
        assert scene.foreground.shows and share(mask, np.s_[:]) < 0.02, n


def test_parameters_out_of_range_are_refused():
    with pytest.raises(ValidationError):
        ForegroundParams(gaussians=9)
    with pytest.raises(ValueError, match="size"):
        Foreground(ForegroundParams(), (0, 5))


CLIP, TOLERANCE = 250.0, 12.0


def _lumas(seed: int, gain: float, offset: float, outliers: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    model = rng.uniform(10, 300, 2000).astype(np.float32)
    luma = gain * model + offset + rng.normal(0, 2, 2000)
    wrong = rng.random(2000) < outliers
    luma[wrong] = 90 + rng.normal(0, 5, wrong.sum())
    return model, luma.clip(0, 255).astype(np.float32)


def _information(luma: np.ndarray) -> np.ndarray:
    information = np.empty_like(luma)
    kernels.fill_information(luma, TOLERANCE, information)
    return information


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    gain=st.floats(0.3, 3),
    offset=st.floats(-40, 40),
    outliers=st.floats(0, 0.4),
    start=st.floats(0.3, 3),
)
def test_gain_kernels_agree_with_numpy(seed: int, gain: float, offset: float, outliers: float, start: float) -> None:
    model, luma = _lumas(seed, gain, offset, outliers)
    information = _information(luma)
    assert information == pytest.approx(reference.information(luma, TOLERANCE), rel=1e-4)
    most = float(information.max())
    for step in (1, kernels.THINNING):
        args = model, luma, information, start, offset, CLIP, TOLERANCE, step
        ours, theirs = kernels.weigh_inliers(*args), reference.weigh_inliers(*args)
        # A pixel on the edge of the tolerance may fall on either side.
        assert abs(ours[0] - theirs[0]) <= 2 and ours[1] == pytest.approx(theirs[1], rel=1e-4, abs=2 * most)
    line = kernels.refine_gain(model, luma, start, offset, CLIP, TOLERANCE)
    assert line == pytest.approx(reference.refine_gain(model, luma, start, offset, CLIP, TOLERANCE), rel=1e-2, abs=0.1)
    scale = kernels.consensus_scale(model, luma, information, CLIP, TOLERANCE)
    expected = reference.consensus_scale(model, luma, information, CLIP, TOLERANCE)
    last = 0.0, CLIP, TOLERANCE, kernels.THINNING
    printed = [kernels.weigh_inliers(model, luma, information, gain, *last)[1] for gain in (scale, expected)]
    assert printed[0] == pytest.approx(printed[1], abs=2 * most)


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (0.6, 20.0), (1.8, -40.0), (0.9, -80.0)])
def test_line_is_found_from_nowhere_with_forty_percent_outliers(gain: float, offset: float) -> None:
    model, luma = _lumas(3, gain, offset, 0.4)
    found = kernels.consensus_line(model, luma, _information(luma), 1.0, 0.0, CLIP, TOLERANCE)
    refined = kernels.refine_gain(model, luma, *found, CLIP, TOLERANCE)
    levels = np.array([60.0, 150.0])
    assert refined[0] * levels + refined[1] == pytest.approx(gain * levels + offset, abs=3)


def test_scale_is_found_on_an_image_that_is_nearly_all_clipped() -> None:
    rng = np.random.default_rng(0)
    model = rng.uniform(100, 200, 2000).astype(np.float32)
    luma = np.minimum(2.4 * model + rng.normal(0, 2, 2000), 255).astype(np.float32)
    information = _information(luma)
    gain = kernels.consensus_scale(model, luma, information, CLIP, TOLERANCE)
    assert kernels.weigh_inliers(model, luma, information, gain, 0.0, CLIP, TOLERANCE, 1)[0] > 1900


def test_pixel_tells_the_less_the_more_of_the_image_has_its_luma() -> None:
    luma = np.array([100.0] * 90 + [200.0] * 10, np.float32)
    by_chance = np.array([0.9 * 0.9, 0.9 * 0.1]) + 0.1 * 25 / 256
    assert _information(luma)[[0, -1]] == pytest.approx(-np.log(by_chance), rel=1e-5)


WALL = np.random.default_rng(0).uniform(40, 160, (60, 80))


def _watch(images: list[np.ndarray]) -> tuple[Foreground, list[np.ndarray]]:
    """The foreground stage after some images, to which noise is added, and its masks."""
    rng, foreground = np.random.default_rng(1), Foreground(ForegroundParams(), WALL.shape)
    noisy = [(image + rng.normal(0, 2, WALL.shape)).clip(0, 255).astype(np.uint8) for image in images]
    return foreground, [foreground.update(image, None, i / 10) for i, image in enumerate(noisy)]


def _follow(gains: list[float]) -> Foreground:
    foreground, masks = _watch([gain * WALL for gain in gains])
    assert max((mask > 0).mean() for mask in masks) < 0.02
    return foreground


def test_gain_is_followed_and_where_it_is_far_away_the_model_moves_to_it():
    foreground = _follow([1.0] * 10 + [1.3])
    assert foreground._gain.gain == pytest.approx(1.3, abs=0.03)
    foreground = _follow([1.0] * 10 + [0.4, 0.4])
    assert foreground._gain.gain == pytest.approx(1.0, abs=0.05)


def test_plain_shirt_over_most_of_the_image_is_no_gain() -> None:
    shirt = 1.1 * WALL
    shirt[:, 28:] = 105
    foreground, _ = _watch([WALL] * 10 + [shirt])
    assert foreground._gain.gain == pytest.approx(1.1, abs=0.03)


def test_plain_shirt_over_all_of_the_image_is_no_gain() -> None:
    """A line almost without slope would fit, and the model in that exposure would have forgotten the scene."""
    wall = 80 + WALL / 2
    foreground, masks = _watch([wall] * 10 + [np.full_like(wall, 120)] * 2 + [wall])
    assert foreground.exposure.gain == pytest.approx(1.0, abs=0.02) and (masks[-1] > 0).mean() < 0.01


def test_drifting_light_does_not_run_away_and_another_scene_is_no_gain():
    rng = np.random.default_rng(5)
    drift = np.exp(np.cumsum(rng.normal(0, 0.02, 1000)))
    foreground = _follow(list(np.clip(drift, 0.4, 1.5)))
    assert 0.4 < foreground._gain.gain < 2.5
    rng = np.random.default_rng(0)
    foreground, _ = _watch([rng.integers(0, 255, WALL.shape) for _ in range(10)])
    assert foreground._gain.gain == pytest.approx(1.0, abs=0.3)


GHOST_SHAPE = (60, 80)
BODY = slice(20, 45), slice(30, 40)
NOTHING = np.zeros(GHOST_SHAPE, np.uint8)


def scene(*bodies: tuple[slice, slice]) -> U8:
    image = np.full(GHOST_SHAPE, 150, np.uint8)
    for body in bodies:
        image[body] = 40
    return image


def mask_of(*bodies: tuple[slice, slice]) -> U8:
    return np.where(scene(*bodies) == 40, 255, 0).astype(np.uint8)


FULL = np.full(GHOST_SHAPE, 255, np.uint8)
BESIDE = slice(20, 45), slice(55, 65)


@pytest.mark.parametrize(
    ("image", "background", "mask", "expected"),
    [
        (scene(), scene(BODY), mask_of(BODY), mask_of(BODY)),
        (scene(BODY), scene(), mask_of(BODY), NOTHING),
        (scene(BESIDE), scene(BODY), mask_of(BODY, BESIDE), mask_of(BODY)),
        (scene(), scene(BODY), NOTHING, NOTHING),
        (scene(), scene(BODY), FULL, NOTHING),
    ],
    ids=["outline in the background", "outline in the image", "ghost next to a person", "no blob", "nothing else"],
)
def test_blob_with_its_outline_in_the_background_is_a_ghost(image, background, mask, expected):
    np.testing.assert_array_equal(find_ghosts(image, background, find_blobs(mask), NOTHING), expected)


def test_ghost_with_a_walker_in_front_waits_until_the_walker_has_passed():
    walker = slice(20, 45), slice(40, 50)
    image, mask = scene(walker), mask_of(BODY, walker)
    assert not find_ghosts(image, scene(BODY), find_blobs(mask), mask_of(walker)).any()


def test_place_that_a_person_leaves_is_told_from_the_person_and_another_in_the_blob_is_not_uncovered():
    person = slice(20, 45), slice(38, 48)  # two columns overlap BODY
    uncovered = find_uncovered(scene(person), scene(BODY), mask_of(BODY, person))
    assert uncovered[25:40, 31:36].all() and not uncovered[:, 39:].any()
    assert not find_uncovered(scene(BODY), scene(), mask_of(BODY)).any()
    assert not find_uncovered(scene(), scene(BODY), FULL).any()


def test_still_blobs_are_those_in_which_nothing_has_moved():
    still = find_still(find_blobs(mask_of(BODY, BESIDE)), mask_of(BESIDE))
    np.testing.assert_array_equal(still, mask_of(BODY))


def test_background_luma_is_the_luma_of_the_first_images():
    foreground = Foreground(ForegroundParams(), GHOST_SHAPE)
    for k in range(5):
        foreground.update(scene(BODY), None, k / 10)
    np.testing.assert_allclose(foreground.background_luma(), scene(BODY), atol=1)


def test_person_there_at_the_start_leaves_no_ghost_even_if_a_tracker_protects_it():
    camera = ImageStages(SingleCameraParams(), GHOST_SHAPE[::-1])
    protected = np.ones(GHOST_SHAPE, np.uint8)  # PERSON everywhere: nothing would be learned
    masks = []
    for k in range(60):
        image = np.repeat(scene(BODY)[:, :, None] if k < 5 else scene()[:, :, None], 3, axis=2)
        masks.append(camera.view(VideoFrame(k, k / 10, image), protected if k >= 5 else None).foreground)
    assert not any(mask[BODY].any() for mask in masks)


def test_one_camera_that_moves_or_is_covered_shows_nothing_and_keeps_its_background():
    rng = np.random.default_rng(4)
    wall = np.kron(rng.integers(40, 216, (40, 60)), np.ones((4, 4))).astype(np.uint8)
    views = [wall[:120, :160]] * 40 + [np.roll(wall, 3 * k, 1)[:120, :160] for k in (2, 5, 1, 4, 6)]
    views += [np.zeros((120, 160), np.uint8)] * 10 + [wall[:120, :160]] * 20
    camera = ImageStages(SingleCameraParams(), (160, 120))
    seen = [camera.view(VideoFrame(k, k / 10, view.copy())) for k, view in enumerate(views)]
    assert not any(v.shows for v in seen[40:55]) and all(v.shows for v in [*seen[:40], *seen[-20:]])
    assert not seen[-20].foreground.any()


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
