"""The human-model tracker."""

import math
from dataclasses import replace

import numpy as np
import pytest
from toy_people import confirmed

from calib.errors import InputError
from planview.foreground.params import BACKGROUND, PERSON, WALKER
from planview.maps.view import BACKGROUND_SEEN, PixelRays, View
from planview.tracking import body
from planview.tracking.base import Observation
from planview.tracking.explain.explanation import People, loose_prior, upright_pose
from planview.tracking.explain.samples import PARTS
from planview.tracking.human_model import HumanModelParams, HumanModelTracker
from planview.tracking.human_model.explanation import MaskExplanation, likelihood_of_masks, silhouette
from planview.tracking.human_model.walker import FloorPlaces, ModelMatch, find_newcomers, match_hulls
from tests.human_model_world import BLUE, CAMERA, FPS, MAP, PARAMS, RED, Drawn, World, run
from tests.reference.explain import log_likelihood_of_mask


def _walker(t: float) -> list[Drawn]:
    return [(-2.5 + 1.2 * t, 6.0, RED)]


def test_walker_is_one_track_near_the_truth_with_the_box_of_the_whole_model():
    _, states, _ = run(_walker, 3.5)
    rows = [(k, s) for k, frame in enumerate(states) for s in confirmed(frame)]
    assert len(rows) > 20 and len({s.track_id for _, s in rows}) == 1
    errors = [math.hypot(s.x_m - _walker(k / FPS)[0][0], s.y_m - 6.0) for k, s in rows]
    assert np.median(errors) < 0.15 and rows[-1][1].vx_mps == pytest.approx(1.2, abs=0.3)
    assert rows[-1][1].height_m == pytest.approx(1.76, abs=0.15)
    (state,) = confirmed(states[19])
    left, top, width, height = state.box_px
    head, foot = CAMERA.project((state.x_m, 6.0, 1.76)), CAMERA.project((state.x_m, 6.0, 0.0))
    assert left < foot[0] < left + width and top == pytest.approx(head[1], abs=3)
    assert top + height == pytest.approx(foot[1], abs=4)


def test_two_who_enter_side_by_side_are_split():
    def path(t):
        return [(-2.5 + 1.2 * t, 6.0, RED), (-1.8 + 1.2 * t, 6.0, BLUE)]

    _, states, kinds = run(path, 3.0)
    assert len(confirmed(states[-1])) == 2 and kinds.count("spawned") + kinds.count("split") == 2


def test_ids_survive_a_crossing():
    def path(t):
        return [(-2.5 + 1.2 * t, 6.0, RED), (2.5 - 1.2 * t, 6.6, BLUE)]

    _, states, _ = run(path, 4.0)
    before = {s.track_id: s.x_m for s in confirmed(states[12])}
    after = {s.track_id: s.x_m for s in confirmed(states[38])}
    assert len(before) == len(after) == 2 and all(after[i] * x < 0 for i, x in before.items())


def test_id_survives_a_column_in_front():
    _, states, kinds = run(_walker, 4.0, hidden=slice(68, 88))
    assert len({s.track_id for frame in states for s in confirmed(frame)}) == 1 and kinds.count("lost") == 1
    assert kinds.count("reacquired") == 1


def test_a_walker_is_predicted_through_frames_that_show_nothing():
    tracker, world, states = HumanModelTracker(PARAMS, CAMERA, MAP), World(), []
    for k in range(int(3.5 * FPS)):
        seen = world.observe(k, _walker(k / FPS), None, None)
        states.append(tracker.update(replace(seen, views=(View.unknown((120, 160)),)) if 20 <= k < 28 else seen))
    ids = [[s.track_id for s in frame] for frame in states]
    assert ids[19:] == [ids[19]] * len(ids[19:]) and {s.state for s in states[24]} == {"lost"}
    assert {s.state for s in states[-1]} == {"confirmed"} and ids[-1] == [1]


def test_person_who_was_hidden_for_long_has_the_same_id_again():
    def path(t):
        return [(-2.5 + t, 6.0, RED)] if t < 2.5 else [(11.0 - t, 4.5, RED)] * (t >= 9.0)

    _, states, _ = run(path, 12.0)
    assert {s.track_id for frame in states for s in confirmed(frame)} == {1}
    assert [s.state for s in states[-1]] == ["confirmed"]


