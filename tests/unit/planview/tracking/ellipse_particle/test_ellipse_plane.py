"""What the ellipse-particle tracker measures in images, on painted scenes."""

import re

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
from planview.tracking.ellipse_particle.fit.ellipses import paint_union
from planview.tracking.ellipse_particle.fit.prior import PlaneModel, SizePrior
from planview.tracking.ellipse_particle.objects import Objects
from planview.tracking.ellipse_particle.planes import PlaneView
from planview.tracking.ellipse_particle.visible_length import UNSURE, visible_length

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
    image = ImagePlaneParams(person_height_px=30, aspect=0.4)
    params = EllipseParticleParams(image=image, filter=FEW)
    for mask, expected in ((painted(WHOLE), 1), (painted([40.0, 38, 6, 5, 0.0]), 0)):
        tracker = image_ellipse_tracker(params)
        for i in range(10):
            states = tracker.update(Observation(i, i / 10, foreground=(255 * mask).astype(np.uint8)))
        assert sum(s.state == "confirmed" for s in states) == expected


def test_shadow_speaks_neither_for_nor_against_a_body():
    plane, shadow = ImagePlane(ImagePlaneParams()), np.zeros((60, 80), np.uint8)
    shadow[20:40, 20:40] = 255
    view = plane(Observation(0, 0.0, foreground=np.zeros((60, 80), np.uint8), shadow=shadow))
    assert view is not None
    assert view.mask[30, 30] == pytest.approx(UNSURE, abs=0.01)


def test_specks_of_a_noisy_frame_are_filtered_and_a_thin_person_of_a_quiet_one_is_not():
    rng, plane = np.random.default_rng(0), ImagePlane(ImagePlaneParams())
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
    params = EllipseParticleParams(image=ImagePlaneParams(), filter=FEW)
    tracker, found = image_ellipse_tracker(params), []
    for i in range(5):
        mask = (255 * painted([20.0 + 3 * i, 30, 15, 6, 0.0])).astype(np.uint8)
        found.append([(s.track_id, s.state) for s in tracker.update(Observation(i, i / 10, foreground=mask))])
    # A region counts from its second frame on; four samples teach the size, and the frames until then are enough to
    # confirm the walker in the last of them.
    assert found == [[], [], [], [], [(1, "confirmed")]]


def test_learned_size_is_told_with_the_share_of_what_moves_that_has_it():
    tracker = image_ellipse_tracker(EllipseParticleParams(image=ImagePlaneParams(), filter=FEW))
    assert tracker.notes == ()
    for i in range(5):
        mask = (255 * painted([20.0 + 3 * i, 30, 15, 6, 0.0])).astype(np.uint8)
        tracker.update(Observation(i, i / 10, foreground=mask))
    (note,) = tracker.notes
    told = re.fullmatch(
        r"people are taken for (\d+) px high .* learned from what moves; 100% of it has that size", note
    )
    assert told is not None
    assert int(told[1]) == pytest.approx(30, abs=1)


def test_grid_is_finer_for_short_people_where_the_foreground_is():
    plane, image = ImagePlane(ImagePlaneParams(person_height_px=30)), np.zeros((480, 640, 3), np.uint8)
    fine, coarse = (
        plane(Observation(0, 0.0, image=image, foreground=np.zeros(shape, np.uint8)))
        for shape in ((240, 320), (120, 160))
    )
    assert fine is not None
    assert coarse is not None
    assert (fine.mask.shape, coarse.mask.shape) == ((240, 320), (120, 160))


def after(plane: ImagePlane, walk: list[list[float]]) -> PlaneView:
    """The last view of a walker who is an ellipse in each frame."""
    for i, ellipse in enumerate(walk):
        view = plane(Observation(i, i / 10, foreground=(255 * painted(ellipse)).astype(np.uint8)))
    assert view is not None
    return view


@pytest.mark.parametrize(("given", "separate"), [(None, False), (30.0, True)])
def test_piece_of_a_known_person_is_nobody_until_the_size_is_settled(given, separate):
    plane = ImagePlane(ImagePlaneParams(person_height_px=given))
    view = after(plane, [[40.0 + i, 30, 25, 8, 0.0] for i in range(5)])
    known = view.to_cells(np.array([[40.0, 15.0]]))
    assert plane.is_separate(view, view.to_cells(np.array([40.0, 45.0])), known) is separate
    assert plane.is_separate(view, view.to_cells(np.array([70.0, 45.0])), known)


