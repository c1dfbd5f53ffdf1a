import numpy as np

from calib.types import U8
from planview.engine.config import SingleCameraParams
from planview.engine.one_camera import OneCamera
from planview.foreground.blobs import find_blobs
from planview.foreground.ghosts import GhostParams, find_ghosts, find_still, find_uncovered
from planview.foreground.mixture import Foreground
from planview.foreground.params import ForegroundParams
from stereo.recording import VideoFrame

SHAPE = (60, 80)
BODY = slice(20, 45), slice(30, 40)
NOTHING = np.zeros(SHAPE, np.uint8)


def scene(*bodies: tuple[slice, slice]) -> U8:
    image = np.full(SHAPE, 150, np.uint8)
    for body in bodies:
        image[body] = 40
    return image


def mask_of(*bodies: tuple[slice, slice]) -> U8:
    return np.where(scene(*bodies) == 40, 255, 0).astype(np.uint8)


def test_blob_with_its_outline_in_the_background_is_a_ghost():
    ghosts = find_ghosts(scene(), scene(BODY), find_blobs(mask_of(BODY)), NOTHING, GhostParams())
    np.testing.assert_array_equal(ghosts, mask_of(BODY))


def test_person_standing_still_has_the_outline_in_the_image():
    assert not find_ghosts(scene(BODY), scene(), find_blobs(mask_of(BODY)), NOTHING, GhostParams()).any()


def test_ghost_with_a_walker_in_front_waits_until_the_walker_has_passed():
    walker = slice(20, 45), slice(40, 50)
    image, mask = scene(walker), mask_of(BODY, walker)
    assert not find_ghosts(image, scene(BODY), find_blobs(mask), mask_of(walker), GhostParams()).any()


def test_ghosts_are_told_apart_from_people_beside_them():
    other = slice(20, 45), slice(55, 65)
    ghosts = find_ghosts(scene(other), scene(BODY), find_blobs(mask_of(BODY, other)), NOTHING, GhostParams())
    np.testing.assert_array_equal(ghosts, mask_of(BODY))


def test_place_that_a_person_leaves_is_told_from_the_person_in_one_blob():
    person = slice(20, 45), slice(38, 48)  # two columns overlap BODY
    uncovered = find_uncovered(scene(person), scene(BODY), mask_of(BODY, person), GhostParams())
    assert uncovered[25:40, 31:36].all()
    assert not uncovered[:, 39:].any()


def test_person_in_one_blob_with_another_is_not_uncovered():
    assert not find_uncovered(scene(BODY), scene(), mask_of(BODY), GhostParams()).any()
    assert not find_uncovered(scene(), scene(BODY), np.full(SHAPE, 255, np.uint8), GhostParams()).any()


def test_still_blobs_are_those_in_which_nothing_has_moved():
    other = slice(20, 45), slice(55, 65)
    np.testing.assert_array_equal(
        find_still(find_blobs(mask_of(BODY, other)), mask_of(other), GhostParams()), mask_of(BODY)
    )


def test_empty_and_full_masks_have_no_ghosts():
    assert not find_ghosts(scene(), scene(BODY), find_blobs(NOTHING), NOTHING, GhostParams()).any()
    assert not find_ghosts(
        scene(), scene(BODY), find_blobs(np.full(SHAPE, 255, np.uint8)), NOTHING, GhostParams()
    ).any()


def test_background_luma_is_the_luma_of_the_first_images():
    foreground = Foreground(ForegroundParams(), SHAPE)
    for k in range(5):
        foreground.update(scene(BODY), None, k / 10)
    np.testing.assert_allclose(foreground.background_luma(), scene(BODY), atol=1)


def test_person_there_at_the_start_leaves_no_ghost_even_if_a_tracker_protects_it():
    camera = OneCamera(SingleCameraParams(), SHAPE[::-1])
    protected = np.ones(SHAPE, np.uint8)  # PERSON everywhere: nothing would be learned
    masks = []
    for k in range(60):
        image = np.repeat(scene(BODY)[:, :, None] if k < 5 else scene()[:, :, None], 3, axis=2)
        masks.append(camera.observe(VideoFrame(k, k / 10, image), protected if k >= 5 else None).foreground)
    assert not any(mask[BODY].any() for mask in masks)
