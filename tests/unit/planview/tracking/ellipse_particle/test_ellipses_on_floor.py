"""The ellipse-particle tracker on the floor: who may be new, and nobody stands inside another."""

import numpy as np
import pytest

from planview.tracking.ellipse_particle import EllipseParticleParams, EllipseParticleTracker
from planview.tracking.ellipse_particle.fit.ellipses import SizePrior
from planview.tracking.ellipse_particle.newcomers import Newcomers
from planview.tracking.ellipse_particle.params import FilterParams, NewcomerParams
from planview.tracking.ellipse_particle.particles import ParticleFilter
from tests.unit.planview.tracking.overhead import Person, observe

NEWCOMERS = Newcomers(NewcomerParams(), separation_m=0.42)
NOBODY = np.zeros((0, 2))
HERE = np.array([0.0, 0.0])


def maps_of(*people: Person):
    return observe(0, list(people)).maps


def follow(*frames: list[Person]):
    tracker = EllipseParticleTracker(EllipseParticleParams(plane="floor"))
    return tracker, [tracker.update(observe(i, people)) for i, people in enumerate(frames)]


def test_person_is_whole_and_somebody_too_low_is_not():
    assert NEWCOMERS.whole(maps_of((0.0, 0.0, 1.7)), HERE, NOBODY)
    assert not NEWCOMERS.whole(maps_of((0.0, 0.0, 1.1)), HERE, NOBODY)
    assert not NEWCOMERS.whole(maps_of((0.0, 0.0, 1.7)), np.array([1.0, 0.0]), NOBODY)


def test_small_surface_within_reach_of_somebody_is_a_piece_of_him():
    maps, arm = maps_of((0.0, 0.0, 1.7)), np.array([0.42, 0.0])
    maps.height[:, maps.grid.n_cols // 2 :] = 1.5  # as high as a person, though almost nothing is seen there
    assert NEWCOMERS.whole(maps, arm, NOBODY)
    assert not NEWCOMERS.whole(maps, arm, HERE[None])
    assert NEWCOMERS.whole(maps, arm, HERE[None] + 2.0)


def test_place_is_split_off_within_a_shoulder_and_farther_along_the_ray():
    maps = maps_of((0.0, 0.0, 1.7))
    assert NEWCOMERS.split_off(maps, np.array([0.4, 0.0]), HERE[None])
    assert not NEWCOMERS.split_off(maps, np.array([0.9, 0.0]), HERE[None])
    assert not NEWCOMERS.split_off(maps, np.array([0.4, 0.0]), NOBODY)


def test_centres_nearer_than_a_body_are_unlikely():
    # At the distance: 0. At half of it each pair lacks 0.5, two deviations of a quarter: -2. At the same place: -8.
    particles = ParticleFilter(FilterParams(particles=10), np.random.default_rng(0))
    for x in (20.0, 30.0):
        particles.add(np.array([x, 20.0, 6.0, 4.0, 0.0]), SizePrior(6.0, 0.0, 0.75), 10.0)
    particles.particles[:, :, :2] = [[20.0, 20.0], [30.0, 20.0]]
    particles.particles[1, 1, 0], particles.particles[2, 1, 0] = 25.0, 20.0
    likely = particles.apart(np.array([0, 1]), least=10.0)
    assert likely[:4] == pytest.approx([0.0, -2.0, -8.0, 0.0])


def test_walker_is_believed_after_his_time_and_keeps_his_id():
    _, states = follow(*[[(-1.0 + 0.1 * i, 0.0, 1.7)] for i in range(16)])
    believed = [i for i, found in enumerate(states) if any(s.state == "confirmed" for s in found)]
    assert believed[0] == pytest.approx(0.4 * 10, abs=1.01)
    assert {s.track_id for found in states for s in found} == {1}
    assert states[-1][0].x_m == pytest.approx(0.5, abs=0.1)


def test_chair_is_nobody():
    tracker, states = follow(*[[(0.0, 0.0, 0.9)]] * 10)
    assert not any(states)
    assert not any(decision.kind == "spawned" for decision in tracker.decisions)


def test_two_who_pass_side_by_side_keep_their_ids():
    frames = [[(-1.5 + 0.1 * i, 0.25, 1.7), (1.5 - 0.1 * i, -0.25, 1.7)] for i in range(31)]
    _, states = follow(*frames)
    right = next(s.track_id for s in states[8] if s.x_m > 0)
    assert [s.track_id for s in states[-1] if s.x_m < -1.0] == [right]
    assert len({s.track_id for found in states[8:] for s in found}) == 2