@pytest.mark.parametrize(("row", "known", "part"), [(45.0, [], True), (45.0, [[40.0, 50.0]], False), (30.0, [], False)])
def test_what_lies_in_a_large_region_that_the_border_cuts_may_be_part_of_someone_near(row, known, part):
    # A person 50 rows long, where people are taken for 20: centred in row 45 the border cuts 10 rows off.
    plane = ImagePlane(ImagePlaneParams(person_height_px=20))
    view = after(plane, [[40.0, row, 25, 8, 0.0]])
    people = view.to_cells(np.array(known).reshape(-1, 2))
    assert plane.may_be_part(view, view.to_cells(np.array([40.0, row - 18])), people) is part


def test_nobody_stands_at_the_horizon_of_a_low_camera():
    # Heads stay in row 10, at eye height: who is centred in row 14 would be 8 rows long, and the smallest seen are 20.
    plane, nobody = ImagePlane(ImagePlaneParams()), np.zeros((0, 2))
    view = after(plane, [[40.0, 10 + half, half, 0.3 * half, 0.0] for half in np.arange(60) / 3 + 10])
    near, horizon = view.to_cells(np.array([[75.0, 25.0], [75.0, 14.0]]))
    assert plane.is_person(view, near, nobody)
    assert not plane.is_person(view, horizon, nobody)


def test_given_size_is_not_told_as_learned():
    plane = ImagePlane(ImagePlaneParams(person_height_px=400))
    plane(Observation(0, 0.0, foreground=np.zeros((480, 640), np.uint8)))
    assert plane.notes == ()


def test_doubles_are_pruned_when_people_prove_larger():
    objects = Objects(FEW, ExistenceParams(), UPRIGHT, np.random.default_rng(0))
    for x, y in ((20.0, 20.0), (60.0, 50.0), (60.0, 42.0), (30.0, 50.0)):
        objects.spawn(np.array([x, y, 4, 1.6, 0]), 0.7, 1, SizePrior(4.0, 0.0, 0.4), 12.0, "")
    # Half lengths of 4 everywhere; then of 5 in row 20 and 17 in row 50, where two of them fall on one person.
    objects.resize(SizePrior(4.0, 0.0, 0.4), SizePrior(-3.0, 0.4, 0.4), 1.4, (60, 80))
    assert [e.who.track_id for e in objects.evidence] == [1, 2, 4]
    assert objects.cycle.decisions[-1].kind == "pruned"


@pytest.mark.parametrize(("aspect", "length_m"), [(0.36, 0.55 / 0.36), (0.2, 1.7), (0.9, 0.85)])
def test_metres_are_those_of_a_persons_breadth_within_the_lengths_of_a_body(aspect, length_m):
    plane, prior = ImagePlane(ImagePlaneParams()), SizePrior(20.0, 0.0, aspect)
    view = plane(Observation(0, 0.0, foreground=np.zeros((60, 80), np.uint8)))
    assert view is not None
    assert plane.cells_per_m(view, prior, np.array([30.0])) == pytest.approx([40 / length_m])


def test_grid_grows_coarser_with_people_and_keeps_their_size_in_pixels():
    plane = ImagePlane(ImagePlaneParams(person_height_px=400))
    view = plane(Observation(0, 0.0, foreground=np.zeros((480, 640), np.uint8)))
    assert view is not None
    prior = plane.prior(view)
    assert prior is not None
    assert view.mask.shape[1] < 80
    assert 2 * prior.half_length(20) * view.scale == pytest.approx(400)


@settings(max_examples=10, deadline=None)
@given(
    st.integers(0, 2**31),
    st.lists(st.sampled_from([(24, 32), (24, 32, 3), (31, 40, 3), (5, 4, 3), (1, 1)]), min_size=1, max_size=8),
)
def test_random_foreground_of_changing_size_give_finite_states(seed, shapes):
    rng = np.random.default_rng(seed)
    tracker = image_ellipse_tracker(EllipseParticleParams(filter=ParticleFilterParams(particles=20)))
    for i, shape in enumerate(shapes):
        image = rng.integers(0, rng.choice([2, 256]), shape, dtype=np.uint8)
        foreground = image if image.ndim == 2 else np.ascontiguousarray(image[:, :, 0])
        for state in tracker.update(Observation(i, i / 10, image=image, foreground=foreground)):
            assert np.isfinite(state.box_px).all()