def test_foreground_that_stays_where_it_appears_is_no_person():
    tracker, states, _ = run(lambda t: [(0.0, 6.0, RED)] if t >= 0.5 else [], 5.0)
    assert not any(confirmed(frame) for frame in states)
    assert (tracker.feedback() == BACKGROUND).any()


def test_nobody_is_found_without_foreground():
    _, states, kinds = run(lambda t: [], 1.0)
    assert not any(states) and not kinds


def test_chair_that_stays_where_it_was_pushed_is_a_thing():
    _, states, _ = run(lambda t: [(min(0.0, -1.2 + 1.2 * t), 6.0, RED)], 30.0)
    assert confirmed(states[40]) and not confirmed(states[-1])


def test_person_who_walked_in_stays_one_however_still():
    _, states, kinds = run(lambda t: [(min(0.0, -2.5 + 1.2 * t), 6.0, RED)], 26.0)
    assert len(confirmed(states[-1])) == 1 and "pruned" not in kinds


def test_person_who_leaves_the_view_is_removed():
    _, states, kinds = run(lambda t: [(1.5 * t, 6.0, RED)], 5.0)
    assert not states[-1] and kinds[-1] == "pruned"


def test_states_appear_where_they_are_explained():
    tracker, _, kinds = run(lambda t: [(min(0.0, -2.5 + 1.2 * t), 6.0, RED)], 4.0)
    models, _ = tracker.debug().drawings
    assert "state" in kinds and "stationary" in models.labels[0]


@pytest.mark.parametrize(("seconds", "label"), [(1.0, PERSON), (2.0, WALKER)])
def test_feedback_labels_a_person_by_the_way_walked(seconds, label):
    tracker, _, _ = run(_walker, seconds)
    u, v = CAMERA.project((-2.5 + 1.2 * (seconds - 0.1), 6.0, 0.9))
    assert tracker.feedback()[round(float(v)), round(float(u))] == label


def test_feedback_leaves_what_hides_a_person_to_the_background():
    u = round(float(CAMERA.project((-2.5 + 1.2 * 1.9, 6.0, 0.9))[0]))
    tracker, _, _ = run(_walker, 2.0, hidden=slice(u - 1, u + 2))
    feedback = tracker.feedback()
    assert (feedback == WALKER).any() and not np.isin(feedback[:, u - 1 : u + 2], (PERSON, WALKER)).any()


def test_reset_gives_the_same_tracks_again():
    tracker, states, _ = run(_walker, 2.0)
    tracker.reset()
    world = World()
    again = [tracker.update(world.observe(k, _walker(k / FPS))) for k in range(20)]
    assert again == states


def test_images_of_another_size_are_refused():
    small, mask = np.zeros((60, 80), np.uint8), np.zeros((120, 160), np.uint8)
    for view in (View.of_mask(small, small), View.of_mask(mask, mask, small)):
        with pytest.raises(InputError, match="80x60"):
            HumanModelTracker(PARAMS, CAMERA, MAP).update(Observation(0, 0.0, (view,)))


def test_observation_without_foreground_is_refused():
    with pytest.raises(ValueError, match="foreground"):
        HumanModelTracker(PARAMS, CAMERA, MAP).update(Observation(0, 0.0))


def test_map_of_another_camera_is_refused():
    with pytest.raises(InputError, match="human model map"):
        HumanModelTracker(PARAMS, replace(CAMERA, height_m=5.0), MAP)


def test_grey_video_is_tracked_without_colours():
    tracker, world = HumanModelTracker(PARAMS, CAMERA, MAP), World()
    for k in range(20):
        seen = world.observe(k, _walker(k / FPS))
        (view,) = seen.views
        states = tracker.update(replace(seen, views=(replace(view, image=view.image[:, :, 2].copy()),)))
    assert len(confirmed(states)) == 1


COLOURLESS = PARAMS.model_copy(update={"colour_weight": 0.0})
RAYS = PixelRays.of(CAMERA)
TALL = np.array([body.HEIGHT_MEAN_M, body.HEIGHT_STD_M])
NOBODY = np.zeros(0, np.int64)
SAME = np.ones((PARTS, 200), np.float32)
POSE_PRIOR = loose_prior(0.5, 0.13)


def frame_of(*people: Drawn) -> MaskExplanation:
    return explained(World().observe(0, people).views[0])


def explained(seen: View, params: HumanModelParams = COLOURLESS) -> MaskExplanation:
    return MaskExplanation(RAYS, seen, likelihood_of_masks(params))


