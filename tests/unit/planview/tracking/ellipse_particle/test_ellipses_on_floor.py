"""The ellipse-particle tracker on the floor: who may be new, and bodies stand apart."""

import numpy as np
import pytest

from planview.tracking.ellipse_particle import FloorPlane, FloorPlaneParams, ParticleFilterParams, floor_ellipse_tracker
from planview.tracking.ellipse_particle.fit.prior import SizePrior
from planview.tracking.ellipse_particle.particles import ParticleFilter
from planview.tracking.ellipse_particle.planes import PlaneView
from tests.unit.planview.tracking.overhead import Person, observe

PLANE = FloorPlane(FloorPlaneParams())
NONE: list[tuple[float, float]] = []
HERE = (0.0, 0.0)


def view_of(*people: Person):
    view = PLANE(observe(0, list(people)))
    assert view is not None
    return view


def cells(view: PlaneView, *places_m: tuple[float, float]) -> np.ndarray:
    return (np.array(places_m).reshape(-1, 2) - view.origin) / view.scale


def is_person(view: PlaneView, place_m: tuple[float, float], known_m: list[tuple[float, float]]) -> bool:
    return PLANE.is_person(view, cells(view, place_m)[0], cells(view, *known_m))


def is_separate(view: PlaneView, place_m: tuple[float, float], known_m: list[tuple[float, float]]) -> bool:
    return PLANE.is_separate(view, cells(view, place_m)[0], cells(view, *known_m))


def follow(*frames: list[Person]):
    tracker = floor_ellipse_tracker()
    return tracker, [tracker.update(observe(i, people)) for i, people in enumerate(frames)]


def test_place_as_high_as_a_person_is_one_and_a_lower_one_is_not():
    assert is_person(view_of((0.0, 0.0, 1.7)), HERE, NONE)
    assert not is_person(view_of((0.0, 0.0, 1.1)), HERE, NONE)
    assert not is_person(view_of((0.0, 0.0, 1.7)), (1.0, 0.0), NONE)


def test_small_surface_within_reach_of_a_person_is_a_part_of_that_person():
    view, arm = view_of((0.0, 0.0, 1.7)), (0.42, 0.0)
    maps = view.observation.maps
    maps.height[:, maps.grid.n_cols // 2 :] = 1.5  # as high as a person, though there is almost no surface
    assert is_person(view, arm, NONE)
    assert not is_person(view, arm, [HERE])
    assert is_person(view, arm, [(2.0, 2.0)])


def test_place_is_separate_beyond_a_shoulder():
    view = view_of((0.0, 0.0, 1.7))
    assert not is_separate(view, (0.4, 0.0), [HERE])
    assert is_separate(view, (0.9, 0.0), [HERE])
    assert is_separate(view, (0.4, 0.0), NONE)


def test_centres_nearer_than_a_body_are_unlikely():
    # At the distance: 0. At half of it each pair lacks 0.5, two deviations of a quarter: -2. At the same place: -8.
    particles = ParticleFilter(ParticleFilterParams(particles=10), PLANE.model, np.random.default_rng(0))
    for x in (20.0, 30.0):
        particles.add(np.array([x, 20.0, 6.0, 4.0, 0.0]), SizePrior(6.0, 0.0, 0.75), 10.0)
    particles.particles[:, :, :2] = [[20.0, 20.0], [30.0, 20.0]]
    particles.particles[1, 1, 0], particles.particles[2, 1, 0] = 25.0, 20.0
    likely = particles.apart(np.array([0, 1]), distance=10.0)
    assert likely[:4] == pytest.approx([0.0, -2.0, -8.0, 0.0])


def test_walker_is_confirmed_within_half_a_second_and_keeps_one_id():
    _, states = follow(*[[(-1.0 + 0.1 * i, 0.0, 1.7)] for i in range(16)])
    confirmed = [i for i, found in enumerate(states) if any(s.state == "confirmed" for s in found)]
    assert confirmed[0] <= 5  # frames at 10 Hz
    assert {s.track_id for found in states for s in found} == {1}
    assert states[-1][0].x_m == pytest.approx(0.5, abs=0.1)


def test_chair_is_no_person():
    tracker, states = follow(*[[(0.0, 0.0, 0.9)]] * 10)
    assert not any(states)
    assert not any(decision.kind == "spawned" for decision in tracker.decisions)


def test_two_who_pass_side_by_side_keep_their_ids():
    frames = [[(-1.5 + 0.1 * i, 0.25, 1.7), (1.5 - 0.1 * i, -0.25, 1.7)] for i in range(31)]
    _, states = follow(*frames)
    right = next(s.track_id for s in states[8] if s.x_m > 0)
    assert [s.track_id for s in states[-1] if s.x_m < -1.0] == [right]
    assert len({s.track_id for found in states[8:] for s in found}) == 2
