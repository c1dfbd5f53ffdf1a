"""Foreground, gain and ghosts."""

import cv2
import numpy as np
import pytest

from planview.engine.config import SingleCameraParams
from planview.engine.sensor import CameraSensor, StageClock
from planview.foreground.gain import Exposure
from planview.foreground.mixture import Foreground
from planview.foreground.params import BACKGROUND, PERSON, ForegroundParams
from stereo.recording import Frame

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
def test_after_three_empty_seconds_only_a_person_is_foreground(colour, depth):
    scene = Scene(colour)
    assert elsewhere(scene.watch(3, depth=depth)) == 0
    mask = scene.watch(0.2, [(BLOB, (20.0, 30.0, 40.0)[: 3 if colour else 1], 16.0)], depth=depth)
    assert share(mask) > 0.95
    assert elsewhere(mask) < 0.01


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
    assert share(mask, body) > 0.9
    assert elsewhere(mask) < 0.02
    assert share(mask, np.s_[8:16, 10:13]) < 0.05


def test_same_colour_farther_from_a_body_than_matches_are_carried_is_foreground():
    scene, face, coat = Scene(fattening_px=4), np.s_[2:5, 14:18], np.s_[11:20, 10:22]
    scene.watch(3.0)
    mask = scene.watch(0.3, [(coat, 1.0, 16.0), (face, (20, 20, 230), 16.0)])
    assert share(mask, coat) > 0.9


def test_single_pixels_are_cleaned_away():
    scene = Scene()
    scene.watch(3)
    assert not scene.frame([(np.s_[10:11, 10:11], (0.0, 0.0, 255.0), 16.0)], invalid=0).any()


@pytest.mark.parametrize(("look", "depth"), [(1.0, 16.0), ((200.0, 40.0, 40.0), 10.0)], ids=["in front", "another hue"])
def test_person_who_differs_in_depth_or_hue_alone_is_foreground(look, depth):
    scene = Scene()
    scene.watch(3)
    assert share(scene.frame([(BLOB, look, depth)], invalid=0)) > 0.9


@pytest.mark.parametrize("look", [0.5, 1.6])
@pytest.mark.parametrize("colour", [True, False])
def test_change_of_light_where_depth_agrees_is_background(look, colour):
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


@pytest.mark.parametrize("fidgets", [False, True])
def test_somebody_whose_luma_changes_all_the_time_is_absorbed_more_slowly(fidgets):
    scene = Scene(fps=5)
    scene.watch(3)
    for i in range(300):
        look = 40.0 if fidgets and i % 2 else 20.0
        mask = scene.frame([(BLOB, (look, look, 3 * look), 16.0)])
    assert share(mask) > 0.9 if fidgets else share(mask) < 0.1


def test_moved_chair_becomes_background_after_its_old_place():
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
    def absorbed_after(fps):
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


def test_background_that_begins_again_while_the_camera_moves_has_no_exposure():
    scene = Scene()
    scene.watch(1.0)
    scene.watch(0.5, gain=1.3)
    assert scene.foreground.exposure.gain == pytest.approx(1.3, abs=0.05)
    scene.foreground.update(scene.wall.astype(np.uint8), None, scene.time_s, steady=False)
    assert scene.foreground.exposure == Exposure()


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
    shares = [(scene.frame(invalid=0.6) > 0).mean() for _ in range(120)]
    assert max(shares[31:]) < 0.01


def test_rarely_measured_depth_does_not_decide():
    scene = Scene()
    scene.watch(4, invalid=0.95)
    assert share(scene.frame([(BLOB, 1.0, 16.0)], invalid=0)) < 0.4


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
    with pytest.raises(ValueError, match="size"):
        Foreground(ForegroundParams(), (0, 5))


DAMAGE = {
    "noise": lambda rng: rng.integers(0, 256, (*SHAPE, 3), np.uint8),
    "black": lambda rng: np.zeros((*SHAPE, 3), np.uint8),
    "white": lambda rng: np.full((*SHAPE, 3), 255, np.uint8),
    "decoder's grey": lambda rng: np.full((*SHAPE, 3), 128, np.uint8),
}


