"""Ghosts, which somebody who was there at the start leaves behind, and the blobs that they are found among."""

import numpy as np
import pytest

from calib.types import U8
from planview.engine.config import SingleCameraParams
from planview.engine.sensor import CameraSensor, StageClock
from planview.foreground.ghosts import find_blobs, find_ghosts, find_still, find_uncovered
from planview.foreground.mixture import Foreground
from planview.foreground.params import ForegroundParams
from planview.tracking.ellipse_particle import EllipseParticleTracker
from stereo.recording import Frame

GHOST_SHAPE = (60, 80)
BODY, BESIDE, WALKER = (slice(20, 45), slice(30, 40)), (slice(20, 45), slice(55, 65)), (slice(20, 45), slice(40, 50))
NOTHING, FULL = np.zeros(GHOST_SHAPE, np.uint8), np.full(GHOST_SHAPE, 255, np.uint8)


def scene(*bodies: tuple[slice, slice]) -> U8:
    image = np.full(GHOST_SHAPE, 150, np.uint8)
    for body in bodies:
        image[body] = 40
    return image


def mask_of(*bodies: tuple[slice, slice]) -> U8:
    return np.where(scene(*bodies) == 40, 255, 0).astype(np.uint8)


@pytest.mark.parametrize(
    ("image", "background", "mask", "motion", "expected"),
    [
        (scene(), scene(BODY), mask_of(BODY), NOTHING, mask_of(BODY)),
        (scene(BODY), scene(), mask_of(BODY), NOTHING, NOTHING),
        (scene(BESIDE), scene(BODY), mask_of(BODY, BESIDE), NOTHING, mask_of(BODY)),
        (scene(WALKER), scene(BODY), mask_of(BODY, WALKER), mask_of(WALKER), NOTHING),
        (scene(), scene(BODY), NOTHING, NOTHING, NOTHING),
        (scene(), scene(BODY), FULL, NOTHING, NOTHING),
    ],
    ids=[
        "outline in the background", "outline in the image", "next to a person", "a walker in front", "no blob",
        "nothing else",
    ],
)  # fmt: skip
def test_blob_with_its_outline_in_the_background_is_a_ghost(image, background, mask, motion, expected):
    np.testing.assert_array_equal(find_ghosts(image, background, find_blobs(mask), motion), expected)


def test_place_that_a_person_leaves_is_uncovered():
    person = slice(20, 45), slice(38, 48)  # two columns overlap BODY
    uncovered = find_uncovered(scene(person), scene(BODY), mask_of(BODY, person))
    assert uncovered[25:40, 31:36].all()
    assert not uncovered[:, 39:].any()
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
    tracker = EllipseParticleTracker()
    camera, clock = CameraSensor(SingleCameraParams(), GHOST_SHAPE[::-1], tracker), StageClock()
    protected = np.ones(GHOST_SHAPE, np.uint8)  # PERSON everywhere: nothing would be learned
    tracker.feedback = lambda: protected
    masks = []
    for k in range(60):
        image = np.repeat(scene(BODY)[:, :, None] if k < 5 else scene()[:, :, None], 3, axis=2)
        view = camera.look(image, Frame(k, k / 10, ((image,),)), clock)
        masks.append(view.foreground)
        if k >= 4:
            camera.protect((), view, ())
    assert not any(mask[BODY].any() for mask in masks)


def test_diagonal_neighbours_are_one_blob():
    mask = np.array([[7, 0, 0, 0, 9], [0, 7, 0, 0, 9], [0, 0, 0, 0, 0]], np.uint8)
    blobs = find_blobs(mask)
    assert blobs.labels.tolist() == [[1, 0, 0, 0, 2], [0, 1, 0, 0, 2], [0, 0, 0, 0, 0]]
    assert blobs.area_px.tolist() == [11, 2, 2]
    assert blobs.box_px[1:].tolist() == [[0, 0, 2, 2], [4, 0, 1, 2]]


@pytest.mark.parametrize("value", [0, 255])
def test_label_0_is_the_background_where_there_are_no_blobs_or_nothing_else(value):
    blobs = find_blobs(np.full((4, 6), value, np.uint8))
    assert blobs.area_px.tolist() == ([24] if value == 0 else [0, 24])
    assert (blobs.labels == (value > 0)).all()
