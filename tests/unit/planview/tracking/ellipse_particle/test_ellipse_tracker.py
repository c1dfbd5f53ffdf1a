"""The ellipse-particle tracker on painted people whose paths are known, and on unusual input."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from calib.ground_camera import GroundCamera
from planview.engine.config import SingleCameraParams
from planview.engine.one_camera import OneCamera
from planview.tracking.base import Observation
from planview.tracking.ellipse_particle import (
    EllipseParticleParams,
    EllipseParticleTracker,
    ImagePlaneParams,
    ParticleFilterParams,
    image_ellipse_tracker,
)
from planview.tracking.ellipse_particle.fit.ellipses import paint_union
from planview.trajectories.state import TrackState
from stereo.recording import VideoFrame

SHAPE = (120, 160)
GIVEN = EllipseParticleParams(
    image=ImagePlaneParams(person_height_px=30, aspect=0.4),
    filter=ParticleFilterParams(particles=300),
)


def foreground(*people: tuple[float, float]) -> np.ndarray:
    """People 30 px high and 12 px wide, centred at (x, y)."""
    ellipses = np.array([[x, y, 15.0, 6.0, 0.0] for x, y in people]).reshape(-1, 5)
    return paint_union(ellipses, SHAPE) * np.uint8(255)


def follow(tracker: EllipseParticleTracker, masks: list[np.ndarray], fps: float = 10.0) -> list[tuple[TrackState, ...]]:
    return [tracker.update(Observation(i, i / fps, foreground=mask)) for i, mask in enumerate(masks)]


def near(states: tuple[TrackState, ...], x: float) -> TrackState:
    return min(states, key=lambda s: abs(s.box_px[0] + s.box_px[2] / 2 - x))


def test_walker_is_confirmed_and_followed_with_one_id():
    out = follow(image_ellipse_tracker(GIVEN), [foreground((20 + 2 * i, 60)) for i in range(40)])
    assert [s.state for s in out[-1]] == ["confirmed"]
    assert {s.track_id for states in out for s in states} == {1}
    left, top, width, height = out[-1][0].box_px
    assert (left + width / 2, top + height / 2) == pytest.approx((98, 60), abs=2)
    assert (width, height) == pytest.approx((12, 30), rel=0.25)


def test_two_people_keep_their_ids_when_they_cross():
    masks = [foreground((20 + 3 * i, 60), (140 - 3 * i, 66)) for i in range(40)]
    out = follow(image_ellipse_tracker(GIVEN), masks)
    first, second = near(out[8], 44).track_id, near(out[8], 116).track_id
    assert first != second
    assert near(out[-1], 137).track_id == first
    assert near(out[-1], 23).track_id == second


def test_id_survives_an_occlusion_by_something_static():
    masks = [foreground((20 + 3 * i, 60)) for i in range(40)]
    for mask in masks:
        mask[:, 66:84] = 0  # a pillar wider than the person
    out = follow(image_ellipse_tracker(GIVEN), masks)
    assert {s.track_id for states in out for s in states if s.state == "confirmed"} == {1}
    assert [s.state for s in out[-1]] == ["confirmed"]


def test_person_who_leaves_is_removed_with_a_reason():
    tracker = image_ellipse_tracker(GIVEN)
    reasons = []
    for i in range(80):
        mask = foreground((80, 60)) if i < 20 else foreground()
        tracker.update(Observation(i, i / 10, foreground=mask))
        reasons += [(d.kind, d.reason) for d in tracker.decisions]
    assert [kind for kind, _ in reasons] == ["spawned", "confirmed", "lost", "pruned"]
    assert "left with probability" in reasons[-1][1]


def test_sizes_are_learned_without_being_given():
    params = EllipseParticleParams(image=ImagePlaneParams(), filter=ParticleFilterParams(particles=300))
    out = follow(image_ellipse_tracker(params), [foreground((20 + 2 * i, 50), (140 - 2 * i, 80)) for i in range(30)])
    assert len(out[-1]) == 2
    assert all(s.box_px[3] == pytest.approx(30, rel=0.2) for s in out[-1])


def test_same_seed_same_tracks_and_reset_starts_again():
    masks = [foreground((20 + 3 * i, 60), (140 - 3 * i, 66)) for i in range(30)]
    tracker = image_ellipse_tracker(GIVEN)
    first = follow(tracker, masks)
    tracker.reset()
    assert follow(tracker, masks) == first
    assert follow(image_ellipse_tracker(GIVEN), masks) == first
    assert follow(image_ellipse_tracker(GIVEN, seed=5), masks) != first


@pytest.mark.parametrize("joint", [True, False])
def test_joint_and_factored_filters_follow_two_people_apart(joint):
    params = GIVEN.model_copy(update={"filter": ParticleFilterParams(particles=600, joint=joint)})
    out = follow(image_ellipse_tracker(params), [foreground((20 + 2 * i, 40), (140 - 2 * i, 90)) for i in range(25)])
    assert len(out[-1]) == 2
    assert near(out[-1], 68).box_px[1] == pytest.approx(25, abs=4)


def test_camera_gives_floor_positions_and_heights():
    camera = GroundCamera(640, 480, 600.0, 3.0, math.radians(70))
    foot, head = camera.project([0.5, 6.0, 0.0]), camera.project([0.5, 6.0, 1.8])
    centre, half = (foot + head) / 2, float(foot[1] - head[1]) / 2
    mask = paint_union(np.array([[*centre, half, 0.4 * half, 0.0]]), (480, 640)) * np.uint8(255)
    params = GIVEN.model_copy(update={"image": ImagePlaneParams(person_height_px=2 * half, aspect=0.4)})
    state = follow(image_ellipse_tracker(params, camera), [mask] * 8)[-1][0]
    assert (state.x_m, state.y_m) == pytest.approx((0.5, 6.0), abs=0.25)
    assert state.height_m == pytest.approx(1.8, abs=0.12)


def test_walker_is_found_in_images():
    rng = np.random.default_rng(0)
    scene = rng.integers(60, 160, (*SHAPE, 3), dtype=np.uint8)
    tracker = image_ellipse_tracker(
        EllipseParticleParams(
            image=ImagePlaneParams(person_height_px=30, aspect=0.4), filter=ParticleFilterParams(particles=300)
        )
    )
    source = OneCamera(SingleCameraParams(), SHAPE[::-1], tracker.foreground_columns)
    for i in range(60):
        image = scene.copy()
        if i >= 20:
            image[foreground((20 + 2.5 * (i - 20), 60)) > 0] = (20, 20, 230)
        states = tracker.update(source.observe(VideoFrame(i, i / 10, image), tracker.feedback()))
    assert [s.state for s in states] == ["confirmed"]
    assert states[0].box_px[0] + 6 == pytest.approx(117.5, abs=4)


def test_walker_who_stops_is_not_absorbed_by_the_background():
    scene = np.random.default_rng(0).integers(60, 160, (*SHAPE, 3), dtype=np.uint8)
    params = EllipseParticleParams(
        image=ImagePlaneParams(person_height_px=30, aspect=0.4), filter=ParticleFilterParams(particles=300)
    )
    tracker = image_ellipse_tracker(params)
    source = OneCamera(SingleCameraParams(), SHAPE[::-1], tracker.foreground_columns)
    for i in range(150):
        image = scene.copy()
        if i >= 20:
            image[foreground((min(20 + 2.5 * (i - 20), 80), 60)) > 0] = (20, 20, 230)
        states = tracker.update(source.observe(VideoFrame(i, i / 10, image), tracker.feedback()))
    assert [s.state for s in states] == ["confirmed"]


def test_debug_shows_measurements_objects_and_particles():
    tracker = image_ellipse_tracker(GIVEN)
    assert tracker.debug().drawings == ()
    follow(tracker, [foreground((80, 60))] * 5)
    drawings = {d.name: d for d in tracker.debug().drawings}
    assert drawings["objects"].labels == ("1",)
    assert len(drawings["measurements"].strips) == 1
    assert len(drawings["particles"].strips) >= 50
    assert all(a.plane == b.plane for a, b in pairwise(drawings.values()))


def test_flooded_frames_measure_nothing_and_people_are_found_again():
    people = [foreground((20 + 2 * i, 60)) for i in range(40)]
    people[20:24] = [np.full(SHAPE, 255, dtype=np.uint8)] * 4
    out = follow(image_ellipse_tracker(GIVEN), people)
    assert [s.state for s in out[22]] == ["lost"]
    assert [(s.track_id, s.state) for s in out[-1]] == [(1, "confirmed")]


@pytest.mark.parametrize("value", [0, 255])
def test_no_foreground_and_foreground_everywhere_give_no_tracks(value):
    params = EllipseParticleParams(image=ImagePlaneParams())
    masks = [np.full(SHAPE, value, dtype=np.uint8)] * 5
    assert follow(image_ellipse_tracker(params), masks) == [()] * 5


def test_one_frame_and_missing_images_are_no_trouble():
    tracker = image_ellipse_tracker()
    assert tracker.update(Observation(0, 0.0)) == ()
    assert tracker.update(Observation(1, 0.1, image=np.zeros((48, 64, 3), dtype=np.uint8))) == ()


def test_wrong_arrays_are_refused():
    with pytest.raises(ValueError, match="uint8 foreground"):
        image_ellipse_tracker(GIVEN).update(Observation(0, 0.0, foreground=np.zeros((5, 5, 3), dtype=np.uint8)))


@settings(max_examples=15, deadline=None)
@given(
    st.lists(
        hnp.arrays(np.uint8, (24, 32), elements=st.sampled_from([0, 255]), fill=st.sampled_from([0, 255])),
        min_size=1,
        max_size=12,
    ),
    st.floats(0, 3),
    st.booleans(),
)
def test_random_masks_and_times_give_finite_states(masks, dt, learn):
    size = {} if learn else {"person_height_px": 10}
    image = ImagePlaneParams.model_validate(size)
    tracker = image_ellipse_tracker(EllipseParticleParams(image=image, filter=ParticleFilterParams(particles=20)))
    for i, mask in enumerate(masks):
        for state in tracker.update(Observation(i, i * dt, foreground=mask)):
            assert np.isfinite(state.box_px).all()
        tracker.debug()
