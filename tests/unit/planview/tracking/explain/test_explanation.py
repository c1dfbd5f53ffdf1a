"""How well people explain the pixels of a frame, and where newcomers are looked for."""

import numpy as np
import pytest
from reference.explain import log_likelihood, patches_of
from toy_people import look_at, oblique_camera, towards

from planview.maps.view import SURFACE, UNKNOWN, View
from planview.tracking import body
from planview.tracking.explain.births import Births
from planview.tracking.explain.explanation import Explanation, People, Samples, loose_prior, upright_pose
from planview.tracking.explain.samples import EX, EY, LAYERS, PARTS, THROUGH, SampleArrays
from planview.tracking.joint.ranges import JointParams, likelihood_of_ranges

PARAMS = JointParams()
ADULT = (0.0, 3.0, 1.75)
TALL = np.array([1.75, 0.12])
SAME = np.ones((PARTS, 200), np.float32)


def people_of(*poses: tuple[float, ...]) -> People:
    n = len(poses)
    ratios = np.ones((n, PARTS, 200), np.float32)
    return People(
        np.array([upright_pose(pose) for pose in poses]).reshape(-1, 5), np.ones(n), np.tile(TALL, (n, 1)), ratios
    )


def plain(samples: SampleArrays) -> None:
    """Take every pixel for one patch, and the nearest table for each."""
    n = int(samples.size[0])
    samples.pixels["weight"][:n], samples.pixels["slant"][:n] = 1.0, 0.5
    samples.pixels["turn"][:n] = np.arctan2(samples.rays[EY, :n], samples.rays[EX, :n]) * body.FACINGS_PER_RAD - 0.5


def explained(seen: View) -> Explanation:
    return Explanation((seen,), likelihood_of_ranges(PARAMS))


def around(frame: Explanation, pose: np.ndarray, others: People | None = None) -> Samples:
    """The samples around somebody with others on their rays."""
    people = others or people_of()
    samples = frame.samples_around(pose, 0.3)
    samples.lay_others(people, np.arange(len(people.poses)))
    return samples


@pytest.mark.parametrize("other", [(0.3, 3.8, 1.6), (0.1, 5.4, 1.8)], ids=["in front", "behind"])
@pytest.mark.parametrize("unknown_rows", [0, 50])
def test_evidence_of_a_person_is_the_difference_of_two_likelihoods(other, unknown_rows):
    far = (0.0, 4.6, 1.75)
    seen = look_at(oblique_camera(), [far, other])
    seen.kind[:unknown_rows] = UNKNOWN
    every_pixel = JointParams(patch_m=0.011)
    dense = Explanation((seen,), likelihood_of_ranges(every_pixel)).samples_around(upright_pose(far), 0.4)
    plain(dense.arrays)
    dense.lay_others(people_of(far, other), np.array([1]))
    found = dense.log_ratio(upright_pose(far), TALL, SAME)
    # Arms reach as far in both: what lies near one of the two lies near the other.
    without, both = (log_likelihood(seen, people, PARAMS, [other]) for people in ([other], [other, far]))
    assert found == pytest.approx(both - without, rel=0.03)


def test_pixels_of_surface_lack_an_explanation_where_nobody_owns_them():
    seen = look_at(oblique_camera(), [ADULT])
    (owned,), (alone,) = explained(seen).assign_pixels(people_of(ADULT)), explained(seen).assign_pixels(people_of())
    patches = patches_of(seen, seen.rays.pixel_sr / PARAMS.patch_m**2)
    np.testing.assert_array_equal(owned.pixels, np.flatnonzero(seen.kind == SURFACE))
    np.testing.assert_allclose(owned.patches, patches, rtol=1e-4)
    assert (owned.owner == 0).mean() > 0.95 and (owned.share > 0.8).mean() > 0.9
    per_patch = [float(o.lacking.sum() / patches.sum()) for o in (owned, alone)]
    assert abs(per_patch[0]) < 0.5 and per_patch[1] > 3.0


def test_pixels_that_show_nothing_are_no_evidence():
    seen = look_at(oblique_camera(), [ADULT])
    shares, evidence = [], []
    for hidden in (slice(0), np.s_[:, :80], np.s_[:]):
        seen.kind[hidden] = UNKNOWN
        samples = around(explained(seen), upright_pose(ADULT))
        mine, known, total = samples.visible_patches(upright_pose(ADULT), TALL, SAME).tolist()
        shares.append((mine / max(known, 1e-9), known / total))
        evidence.append(samples.log_ratio(upright_pose(ADULT), TALL, SAME))
    assert shares[0] == pytest.approx((shares[1][0], 1.0), abs=0.03) and 0.4 < shares[1][1] < 0.6
    assert shares[2] == (0.0, 0.0) and evidence[2] == 0.0 and evidence[0] > evidence[1] > 5.0


