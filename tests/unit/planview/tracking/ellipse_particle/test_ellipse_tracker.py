"""The ellipse-particle tracker on paint people whose paths are known, and on unusual input."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from calib.ground_camera import GroundCamera
from planview.engine.config import SingleCameraParams
from planview.engine.sensor import CameraSensor, StageClock
from planview.foreground.params import NO_FEEDBACK, WALKER
from planview.maps.view import View
from planview.tracking.base import Observation
from planview.tracking.ellipse_particle.fit import find_uncovered, paint
from planview.tracking.ellipse_particle.tracker import (
    EllipseParticleParams,
    EllipseParticleTracker,
    EllipseSizeParams,
    ParticleFilterParams,
)
from planview.trajectories.state import TrackState
from stereo.recording import Frame

SHAPE = (120, 160)
GIVEN = EllipseParticleParams(size=EllipseSizeParams(person_height_px=30), filter=ParticleFilterParams(particles=300))


def foreground(*people: tuple[float, float]) -> np.ndarray:
    """People 30 px high and 10 px wide, centred at (x, y)."""
    ellipses = np.array([[x, y, 15.0, 5.0, 0.0] for x, y in people]).reshape(-1, 5)
    return paint(ellipses, SHAPE).any(axis=0) * np.uint8(255)


def masked(
    frame: int, mask: np.ndarray, motion: np.ndarray | None = None, shadow: np.ndarray | None = None, fps: float = 10.0
) -> Observation:
    return Observation(frame, frame / fps, (View.of_mask(mask, motion, None, shadow),))


def follow(tracker: EllipseParticleTracker, masks: list[np.ndarray], fps: float = 10.0) -> list[tuple[TrackState, ...]]:
    return [tracker.update(masked(i, mask, fps=fps)) for i, mask in enumerate(masks)]


def near(states: tuple[TrackState, ...], x: float) -> TrackState:
    return min(states, key=lambda s: abs(s.box_px[0] + s.box_px[2] / 2 - x))


def test_walker_is_followed_with_one_id():
    out = follow(EllipseParticleTracker(GIVEN), [foreground((20 + 2 * i, 60)) for i in range(40)])
    assert [s.state for s in out[-1]] == ["confirmed"]
    assert {s.track_id for states in out for s in states} == {-1, 1}
    left, top, width, height = out[-1][0].box_px
    assert (left + width / 2, top + height / 2) == pytest.approx((98, 60), abs=2)
    assert (width, height) == pytest.approx((10, 30), rel=0.25)


def test_two_people_keep_their_ids_when_they_cross():
    masks = [foreground((20 + 3 * i, 60), (140 - 3 * i, 66)) for i in range(40)]
    out = follow(EllipseParticleTracker(GIVEN), masks)
    first, second = near(out[8], 44).track_id, near(out[8], 116).track_id
    assert first != second and near(out[-1], 137).track_id == first and near(out[-1], 23).track_id == second


def test_id_survives_a_pillar_wider_than_the_person():
    masks = [foreground((20 + 3 * i, 60)) for i in range(40)]
    for mask in masks:
        mask[:, 66:84] = 0
    out = follow(EllipseParticleTracker(GIVEN), masks)
    assert [(s.track_id, s.state) for s in out[-1]] == [(1, "confirmed")]


def test_person_who_leaves_is_removed_with_a_reason():
    tracker, reasons = EllipseParticleTracker(GIVEN), []
    for i in range(80):
        tracker.update(masked(i, foreground((80, 60)) if i < 20 else foreground()))
        reasons += [(d.kind, d.reason) for d in tracker.decisions]
    assert [kind for kind, _ in reasons] == ["spawned", "confirmed", "lost", "pruned"]
    assert "left with probability" in reasons[-1][1]


def test_reset_gives_the_same_tracks_again():
    masks = [foreground((20 + 3 * i, 60), (140 - 3 * i, 66)) for i in range(30)]
    tracker = EllipseParticleTracker(GIVEN)
    first = follow(tracker, masks)
    tracker.reset()
    assert follow(tracker, masks) == first


def test_tracks_are_those_of_the_seed():
    masks = [foreground((20 + 3 * i, 60)) for i in range(10)]
    first, again, other = (follow(EllipseParticleTracker(GIVEN, seed=seed), masks) for seed in (0, 0, 5))
    assert first == again and first != other


def test_camera_gives_places_on_the_floor():
    camera = GroundCamera(640, 480, 600.0, 3.0, math.radians(70))
    foot, head = camera.project([0.5, 6.0, 0.0]), camera.project([0.5, 6.0, 1.8])
    centre, half = (foot + head) / 2, float(foot[1] - head[1]) / 2
    mask = paint(np.array([[*centre, half, 0.35 * half, 0.0]]), (480, 640))[0] * np.uint8(255)
    params = GIVEN.model_copy(update={"size": EllipseSizeParams(person_height_px=2 * half)})
    state = follow(EllipseParticleTracker(params, camera), [mask] * 8)[-1][0]
    assert (state.x_m, state.y_m) == pytest.approx((0.5, 6.0), abs=0.25)
    assert state.height_m == pytest.approx(1.8, abs=0.12)


@pytest.mark.parametrize(("frames", "stops_at"), [(60, 200.0), (150, 80.0)], ids=["who walks", "who stops"])
def test_walker_is_not_absorbed_by_the_background(frames, stops_at):
    scene = np.random.default_rng(0).integers(60, 160, (*SHAPE, 3), dtype=np.uint8)
    tracker = EllipseParticleTracker(GIVEN)
    source = CameraSensor(SingleCameraParams(), SHAPE[::-1], tracker)
    for i in range(frames):
        image = scene.copy()
        if i >= 20:
            image[foreground((min(20 + 2.5 * (i - 20), stops_at), 60)) > 0] = (20, 20, 230)
        view = source.look(image, Frame(i, i / 10, ((image,),)), StageClock())
        states = tracker.update(Observation(i, i / 10, (view,)))
        source.protect(states, view, tracker.decisions)
    assert [s.state for s in states] == ["confirmed"]
    assert states[0].box_px[0] + 6 == pytest.approx(min(117.5, stops_at), abs=4)


def test_debug_shows_what_was_measured():
    tracker = EllipseParticleTracker(GIVEN)
    assert tracker.debug().drawings == ()
    follow(tracker, [foreground((80, 60))] * 5)
    drawings = {d.name: d for d in tracker.debug().drawings}
    assert drawings["objects"].labels == ("1",) and len(drawings["measurements"].strips) == 1
    assert len(drawings["particles"].strips) >= 50
    assert all(a.plane == b.plane for a, b in pairwise(drawings.values()))


def test_people_are_found_again_after_flooded_frames():
    people = [foreground((20 + 2 * i, 60)) for i in range(40)]
    people[20:24] = [np.full(SHAPE, 255, np.uint8)] * 4
    out = follow(EllipseParticleTracker(GIVEN), people)
    assert [s.state for s in out[22]] == ["lost"]
    assert [(s.track_id, s.state) for s in out[-1]] == [(1, "confirmed")]


def test_frames_that_show_nothing_are_not_waited_for():
    tracker, states = EllipseParticleTracker(GIVEN), []
    for i in range(60):  # three seconds without anything, longer than whoever left would be waited for
        mask = foreground((20 + i, 60))
        seen = masked(i, mask) if not 20 <= i < 50 else Observation(i, i / 10, (View.unknown(SHAPE),))
        states.append([(s.track_id, s.state) for s in tracker.update(seen)])
    assert states[19] == states[-1] == [(1, "confirmed")] and states[20:50] == [[(1, "lost")]] * 30


@pytest.mark.parametrize("value", [0, 255])
def test_a_mask_without_an_outline_gives_no_tracks(value):
    masks = [np.full(SHAPE, value, np.uint8)] * 5
    assert follow(EllipseParticleTracker(EllipseParticleParams()), masks) == [()] * 5


@pytest.mark.parametrize(("moves", "state"), [(True, "confirmed"), (False, "tentative")])
def test_what_never_moves_is_nobody(moves, state):
    tracker, mask = EllipseParticleTracker(GIVEN), foreground((80, 60))
    for i in range(10):
        states = tracker.update(masked(i, mask, mask if moves else 0 * mask))
    assert [s.state for s in states] == [state]


def test_piece_of_an_older_object_is_not_confirmed_beside_it():
    whole = [foreground((40 + i, 60)) for i in range(10)]
    # A bag as large as half a person comes to the side of the walker.
    bag = [foreground((50 + i, 60), (55 + i, 60)) for i in range(21)]
    states = follow(EllipseParticleTracker(GIVEN), whole + bag)[-1]
    assert sum(s.state == "confirmed" for s in states) == 1


def test_who_is_hidden_behind_another_is_found_again():
    masks = [foreground((20 + 2 * i, 60), (100, 62)) for i in range(60)]
    out = follow(EllipseParticleTracker(GIVEN), masks)
    assert len({s.track_id for states in out for s in states if s.state == "confirmed"}) == 2
    assert near(out[-1], 138).track_id == near(out[10], 40).track_id


def test_measurements_that_no_object_covers_are_new():
    measured = paint(np.array([[20.0, 30, 15, 5, 0], [60, 30, 15, 5, 0]]), (60, 80))
    assert find_uncovered(measured, measured[:0], 0.35).tolist() == [True, True]
    assert find_uncovered(measured, measured[:1], 0.35).tolist() == [False, True]
    assert find_uncovered(measured[:0], measured, 0.35).tolist() == []
    # One object across two measurements that are apart has one of them.
    twins = paint(np.array([[20.0, 30, 15, 5, 0], [29, 30, 15, 5, 0]]), (60, 80))
    across = paint(np.array([[24.5, 30, 15, 5, 0]]), (60, 80))
    assert find_uncovered(twins, across, 0.35).sum() == 1


@pytest.mark.parametrize("first", [False, True], ids=["while tracking", "beforehand"])
def test_size_is_learned_from_whatever_moves(first):
    tracker = EllipseParticleTracker(EllipseParticleParams(filter=ParticleFilterParams(particles=50)))
    assert tracker.notes == ()
    masks = [foreground((20 + 2 * i, 60)) for i in range(30)]
    if first:
        tracker.study(masked(i, mask) for i, mask in enumerate(masks))
        tracker.reset()
    (last,) = follow(tracker, masks)[7 if first else -1]
    assert last.state == "confirmed" and last.box_px[3] == pytest.approx(30, rel=0.2)
    (note,) = tracker.notes
    assert note.startswith(("assumed size of people: 29", "assumed size of people: 30")) and "px high" in note
    assert "whatever moves" in note and "100%" not in note  # no assurance that these are people
    assert EllipseParticleTracker(GIVEN).notes == ()


def test_shadow_speaks_neither_for_nor_against_a_body():
    tracker, nothing = EllipseParticleTracker(GIVEN), foreground()
    for i in range(8):
        states = tracker.update(masked(i, nothing, shadow=foreground((80, 60))))
    assert states == () and tracker.debug().tiles["foreground"].max() == pytest.approx(0.4 / 1.4, abs=0.01)


def test_feedback_is_where_confirmed_people_are():
    tracker = EllipseParticleTracker(GIVEN)
    assert tracker.feedback() is None
    follow(tracker, [foreground((60 + i, 60)) for i in range(10)])
    mask = tracker.feedback()
    assert (mask[60, 69], mask[60, 20]) == (WALKER, NO_FEEDBACK)


@settings(max_examples=15)
@given(
    st.lists(
        hnp.arrays(np.uint8, (24, 32), elements=st.sampled_from([0, 255]), fill=st.sampled_from([0, 255])),
        min_size=1,
        max_size=12,
    ),
    st.floats(0.001, 3),
    st.booleans(),
)
def test_random_masks_give_finite_states(masks, dt, learn):
    size = {} if learn else {"person_height_px": 10}
    sizes = EllipseSizeParams.model_validate(size)
    tracker = EllipseParticleTracker(EllipseParticleParams(size=sizes, filter=ParticleFilterParams(particles=20)))
    for i, mask in enumerate(masks):
        for state in tracker.update(Observation(i, i * dt, (View.of_mask(mask),))):
            assert np.isfinite(state.box_px).all()
        tracker.debug()
