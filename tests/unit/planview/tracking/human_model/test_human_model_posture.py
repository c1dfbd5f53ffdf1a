"""Sitting down, staying seated and getting up, and places that heads tell, on drawn people."""

import math

import numpy as np

from planview.tracking.human_model import HumanModelTracker
from tests.human_model_world import BLUE, CAMERA, FPS, MAP, PARAMS, RED, SEATED, Drawn, World, confirmed


def test_walkers_hidden_by_one_another_do_not_sit_down() -> None:
    tracker, world = HumanModelTracker(PARAMS, CAMERA, MAP), World()
    for k in range(5 * FPS):
        x = -2.5 + 1.0 * k / FPS
        tracker.update(world.observe(k, [(x, 6.0, RED), (x + 0.25, 6.8, BLUE)]))
        assert not any(target.seat for target in tracker.targets)


def test_person_who_sits_down_stays_where_the_seat_is_and_gets_up_again() -> None:
    def height(t: float) -> float:
        """1 until 2.5 s, seated from 3.5 s to 8 s, up again at 9 s."""
        return float(np.interp(t, (2.5, 3.5, 8.0, 9.0), (1.0, SEATED, SEATED, 1.0)))

    def path(t: float) -> list[Drawn]:
        return [(min(0.0, -2.5 + 1.2 * t) + max(0.0, t - 9.5), 6.0, RED)]

    tracker, world = HumanModelTracker(PARAMS, CAMERA, MAP), World()
    states, seated = [], []
    for k in range(11 * FPS):
        states.append(tracker.update(world.observe(k, path(k / FPS), heights=[height(k / FPS)])))
        seated.append([target.seat is not None for target in tracker.targets])
    assert seated[60] == [True]
    assert seated[-1] == [False]
    (sits,), (walks,) = confirmed(states[60]), confirmed(states[-1])
    assert math.hypot(sits.x_m, sits.y_m - 6.0) < 0.4
    assert walks.track_id == sits.track_id


def test_slim_person_who_stands_is_not_seated() -> None:
    tracker, world = HumanModelTracker(PARAMS, CAMERA, MAP), World()
    for k in range(6 * FPS):
        states = tracker.update(world.observe(k, [(min(0.0, -2.5 + 1.2 * k / FPS), 3.0, RED)], slim=True))
        assert not any(target.seat for target in tracker.targets)
    assert len(confirmed(states)) == 1


def test_passer_by_leaves_a_seated_person_on_the_seat() -> None:
    def path(t: float) -> list[Drawn]:
        """One sits from 3.5 s on; from 5 s on another walks past, half hiding the first."""
        sits = (min(0.0, -2.5 + 1.2 * t), 6.0, RED)
        return [sits, (-2.5 + 1.2 * (t - 5.0), 5.0, BLUE)] if t > 5.0 else [sits]

    tracker, world = HumanModelTracker(PARAMS, CAMERA, MAP), World()
    for k in range(9 * FPS):
        t = k / FPS
        heights = [float(np.interp(t, (2.5, 3.5), (1.0, SEATED))), 1.0][: len(path(t))]
        states = tracker.update(world.observe(k, path(t), heights=heights))
    seated, walker = tracker.targets
    assert seated.seat is not None
    assert walker.seat is None
    (sits, walks) = confirmed(states)
    assert math.hypot(sits.x_m, sits.y_m - 6.0) < 0.4
    assert math.hypot(walks.x_m - 2.18, walks.y_m - 5.0) < 0.4


def test_seat_that_is_empty_gives_the_person_back_to_the_floor() -> None:
    def path(t: float) -> list[Drawn]:
        """Sits from 3.5 s on, and walks off at 6 s without being seen to rise."""
        return [(min(0.0, -2.5 + 1.2 * t) + max(0.0, 1.2 * (t - 6.0)), 6.0, RED)]

    tracker, world = HumanModelTracker(PARAMS, CAMERA, MAP), World()
    said = []
    for k in range(75):
        t = k / FPS
        height = 1.0 if t > 6.0 else float(np.interp(t, (2.5, 3.5), (1.0, SEATED)))
        states = tracker.update(world.observe(k, path(t), heights=[height]))
        said += [d.reason for d in tracker.decisions]
    assert "sits down" in said
    (walks,) = confirmed(states)
    assert walks.track_id == 1
    assert math.hypot(walks.x_m - 1.68, walks.y_m - 6.0) < 0.5


def test_person_behind_a_table_stays_where_the_head_tells() -> None:
    """Once the height is known, hidden legs do not put a person farther away."""
    tracker, world = HumanModelTracker(PARAMS, CAMERA, MAP), World()
    for k in range(5 * FPS):
        y = min(6.0, 4.0 + 0.8 * k / FPS)
        observation = world.observe(k, [(min(0.0, -2.5 + 1.2 * k / FPS), y, RED)])
        if k >= 3 * FPS:
            assert observation.foreground is not None
            foot, head = (CAMERA.project((0.0, 6.0, z))[1] for z in (0.0, 1.76))
            observation.foreground[round(foot - 0.4 * (foot - head)) :] = 0
        tracker.update(observation)
    (target,) = tracker.targets
    assert abs(target.kalman.y_m - 6.0) < 0.4