@pytest.mark.parametrize("kind", DAMAGE)
@pytest.mark.parametrize("depth", [True, False])
def test_frames_that_show_nothing_teach_nothing(kind, depth):
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
    assert scene.foreground.shows
    assert share(mask) > 0.9
    assert elsewhere(mask) < 0.05


def test_depth_that_is_gone_at_once_shows_nothing():
    scene = Scene()
    scene.watch(4)
    assert scene.foreground.shows
    scene.frame(invalid=0.95)
    assert not scene.foreground.shows


def test_an_image_without_the_edges_of_the_background_is_not_sharp_for_three_seconds():
    scene = Scene()
    scene.wall = 120.0 + 0.25 * (scene.wall - 120.0)  # so faint that it matches when it is blurred
    scene.watch(4)
    assert scene.foreground.sharp
    scene.wall = cv2.GaussianBlur(scene.wall, (0, 0), 4.0)
    scene.watch(1)
    assert scene.foreground.shows
    assert not scene.foreground.sharp
    scene.watch(3)
    assert scene.foreground.sharp


def test_another_view_begins_a_new_background_after_a_while():
    scene = Scene()
    scene.watch(4)
    scene.wall = scene.wall[::-1, ::-1].copy()
    scene.watch(1)
    assert not scene.foreground.shows
    scene.watch(3)
    assert scene.foreground.shows
    assert share(scene.watch(4, PERSON_THERE)) < 0.1
    assert share(scene.frame([])) < 0.1
    assert elsewhere(scene.frame([])) < 0.02


@pytest.mark.parametrize("grey_first", [True, False])
@pytest.mark.parametrize("channels", [1, 3])
def test_a_camera_that_turns_grey_shows_no_foreground(grey_first, channels):
    scene = Scene()
    colour = scene.wall
    grey = np.repeat(colour.mean(axis=2, keepdims=True), channels, axis=2)
    for n, wall in enumerate([grey, colour, grey, colour] if grey_first else [colour, grey, colour]):
        scene.wall = wall
        mask = scene.watch(4 if n == 0 else 2)
        assert scene.foreground.shows and share(mask, np.s_[:]) < 0.02, n


def block_wall(block_px: int) -> np.ndarray:
    """Squares of random grey."""
    blocks = np.random.default_rng(4).integers(40, 216, (40, 60))
    return np.kron(blocks, np.ones((block_px, block_px))).astype(np.uint8)


def smooth_wall() -> np.ndarray:
    """Patches of random grey without edges."""
    patches = np.random.default_rng(4).integers(40, 216, (40, 60), dtype=np.uint8)
    return cv2.resize(patches, (480, 320), interpolation=cv2.INTER_CUBIC)


@pytest.mark.parametrize("shifts_px", [(6, 15, 3, 12, 18), (4, -4, 4, -4, 2)], ids=["moves", "sways"])
@pytest.mark.parametrize(
    "wall", [*map(block_wall, (4, 5, 6, 8, 12)), smooth_wall()], ids=["4 px", "5 px", "6 px", "8 px", "12 px", "smooth"]
)
def test_one_camera_keeps_its_background_while_it_shows_nothing(wall, shifts_px):
    views = [wall[:120, :160]] * 40 + [np.roll(wall, shift, 1)[:120, :160] for shift in shifts_px]
    views += [np.zeros((120, 160), np.uint8)] * 10 + [wall[:120, :160]] * 20
    camera, clock = CameraSensor(SingleCameraParams(), (160, 120)), StageClock()
    seen = [camera.look(view.copy(), Frame(k, k / 10, ((view,),)), clock) for k, view in enumerate(views)]
    assert not any(v.shows for v in seen[40:55])
    assert all(v.shows for v in [*seen[:40], *seen[-20:]])
    assert not seen[-20].foreground.any()