def people_at(*poses: tuple[float, float, float]) -> People:
    n = len(poses)
    at = np.array([upright_pose(pose) for pose in poses]).reshape(-1, 5)
    return People(at, np.ones(n), np.tile(TALL, (n, 1)), np.ones((n, PARTS, 200), np.float32))


def evidence(frame: MaskExplanation, pose: tuple[float, float, float], *others: tuple[float, float, float]) -> float:
    at, known = upright_pose(pose), people_at(*others, pose)
    samples = frame.samples_around(at, 0.5)
    samples.lay_others(known, np.arange(len(others)))
    return samples.log_ratio(at, TALL, SAME)


@pytest.mark.parametrize("pose", [(0.0, 6.0, 1.76), (0.3, 5.5, 1.6), (-0.2, 6.3, 1.3)])
@pytest.mark.parametrize("others", [[], [(0.4, 5.0, 1.8)], [(0.1, 6.6, 1.7), (-0.3, 5.2, 1.7)]])
def test_evidence_is_the_difference_of_two_plain_likelihoods(pose, others):
    seen = World().observe(0, [(0.0, 6.0, RED), (0.5, 5.2, BLUE)]).views[0]
    shadow = np.zeros_like(seen.foreground)
    shadow[60:70, 70:90] = 255
    every_pixel = COLOURLESS.model_copy(update={"patch_m": 0.0101})
    frame = explained(View.of_mask(seen.foreground, seen.motion, None, shadow), every_pixel)
    samples = frame.samples_around(upright_pose(pose), 0.5)
    assert samples.arrays.size[0] < 3000, "every pixel is a sample"
    samples.arrays.pixels["weight"] = 1.0
    samples.lay_others(people_at(*others, pose), np.arange(len(others)))
    found = samples.log_ratio(upright_pose(pose), TALL, SAME)
    without, both = (log_likelihood_of_mask(frame, people, others, TALL[0]) for people in (others, [*others, pose]))
    assert found == pytest.approx(both - without, rel=0.03, abs=0.5)


@pytest.mark.parametrize("lens", ["pinhole", "fisheye"])
def test_boxes_hold_what_the_camera_projects_of_bodies(lens):
    camera = replace(CAMERA, lens=lens, roll_rad=0.05)
    poses = np.array([(0.0, 6.0, 1.76), (-2.0, 3.0, 1.5), (1.0, 0.5, 1.9)])
    corners = np.array([(dx, dy, z) for dx in (-0.4, 0.4) for dy in (-0.4, 0.4) for z in (0.0, 1.0)])
    tops = corners * np.where([True, True, False], 1.0, poses[:, None, 2:] + 0.1)
    image = camera.project(poses[:, None] * (1.0, 1.0, 0.0) + tops)
    expected = np.nan_to_num(np.concatenate([image.min(axis=1), image.max(axis=1)], axis=1)).astype(np.int64)
    empty = View.of_mask(np.zeros((120, 160), np.uint8))
    found = MaskExplanation(PixelRays.of(camera), empty, likelihood_of_masks(COLOURLESS)).boxes(0, poses, 0.4)
    seen = np.isfinite(image).all(axis=(1, 2))
    assert seen.any() and found[seen].tolist() == expected[seen].tolist()
    assert all(box[0] < 0 and box[2] >= camera.width for box in found[~seen].tolist())


def test_person_is_likelier_where_it_stands_than_next_to_it():
    frame = frame_of((0.0, 6.0, RED))
    here = evidence(frame, (0.0, 6.0, 1.76))
    assert here > 20.0
    assert all(evidence(frame, (x, y, 1.76)) < here for x, y in ((0.3, 6.0), (-0.3, 6.0), (0.0, 7.0), (0.0, 5.2)))


def test_person_is_unlikely_where_nothing_is_foreground():
    assert evidence(frame_of(), (0.0, 6.0, 1.76)) < -10.0


def test_evidence_of_many_samples_of_one_weight_is_a_number():
    params = COLOURLESS.model_copy(update={"patch_m": 0.0101, "seen_on_background": 1e-9})
    frame = explained(World().observe(0, [(0.0, 6.0, RED)]).views[0], params)
    assert 300.0 < evidence(frame, (0.0, 6.0, 1.76)) < 600.0


