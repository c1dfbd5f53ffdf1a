"""What the ellipse-particle tracker measures in images, and which sizes it learns from them, on painted scenes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planview.tracking.base import Observation
from planview.tracking.ellipse_particle import (
    EllipseParticleParams,
    ExistenceParams,
    ImagePlane,
    ImagePlaneParams,
    ParticleFilterParams,
    image_ellipse_tracker,
)
from planview.tracking.ellipse_particle.background import UNSURE, Background
from planview.tracking.ellipse_particle.fit.ellipses import paint_union
from planview.tracking.ellipse_particle.fit.prior import PlaneModel, SizePrior
from planview.tracking.ellipse_particle.objects import Objects
from planview.tracking.ellipse_particle.size_learning import SizeLearner, log_density, weights
from planview.tracking.ellipse_particle.visible_length import visible_length

PRIOR = SizePrior(15.0, 0.0, 0.4)
WHOLE = np.array([40.0, 30, 15, 6, 0.0])
UPRIGHT = PlaneModel(0.1, 0.35, 0.09, 0.0, 0.5, 1.0)
FEW = ParticleFilterParams(particles=50)


def painted(*ellipses: np.ndarray) -> np.ndarray:
    return paint_union(np.array(ellipses), (60, 80)).astype(np.float32)


def test_visible_length_is_one_for_a_person_and_small_for_a_suitcase():
    suitcase = np.array([40.0, 38, 5, 4, 0.0])
    assert visible_length(painted(WHOLE), WHOLE[None], np.array([0]), PRIOR) == pytest.approx([1.0], abs=0.1)
    assert visible_length(painted(suitcase), WHOLE[None], np.array([0]), PRIOR)[0] < 0.4


def test_visible_length_of_a_person_cut_by_the_border_counts_the_part_inside():
    low = np.array([40.0, 59, 15, 6, 0.0])
    assert visible_length(painted(low), low[None], np.array([0]), PRIOR) == pytest.approx([1.0], abs=0.15)


def test_visible_length_in_turn_leaves_nothing_to_a_twin():
    twins = np.array([WHOLE, WHOLE])
    shown = visible_length(painted(WHOLE), twins, np.array([1, 0]), PRIOR)
    assert shown[1] == pytest.approx(1.0, abs=0.1)
    assert shown[0] == 0.0


def test_visible_length_counts_rows_of_a_single_leg_but_neither_a_shadow_nor_a_speck():
    # Of the 29 rows of the ellipse, 16 to 44, a body fills 16 to 27; below there is a leg of 1 cell, 0.1 m of 1.7 m
    # being 1.8 of 30 cells. Of 11 cells a leg would fill too little.
    for below, rows in ((1.0, 29), (UNSURE, 12), (0.7, 12)):
        mask = np.zeros((60, 80), dtype=np.float32)
        mask[16:28, 30:51] = 1
        mask[28:45, 30:51] = UNSURE
        mask[28:45, 40] = below
        assert visible_length(mask, WHOLE[None], np.array([0]), PRIOR) == pytest.approx([rows / 29], abs=1e-6)


def test_visible_length_leaves_to_an_older_one_what_sticks_out_of_it():
    # Three cells of a broad body are outside the older ellipse, which has all the rest of the second one's.
    mask = painted([40.0, 30, 15, 9, 0.0])
    beside = np.array([WHOLE, (43.0, 30, 15, 6, 0.0)])
    assert visible_length(mask, beside, np.array([0, 1]), PRIOR)[1] < 0.2
    # Far enough to the side nothing is contested, and the same leg is a person's.
    legs = np.zeros((60, 80), dtype=np.float32)
    legs[16:45, [40, 60]] = 1
    apart = np.array([WHOLE, (60.0, 30, 15, 6, 0.0)])
    assert visible_length(legs, apart, np.array([0, 1]), PRIOR) == pytest.approx([1.0, 1.0], abs=0.05)


def test_suitcase_is_no_person_and_a_person_is():
    image = ImagePlaneParams(source="given", person_height_px=30, aspect=0.4)
    params = EllipseParticleParams(image=image, filter=FEW)
    for mask, expected in ((painted(WHOLE), 1), (painted([40.0, 38, 6, 5, 0.0]), 0)):
        tracker = image_ellipse_tracker(params)
        for i in range(10):
            states = tracker.update(Observation(i, i / 10, foreground=(255 * mask).astype(np.uint8)))
        assert sum(s.state == "confirmed" for s in states) == expected


def scene_with(rng: np.random.Generator, colour: tuple[int, int, int] | None) -> np.ndarray:
    image = np.full((60, 80, 3), 120, dtype=np.uint8) + rng.integers(0, 4, (60, 80, 3), dtype=np.uint8)
    if colour is not None:
        image[20:50, 30:42] = colour
    return image


@pytest.mark.parametrize(("colour", "expected"), [((20, 20, 230), 255), ((80, 80, 80), 73), (None, 0)])
def test_labels_of_background_speak_for_a_body_or_neither_for_nor_against(colour, expected):
    rng, background = np.random.default_rng(0), Background(ImagePlaneParams())
    for _ in range(30):
        background.update(scene_with(rng, None))
    assert np.median(background.update(scene_with(rng, colour))[22:48, 32:40]) == expected


def test_place_that_a_person_left_after_a_long_stay_is_background():
    rng, background = np.random.default_rng(0), Background(ImagePlaneParams(history=100))
    for _ in range(30):
        background.update(scene_with(rng, None))
    outline = np.array([[26, 16], [46, 16], [46, 54], [26, 54]], dtype=np.float32)
    for _ in range(150):
        background.protect([outline])
        background.update(scene_with(rng, (20, 20, 230)))
    background.protect([])
    # Meanwhile the light has changed by as much as the noise.
    left = scene_with(rng, None) + np.uint8(4)
    assert (background.update(left)[20:50, 30:42] == 255).mean() < 0.02


def test_specks_of_a_noisy_frame_are_filtered_and_a_thin_person_of_a_quiet_one_is_not():
    rng, plane = np.random.default_rng(0), ImagePlane(ImagePlaneParams(source="given"))
    quiet = np.zeros((120, 160), dtype=np.uint8)
    quiet[40:80, 50:52] = 255
    noisy = np.where(rng.random((120, 160)) < 0.1, 255, quiet).astype(np.uint8)
    image = np.zeros((240, 320, 3), dtype=np.uint8)
    masks = []
    for foreground in (quiet, noisy):
        view = plane(Observation(0, 0.0, image=image, foreground=foreground))
        assert view is not None
        masks.append(view.mask)
    assert masks[0].sum() == pytest.approx(80)
    assert masks[1].sum() < 0.4 * (noisy > 0).sum()


def test_frames_that_taught_the_size_are_tracked_once_it_is_known():
    params = EllipseParticleParams(image=ImagePlaneParams(source="given"), filter=FEW)
    tracker, found = image_ellipse_tracker(params), []
    for i in range(4):
        mask = (255 * painted([20.0 + 3 * i, 30, 15, 6, 0.0])).astype(np.uint8)
        found.append([(s.track_id, s.state) for s in tracker.update(Observation(i, i / 10, foreground=mask))])
    # Four samples teach the size; those four frames are enough to confirm the walker in the last of them.
    assert found == [[], [], [], [(1, "confirmed")]]


def test_size_is_that_of_one_person_where_people_hide_one_another():
    rng, learner = np.random.default_rng(0), SizeLearner(ImagePlaneParams())
    for frame in range(60):
        y = rng.uniform(30, 60, 3)
        behind = y[2] + rng.uniform(8, 14)
        places = [(20.0, y[0]), (55.0, y[1]), (90.0, y[2]), (90.0, behind)]
        people = np.array([[*place, a, 0.35 * a, 0.0] for place, a in zip(places, rng.normal(10, 0.8, 4), strict=True)])
        prior = learner.update(paint_union(people, (100, 120)).astype(np.float32), frame / 10)
    assert prior is not None
    assert prior.half_length(45) == pytest.approx(10, rel=0.1)


def test_doubles_are_pruned_when_people_prove_larger():
    objects = Objects(FEW, ExistenceParams(), UPRIGHT, np.random.default_rng(0))
    for x, y in ((20.0, 20.0), (60.0, 50.0), (60.0, 42.0), (30.0, 50.0)):
        objects.spawn(np.array([x, y, 4, 1.6, 0]), 0.7, 1, SizePrior(4.0, 0.0, 0.4), 12.0, "")
    # Half lengths of 4 everywhere; then of 5 in row 20 and 17 in row 50, where two of them fall on one person.
    objects.resize(SizePrior(4.0, 0.0, 0.4), SizePrior(-3.0, 0.4, 0.4), 1.4, (60, 80))
    assert [e.who.track_id for e in objects.evidence] == [1, 2, 4]
    assert objects.cycle.decisions[-1].kind == "pruned"


def test_density_of_lengths_is_largest_for_one_person_and_group_beats_speck():
    one, group, piece, odd = log_density(np.array([20.0, 32, 8, 80]), np.full(4, 20.0))
    assert one > piece > odd
    assert one > group > odd


def test_samples_that_are_alike_share_their_weight():
    samples = np.array([[30.0, 20, 7, 100], [30, 20, 7, 100], [30, 20, 7, 100], [30, 20, 7, 100], [60, 30, 9, 100]])
    np.testing.assert_allclose(weights(samples), [5, 5, 5, 5, 10])


@settings(max_examples=10, deadline=None)
@given(
    st.integers(0, 2**31),
    st.lists(st.sampled_from([(24, 32), (24, 32, 3), (31, 40, 3), (5, 4, 3), (1, 1)]), min_size=1, max_size=8),
)
def test_random_images_of_changing_size_give_finite_states(seed, shapes):
    rng = np.random.default_rng(seed)
    tracker = image_ellipse_tracker(EllipseParticleParams(filter=ParticleFilterParams(particles=20)))
    for i, shape in enumerate(shapes):
        image = rng.integers(0, rng.choice([2, 256]), shape, dtype=np.uint8)
        for state in tracker.update(Observation(i, i / 10, image=image)):
            assert np.isfinite(state.box_px).all()
