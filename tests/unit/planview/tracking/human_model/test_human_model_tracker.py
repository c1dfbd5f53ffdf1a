"""The human-model tracker on drawn people: silhouettes of known models walking on the floor of a known camera."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.errors import InputError
from calib.ground_camera import GroundCamera
from planview.foreground.masks import BACKGROUND, PERSON
from planview.tracking.base import Observation
from planview.tracking.human_model import HumanModelParams, HumanModelTracker
from planview.tracking.human_model.model_map import HumanModelMapParams, build_model_map
from planview.tracking.human_model.params import NewTargetParams
from planview.tracking.human_model.scene import ModelScene
from planview.trajectories.state import TrackState

CAMERA = GroundCamera(160, 120, 120.0, 4.0, math.radians(62))
PARAMS = HumanModelParams(map=HumanModelMapParams(min_height_px=12), spawn=NewTargetParams(min_height_px=12))
MAP = build_model_map(CAMERA, params=PARAMS.map)
FPS = 10
SEATED = PARAMS.posture.sitting
RED, BLUE = (20, 20, 200), (200, 40, 20)

Drawn = tuple[float, float, tuple[int, int, int]]
"""Floor position [m] and colour of a drawn person."""


class World:
    """Draws people as their own models and remembers the last frame for motion."""

    def __init__(self) -> None:
        self._scene = ModelScene(MAP, PARAMS.match)
        self._last: np.ndarray | None = None

    def observe(
        self,
        k: int,
        people: Iterable[Drawn],
        hidden: slice | None = None,
        heights: Iterable[float] | None = None,
        slim: bool = False,
    ) -> Observation:
        image = np.full((120, 160, 3), 128, np.uint8)
        mask = np.zeros((120, 160), np.uint8)
        people = list(people)
        tall = [1.0] * len(people) if heights is None else heights
        for (x, y, colour), height in sorted(zip(people, tall, strict=True), key=lambda p: -p[0][1]):
            one = np.zeros((120, 160), np.uint8)
            self._scene.paint(one, CAMERA.project((x, y, 0.0)), height, 1)
            if slim:
                one = np.asarray(cv2.erode(one, np.ones((1, 5), np.uint8)), np.uint8)
            image[one > 0] = colour
            mask[one > 0] = 255
        if hidden is not None:
            image[:, hidden], mask[:, hidden] = 128, 0
        last = image if self._last is None else self._last
        motion = np.where((image != last).any(axis=2), 255, 0).astype(np.uint8)
        self._last = image
        return Observation(k, k / FPS, image, mask, motion)


def _run(
    path: Callable[[float], Iterable[Drawn]],
    seconds: float,
    hidden: slice | None = None,
    params: HumanModelParams = PARAMS,
) -> tuple[HumanModelTracker, list[tuple[TrackState, ...]], list[str]]:
    tracker, world = HumanModelTracker(params, CAMERA, MAP), World()
    states, kinds = [], []
    for k in range(int(seconds * FPS)):
        states.append(tracker.update(world.observe(k, path(k / FPS), hidden)))
        kinds += [d.kind for d in tracker.decisions]
    return tracker, states, kinds


def _confirmed(states: tuple[TrackState, ...]) -> list[TrackState]:
    return [s for s in states if s.state == "confirmed"]


def _walker(t: float) -> list[Drawn]:
    return [(-2.5 + 1.2 * t, 6.0, RED)]


def test_walker_is_one_track_near_the_truth() -> None:
    _, states, _ = _run(_walker, 3.5)
    rows = [(k, s) for k, frame in enumerate(states) for s in _confirmed(frame)]
    assert len(rows) > 20
    assert len({s.track_id for _, s in rows}) == 1
    errors = [math.hypot(s.x_m - _walker(k / FPS)[0][0], s.y_m - 6.0) for k, s in rows]
    assert np.median(errors) < 0.15
    assert rows[-1][1].vx_mps == pytest.approx(1.2, abs=0.3)
    assert rows[-1][1].height_m == pytest.approx(1.76, abs=0.15)


def test_box_is_the_amodal_model() -> None:
    _, states, _ = _run(_walker, 2.0)
    (state,) = _confirmed(states[-1])
    left, top, width, height = state.box_px
    head, foot = CAMERA.project((state.x_m, 6.0, 1.76)), CAMERA.project((state.x_m, 6.0, 0.0))
    assert left < foot[0] < left + width
    assert top == pytest.approx(head[1], abs=3)
    assert top + height == pytest.approx(foot[1], abs=4)


@pytest.mark.parametrize(("share", "people"), [(0.625, 1), (1.0, 0)])
def test_people_below_the_smallest_height_are_followed_where_those_in_the_middle_are_small_too(
    share: float, people: int
) -> None:
    # People are 26 px high in the middle of the image, and 21 px where this one walks: below 30 px, and 0.83 of it.
    params = PARAMS.model_copy(update={"spawn": NewTargetParams(min_share=share)})
    _, states, _ = _run(lambda t: [(-2.5 + 1.2 * t, 10.0, RED)], 3.0, params=params)
    assert len(_confirmed(states[-1])) == people


def test_two_who_enter_side_by_side_are_split() -> None:
    def path(t: float) -> list[Drawn]:
        return [(-2.5 + 1.2 * t, 6.0, RED), (-2.1 + 1.2 * t, 6.0, BLUE)]

    _, states, kinds = _run(path, 3.0)
    assert len(_confirmed(states[-1])) == 2
    assert kinds.count("spawned") + kinds.count("split") == 2


def test_ids_survive_a_crossing() -> None:
    def path(t: float) -> list[Drawn]:
        return [(-2.5 + 1.2 * t, 6.0, RED), (2.5 - 1.2 * t, 6.6, BLUE)]

    _, states, _ = _run(path, 4.0)
    before = {s.track_id: s.x_m for s in _confirmed(states[12])}
    after = {s.track_id: s.x_m for s in _confirmed(states[38])}
    assert len(before) == len(after) == 2
    assert all(after[i] * x < 0 for i, x in before.items())


def test_walkers_hidden_by_one_another_do_not_sit_down() -> None:
    tracker, world = HumanModelTracker(PARAMS, CAMERA, MAP), World()
    for k in range(5 * FPS):
        x = -2.5 + 1.0 * k / FPS
        tracker.update(world.observe(k, [(x, 6.0, RED), (x + 0.25, 6.8, BLUE)]))
        assert not any(target.seat for target in tracker.targets)


def test_id_survives_a_column_in_front() -> None:
    _, states, kinds = _run(_walker, 4.0, hidden=slice(68, 88))
    assert len({s.track_id for frame in states for s in _confirmed(frame)}) == 1
    assert kinds.count("lost") == 1
    assert kinds.count("reacquired") == 1


def _hidden_for_long(t: float) -> list[Drawn]:
    if t < 2.5:
        return [(-2.5 + t, 6.0, RED)]
    return [(2.0 - (t - 9.0), 4.5, RED)] if t >= 9.0 else []


def test_person_who_was_hidden_for_long_has_the_same_id_again() -> None:
    _, states, _ = _run(_hidden_for_long, 12.0)
    assert {s.track_id for frame in states for s in _confirmed(frame)} == {1}
    assert [s.state for s in states[-1]] == ["confirmed"]


def test_place_behind_a_sign_is_kept_once_the_sign_is_known() -> None:
    """People walk behind a sign that hides the right half of whoever stops beside it."""
    sign = slice(80, 90)
    world, tracker = World(), HumanModelTracker(PARAMS, CAMERA, MAP)
    for k in range(16 * FPS):
        t = k / FPS
        x = -2.5 + 1.0 * (t % 5.0) if t < 10 else min(0.0, -2.5 + 1.0 * (t - 10.0))
        tracker.update(world.observe(k, [(x, 6.0, RED)], hidden=sign))
    (target,) = tracker.targets
    assert abs(target.kalman.x_m) < 0.1


def test_foreground_that_appears_and_stays_is_no_person() -> None:
    tracker, states, _ = _run(lambda t: [(0.0, 6.0, RED)] if t >= 0.5 else [], 5.0)
    assert not any(_confirmed(frame) for frame in states)
    assert (tracker.feedback() == BACKGROUND).any()


def test_video_without_foreground_gives_no_tracks() -> None:
    _, states, kinds = _run(lambda t: [], 1.0)
    assert not any(states)
    assert not kinds


def test_chair_that_was_pushed_and_stays_still_is_a_thing() -> None:
    _, states, kinds = _run(lambda t: [(min(0.0, -1.2 + 1.2 * t), 6.0, RED)], 24.0)
    assert _confirmed(states[40])
    assert not states[-1]
    assert kinds.count("pruned") == 1


def test_person_who_walked_in_stays_one_however_still() -> None:
    _, states, kinds = _run(lambda t: [(min(0.0, -2.5 + 1.2 * t), 6.0, RED)], 26.0)
    assert len(_confirmed(states[-1])) == 1
    assert "pruned" not in kinds


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
    (sits,), (walks,) = _confirmed(states[60]), _confirmed(states[-1])
    assert math.hypot(sits.x_m, sits.y_m - 6.0) < 0.4
    assert walks.track_id == sits.track_id


def test_slim_person_who_stands_is_not_seated() -> None:
    tracker, world = HumanModelTracker(PARAMS, CAMERA, MAP), World()
    for k in range(6 * FPS):
        states = tracker.update(world.observe(k, [(min(0.0, -2.5 + 1.2 * k / FPS), 3.0, RED)], slim=True))
        assert not any(target.seat for target in tracker.targets)
    assert len(_confirmed(states)) == 1


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
    (sits, walks) = _confirmed(states)
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
    (walks,) = _confirmed(states)
    assert walks.track_id == 1
    assert math.hypot(walks.x_m - 1.68, walks.y_m - 6.0) < 0.5


def test_person_who_leaves_the_view_is_removed() -> None:
    _, states, kinds = _run(lambda t: [(1.5 * t, 6.0, RED)], 5.0)
    assert not states[-1]
    assert kinds[-1] == "pruned"


def test_states_appear_in_decisions_and_drawings() -> None:
    tracker, _, kinds = _run(lambda t: [(min(0.0, -2.5 + 1.2 * t), 6.0, RED)], 4.0)
    assert "state" in kinds
    models = next(d for d in tracker.debug().drawings if d.name == "models")
    assert "stationary" in models.labels[0]


def test_feedback_protects_tracked_people() -> None:
    tracker, _, _ = _run(_walker, 2.0)
    u, v = CAMERA.project((-2.5 + 1.2 * 1.9, 6.0, 0.9))
    assert tracker.feedback()[round(float(v)), round(float(u))] == PERSON


def test_feedback_leaves_what_hides_a_person_to_the_background() -> None:
    u = round(float(CAMERA.project((-2.5 + 1.2 * 1.9, 6.0, 0.9))[0]))
    tracker, _, _ = _run(_walker, 2.0, hidden=slice(u - 1, u + 2))
    feedback = tracker.feedback()
    assert (feedback == PERSON).any()
    assert not (feedback[:, u - 1 : u + 2] == PERSON).any()


def test_reset_gives_the_same_tracks_again() -> None:
    tracker, states, _ = _run(_walker, 2.0)
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
    assert len(_confirmed(states)) == 1


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
