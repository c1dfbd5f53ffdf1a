"""The human-model tracker on drawn people: silhouettes of known models walking on the floor of a known camera."""

import math
from dataclasses import replace

import numpy as np
import pytest

from calib.errors import InputError
from planview.foreground.params import BACKGROUND, PERSON, WALKER
from planview.tracking.base import Observation
from planview.tracking.human_model import HumanModelTracker
from tests.human_model_world import BLUE, CAMERA, FPS, MAP, PARAMS, RED, Drawn, World, confirmed, run


def _walker(t: float) -> list[Drawn]:
    return [(-2.5 + 1.2 * t, 6.0, RED)]


def test_walker_is_one_track_near_the_truth() -> None:
    _, states, _ = run(_walker, 3.5)
    rows = [(k, s) for k, frame in enumerate(states) for s in confirmed(frame)]
    assert len(rows) > 20
    assert len({s.track_id for _, s in rows}) == 1
    errors = [math.hypot(s.x_m - _walker(k / FPS)[0][0], s.y_m - 6.0) for k, s in rows]
    assert np.median(errors) < 0.15
    assert rows[-1][1].vx_mps == pytest.approx(1.2, abs=0.3)
    assert rows[-1][1].height_m == pytest.approx(1.76, abs=0.15)


def test_box_is_the_amodal_model() -> None:
    _, states, _ = run(_walker, 2.0)
    (state,) = confirmed(states[-1])
    left, top, width, height = state.box_px
    head, foot = CAMERA.project((state.x_m, 6.0, 1.76)), CAMERA.project((state.x_m, 6.0, 0.0))
    assert left < foot[0] < left + width
    assert top == pytest.approx(head[1], abs=3)
    assert top + height == pytest.approx(foot[1], abs=4)


def test_two_who_enter_side_by_side_are_split() -> None:
    def path(t: float) -> list[Drawn]:
        return [(-2.5 + 1.2 * t, 6.0, RED), (-1.8 + 1.2 * t, 6.0, BLUE)]

    _, states, kinds = run(path, 3.0)
    assert len(confirmed(states[-1])) == 2
    assert kinds.count("spawned") + kinds.count("split") == 2


def test_ids_survive_a_crossing() -> None:
    def path(t: float) -> list[Drawn]:
        return [(-2.5 + 1.2 * t, 6.0, RED), (2.5 - 1.2 * t, 6.6, BLUE)]

    _, states, _ = run(path, 4.0)
    before = {s.track_id: s.x_m for s in confirmed(states[12])}
    after = {s.track_id: s.x_m for s in confirmed(states[38])}
    assert len(before) == len(after) == 2
    assert all(after[i] * x < 0 for i, x in before.items())


def test_id_survives_a_column_in_front() -> None:
    _, states, kinds = run(_walker, 4.0, hidden=slice(68, 88))
    assert len({s.track_id for frame in states for s in confirmed(frame)}) == 1
    assert kinds.count("lost") == 1
    assert kinds.count("reacquired") == 1


def _hidden_for_long(t: float) -> list[Drawn]:
    if t < 2.5:
        return [(-2.5 + t, 6.0, RED)]
    return [(2.0 - (t - 9.0), 4.5, RED)] if t >= 9.0 else []


def test_person_who_was_hidden_for_long_has_the_same_id_again() -> None:
    _, states, _ = run(_hidden_for_long, 12.0)
    assert {s.track_id for frame in states for s in confirmed(frame)} == {1}
    assert [s.state for s in states[-1]] == ["confirmed"]


def test_foreground_that_appears_and_stays_is_no_person() -> None:
    tracker, states, _ = run(lambda t: [(0.0, 6.0, RED)] if t >= 0.5 else [], 5.0)
    assert not any(confirmed(frame) for frame in states)
    assert (tracker.feedback() == BACKGROUND).any()


def test_video_without_foreground_gives_no_tracks() -> None:
    _, states, kinds = run(lambda t: [], 1.0)
    assert not any(states)
    assert not kinds


def test_chair_that_was_pushed_and_stays_still_is_a_thing() -> None:
    _, states, _ = run(lambda t: [(min(0.0, -1.2 + 1.2 * t), 6.0, RED)], 30.0)
    assert confirmed(states[40])
    assert not confirmed(states[-1])


def test_person_who_walked_in_stays_one_however_still() -> None:
    _, states, kinds = run(lambda t: [(min(0.0, -2.5 + 1.2 * t), 6.0, RED)], 26.0)
    assert len(confirmed(states[-1])) == 1
    assert "pruned" not in kinds


def test_person_who_leaves_the_view_is_removed() -> None:
    _, states, kinds = run(lambda t: [(1.5 * t, 6.0, RED)], 5.0)
    assert not states[-1]
    assert kinds[-1] == "pruned"


def test_states_appear_in_decisions_and_drawings() -> None:
    tracker, _, kinds = run(lambda t: [(min(0.0, -2.5 + 1.2 * t), 6.0, RED)], 4.0)
    assert "state" in kinds
    models = next(d for d in tracker.debug().drawings if d.name == "models")
    assert "stationary" in models.labels[0]


@pytest.mark.parametrize(("seconds", "label"), [(1.0, PERSON), (2.0, WALKER)])
def test_feedback_protects_tracked_people_and_tells_who_has_walked(seconds: float, label: int) -> None:
    tracker, _, _ = run(_walker, seconds)
    u, v = CAMERA.project((-2.5 + 1.2 * (seconds - 0.1), 6.0, 0.9))
    assert tracker.feedback()[round(float(v)), round(float(u))] == label


def test_feedback_leaves_what_hides_a_person_to_the_background() -> None:
    u = round(float(CAMERA.project((-2.5 + 1.2 * 1.9, 6.0, 0.9))[0]))
    tracker, _, _ = run(_walker, 2.0, hidden=slice(u - 1, u + 2))
    feedback = tracker.feedback()
    assert (feedback == WALKER).any()
    assert not np.isin(feedback[:, u - 1 : u + 2], (PERSON, WALKER)).any()


def test_reset_gives_the_same_tracks_again() -> None:
    tracker, states, _ = run(_walker, 2.0)
    tracker.reset()
    world = World()
    again = [tracker.update(world.observe(k, _walker(k / FPS))) for k in range(20)]
    assert again == states


def test_images_of_another_size_are_refused() -> None:
    tracker = HumanModelTracker(PARAMS, CAMERA, MAP)
    mask = np.zeros((60, 80), np.uint8)
    with pytest.raises(InputError, match=r"expected images of 160x120 px.*found 80x60"):
        tracker.update(Observation(0, 0.0, None, mask, mask))


def test_missing_foreground_is_refused() -> None:
    with pytest.raises(ValueError, match="foreground and motion"):
        HumanModelTracker(PARAMS, CAMERA, MAP).update(Observation(0, 0.0))


def test_map_of_another_camera_is_refused() -> None:
    with pytest.raises(InputError, match="human model map"):
        HumanModelTracker(PARAMS, replace(CAMERA, height_m=5.0), MAP)


def test_grey_video_is_tracked_without_colours() -> None:
    tracker, world = HumanModelTracker(PARAMS, CAMERA, MAP), World()
    for k in range(20):
        seen = world.observe(k, _walker(k / FPS))
        states = tracker.update(replace(seen, image=seen.image[:, :, 2].copy()))  # type: ignore[index]
    assert len(confirmed(states)) == 1