def test_of_five_people_on_a_ray_the_four_nearest_count_in_any_order():
    row = [(0.0, 2.0 + 0.9 * k, 1.7) for k in range(6)]
    frame = explained(look_at(oblique_camera(height_m=1.6, tilt_deg=88.0), row[:1]))
    found = []
    for order in ([1, 2, 3, 4, 5], [5, 4, 3, 2, 1]):
        samples = frame.samples_around(upright_pose(row[0]), 0.3)
        samples.lay_others(people_of(*row), np.array(order))
        n = samples.arrays.size[0]
        assert samples.arrays.counts[:n].max() == LAYERS
        past = np.arange(LAYERS + 1) > samples.arrays.counts[:n, None]
        found.append(np.where(past, 0.0, samples.arrays.layers[:n, THROUGH]))
        owned = frame.assign_pixels(people_of(*[row[k] for k in (0, *order)]))[0]
        found.append((owned.owner == 0).mean())
    np.testing.assert_allclose(found[0], found[2])
    assert found[1] == found[3] > 0.9


def test_a_person_where_the_background_is_seen_is_unlikely():
    samples = around(explained(look_at(oblique_camera(), [])), upright_pose(ADULT))
    assert samples.log_ratio(upright_pose(ADULT), TALL, SAME) < -50


def test_a_hidden_person_costs_nothing():
    front = (0.0, 2.4, 1.85)
    frame = explained(look_at(oblique_camera(tilt_deg=85.0), [front]))
    behind = upright_pose((0.0, 3.1, 1.5))
    assert around(frame, behind, people_of(front)).log_ratio(behind, TALL, SAME) > -3


def test_ascent_finds_a_person_from_a_walkers_error_of_prediction():
    frame = explained(look_at(oblique_camera(), [(*ADULT, np.pi / 2)]))
    start = upright_pose((0.15, 2.85, 1.62))
    around(frame, start).ascend(start, start.copy(), loose_prior(1.0, 1.0), TALL, SAME)
    assert start[:3] == pytest.approx(ADULT, abs=0.05)


@pytest.mark.parametrize(("height_m", "shape"), [(1.75, "body"), (1.15, "body"), (1.05, "box")])
def test_a_body_is_explained_better_by_a_body_than_by_a_box(height_m, shape):
    table = body.thing_tables()[1] if shape == "box" else None
    pose = upright_pose((0.0, 3.0, height_m))
    samples = around(explained(look_at(oblique_camera(), [(*pose[:3], np.pi / 2)], table=table)), pose)
    samples.ascend(pose, pose.copy(), loose_prior(1.0, 1.0), TALL, SAME)
    ratio = samples.against_things(pose, TALL).min()
    assert ratio > 0 if shape == "body" else ratio < -5


def test_bodies_do_not_stand_in_each_other():
    frame, pose = explained(look_at(oblique_camera(), [])), upright_pose(ADULT)
    priors = [around(frame, pose, people_of((0.0, y, 1.7))).log_prior(pose, TALL) for y in (3.5, 3.1)]
    assert priors[0] == pytest.approx(0.0, abs=0.01) and priors[1] < -8


def test_height_shows_where_the_head_would_be_in_view():
    frame = explained(look_at(oblique_camera(height_m=1.0, tilt_deg=75.0), []))
    near, far = upright_pose((0.0, 1.2, 0.8)), upright_pose((0.0, 6.0, 0.8))
    assert frame.in_view(near) and not frame.shows_height(near, 1.7, 0.12)  # the head of 1.7 m would be above the view
    assert frame.shows_height(near, 0.85, 0.12)  # of somebody known to sit
    assert frame.shows_height(far, 1.7, 0.12)


STEEP = oblique_camera(height_m=3.5, tilt_deg=10.0)
ABOVE = (0.0, 0.6, 1.75)


@pytest.mark.parametrize("facing_deg", [0.0, 45.0, 90.0, 135.0])
@pytest.mark.parametrize("lean", [0.0, 0.2])
def test_a_search_finds_which_way_a_body_faces(facing_deg, lean):
    facing = np.deg2rad(facing_deg)
    pose = upright_pose(ABOVE)
    samples = around(explained(look_at(STEEP, [(*ABOVE, facing, lean)])), pose)
    samples.ascend(pose, pose.copy(), loose_prior(0.2, 0.5), TALL, SAME)
    turns = 1 if lean else 2  # upright, front and back look the same
    off = turns * (pose[3] - facing)
    assert np.rad2deg(abs(np.arctan2(np.sin(off), np.cos(off)))) / turns < 25.0
    head = np.array(ABOVE[:2]) + lean * np.array([np.cos(facing), np.sin(facing)])
    assert pose[:2] + pose[4] * np.array([np.cos(pose[3]), np.sin(pose[3])]) == pytest.approx(head, abs=0.05)


def test_points_of_a_surface_are_fresh_until_they_are_tried():
    seen = look_at(oblique_camera(), [ADULT])
    frame, births = explained(seen), Births(PARAMS)
    (owned,) = frame.assign_pixels(people_of())
    births.prepare([seen])
    points, _, pixels = births._fresh_points(frame, [owned])
    np.testing.assert_array_equal(pixels, owned.pixels)
    plain_points = seen.rays.centre_m + (seen.range_m[..., None] * towards(seen.rays)).reshape(-1, 3)[owned.pixels]
    np.testing.assert_allclose(points[:3].T, plain_points, atol=1e-4)
    np.testing.assert_array_equal(points[3:], [owned.lacking, owned.colours])
    births._tried_m[0][:] = seen.range_m
    births._tried_m[0].reshape(-1)[owned.pixels[0]] -= 5.0
    assert births._fresh_points(frame, [owned]).pixels.tolist() == [owned.pixels[0]]