def test_ascent_finds_the_person_from_a_walkers_error_of_prediction():
    frame, start = frame_of((0.0, 6.0, RED)), upright_pose((0.2, 6.3, 1.7))
    samples, pose = frame.samples_around(start, 0.5), start.copy()
    samples.lay_others(people_at((0.2, 6.3, 1.7)), NOBODY)
    _, curvature = samples.ascend(pose, start, POSE_PRIOR, TALL, SAME)
    assert pose[:2] == pytest.approx([0.0, 6.0], abs=0.15)
    noise, _ = samples.precision(pose, curvature)
    assert 0.0 < noise[0, 0] < noise[1, 1]


def test_two_side_by_side_are_explained_better_by_two():
    frame = frame_of((-0.35, 6.0, RED), (0.35, 6.0, BLUE))
    assert frame.weigh_pair(0, 1, people_at((-0.35, 6.0, 1.76), (0.35, 6.0, 1.76)))[0] > 8.0


def test_second_person_in_the_outline_of_one_explains_nothing():
    frame = frame_of((0.0, 6.0, RED))
    assert frame.weigh_pair(0, 1, people_at((0.0, 6.4, 1.7), (0.0, 5.9, 1.76)))[0] < 0.0


def test_owners_are_the_people_in_whose_outline_pixels_are():
    frame = frame_of((-0.8, 6.0, RED), (0.8, 6.0, BLUE))
    (owned,) = frame.assign_pixels(people_at((-0.8, 6.0, 1.76), (2.5, 6.0, 1.76)))
    columns = [round(float(CAMERA.project((x, 6.0, 1.1))[0])) for x in (-0.8, 0.8)]
    row = round(float(CAMERA.project((0.0, 6.0, 1.1))[1]))
    owner = dict(zip(frame.pixels.tolist(), owned.owner.tolist(), strict=True))
    assert [owner[row * CAMERA.width + c] for c in columns] == [0, -1] and 0 not in owner
    assert frame.residual(owned)[row, columns[1]] > 1.0


def test_one_is_born_at_a_place_whose_hull_gains_enough():
    frame, places = frame_of((-1.0, 6.0, RED), (1.0, 6.0, BLUE)), FloorPlaces(MAP, PARAMS.birth_visible, PARAMS.patch_m)
    known = people_at((-1.0, 6.0, 1.76))
    (owned,) = frame.assign_pixels(known)
    found, scores = places.scores(frame, known, owned, 4.0)
    residual = frame.residual(owned) + frame.residual(*frame.assign_pixels(known, BACKGROUND_SEEN))
    plain = np.array([
        sum(float(residual[top:down, left:right].sum()) for left, top, right, down in bands)
        for bands in places.bands
    ])  # fmt: skip
    assert len(found) and found.tolist() == np.flatnonzero(plain * places.scale >= 4.0).tolist()
    assert scores == pytest.approx(plain[found], rel=1e-3)
    born, poses = find_newcomers(places, frame, known, owned, 0.0, PARAMS)
    assert [b.at_m for b in born] == [pytest.approx((1.0, 6.0), abs=0.25)]
    assert poses.tolist() == [[-1.0, 6.0, 1.76, 0.0, 0.0]]


def test_silhouette_is_widest_at_the_arms():
    table = silhouette()
    level, above = table.cover[0, 6], table.cover[0, 24]
    wide = level.sum(axis=0)
    assert wide[44:60].mean() > 1.5 * wide[15:30].mean()
    assert ((table.cover >= 0.0) & (table.cover <= 1.0)).all()
    assert (above > 0.3).sum() < (level > 0.3).sum() / 2


def test_match_is_equation_1():
    surface = np.zeros((20, 30), np.uint8)
    surface[5:15, 5:15] = 255
    half = np.array([[5.0, 5.0], [9.0, 5.0], [9.0, 14.0], [5.0, 14.0]])
    (alone,) = match_hulls([half], surface)
    assert alone == ModelMatch(pytest.approx(0.5), pytest.approx(1.0), 0.0)
    both = match_hulls([half, half], surface)[0]
    assert both.overlap == pytest.approx(0.5) and both.score == pytest.approx(1.0)
    assert match_hulls([None], surface) == [ModelMatch()]


def test_one_more_person_gains_on_foreground_alone():
    frame = frame_of((0.0, 6.0, RED))
    shown, empty = (frame.owners(0, people_at(), np.flatnonzero(frame.kind == kind)) for kind in (1, 0))
    p = frame.likelihood.model[0]
    assert shown.lacking == pytest.approx(np.log(p["body"] / p["background"]), rel=1e-4)
    assert empty.lacking == pytest.approx(np.log((1.0 - p["body"]) / (1.0 - p["background"])), rel=1e-4)
