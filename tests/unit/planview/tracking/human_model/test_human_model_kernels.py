"""Compiled kernels of the human-model tracker against their plain numpy twins."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.ground_camera import GroundCamera
from planview.foreground.blobs import find_blobs
from planview.tracking.human_model import _candidate_kernels as candidates
from planview.tracking.human_model import _extent_kernels as extents
from planview.tracking.human_model import _kernels as kernels
from planview.tracking.human_model import _measure_kernels as measuring
from planview.tracking.human_model import _unclaimed_kernels as unclaimed
from planview.tracking.human_model.fitting import foot_pixels
from planview.tracking.human_model.frame import ModelFrame
from planview.tracking.human_model.image_size import ImageSizes, upright
from planview.tracking.human_model.model_map import HumanModelMapParams, build_model_map
from planview.tracking.human_model.params import HumanMatchParams
from planview.tracking.human_model.scene import ModelScene
from tests.reference import human_model as reference

CAMERA = GroundCamera(96, 72, 70.0, 3.5, math.radians(62))
MAP = build_model_map(CAMERA, params=HumanModelMapParams(step_px=4, min_height_px=8))
RING = 0.5
feet = st.tuples(st.floats(-20, 116), st.floats(10, 110), st.floats(0.7, 1.2))


def _scene() -> ModelScene:
    return ModelScene(MAP, HumanMatchParams(ring=RING))


def _spans() -> kernels.Spans:
    return kernels.Spans.of(72)


def _map_arrays() -> kernels.MapArrays:
    nodes = np.ascontiguousarray(MAP.index), *MAP.origin_px, MAP.params.step_px
    outlines = np.ascontiguousarray(MAP.foot_px), np.ascontiguousarray(MAP.hull_px)
    return kernels.MapArrays(*nodes, *outlines, upright(MAP), ImageSizes(MAP).nearer)


def _noise(seed: int, high: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, high, (72, 96), dtype=np.uint8)


@settings(max_examples=60, deadline=None)
@given(feet)
def test_painted_model_is_the_polygon(foot: tuple[float, float, float]) -> None:
    image = np.zeros((72, 96), np.uint8)
    _scene().paint(image, np.array(foot[:2]), foot[2], 1)
    np.testing.assert_array_equal(image > 0, reference.model_mask(MAP, *foot))


@settings(max_examples=40, deadline=None)
@given(feet, st.integers(0, 99))
def test_candidate_counts_equal_masks(foot: tuple[float, float, float], seed: int) -> None:
    evidence, cover, hiding = _noise(seed, 3), _noise(seed + 1, 2), _noise(seed + 2, 2)
    sums = np.zeros((72, 97), np.int64)
    kernels.row_prefix(evidence, cover, hiding, kernels.Window(0, 96, 0, 72), sums)
    mask = reference.model_mask(MAP, *foot)
    found = np.zeros((6, 1), np.int64)
    kernels.score_candidates(sums, _spans(), _map_arrays(), np.array([foot]), RING, *found)
    rows = reference.model_rows(MAP, *foot), reference.first_row_of_legs(MAP, *foot)
    assert tuple(found[:, 0]) == reference.counts(mask, *rows, evidence, cover, hiding, RING)


@settings(max_examples=25, deadline=None)
@given(st.lists(feet, min_size=1, max_size=3), st.integers(0, 99))
def test_measurement_equals_masks(models: list[tuple[float, float, float]], seed: int) -> None:
    evidence, motion = _noise(seed, 3), _noise(seed + 1, 2)
    scene, at = _scene(), np.array(models)
    scene.clear()
    scene.hiding[:] = _noise(seed + 2, 2)
    for u, v, scale in models:
        scene.paint(scene.cover, np.array([u, v]), scale, 1)
    evidence *= (np.arange(96) % 5 > 0).astype(np.uint8)
    blobs = find_blobs(evidence)
    found = scene.measure(ModelFrame(0.0, None, evidence, motion, blobs), at[:, :2], at[:, 2]).counts
    masks = [reference.model_mask(MAP, *m) for m in models]
    for i, mask in enumerate(masks):
        counted = tuple(
            c[i] for c in (found.area, found.evidence, found.alone, found.shared, found.hidden, found.moving)
        )
        assert counted == reference.measured(mask, evidence, motion, scene.cover, scene.hiding)
        rows = reference.model_rows(MAP, *models[i])
        breadth = found.breadth_px2[i], found.breadth_n[i]
        assert breadth == reference.breadth(mask, rows, evidence, scene.cover, RING)
        votes = np.bincount(blobs.labels[mask & (evidence > 0)], minlength=1)
        assert votes[found.blob[i]] == votes[votes.argmax()]
    wide = [reference.with_ring(k, reference.model_rows(MAP, *m), RING / 2) for k, m in zip(masks, models, strict=True)]
    claimed = np.any(wide, axis=0)
    np.testing.assert_array_equal(scene.claimed > 0, claimed)


def test_still_times_grow_away_from_claimed_blobs() -> None:
    evidence, motion, claimed = _noise(1, 3), _noise(2, 2), (_noise(3, 40) == 0).astype(np.uint8)
    blobs = find_blobs(evidence * (np.arange(96) % 6 > 0).astype(np.uint8))
    before = np.random.default_rng(4).random((72, 96), dtype=np.float32)
    images = measuring.Images(evidence, motion, claimed, blobs.labels, claimed)
    times = before.copy()
    measuring.watch_still(images, claimed, np.zeros(len(blobs), np.bool_), 0.1, times)
    np.testing.assert_array_equal(times, reference.still_times(evidence, motion, claimed, blobs.labels, 0.1, before))


def test_scene_hides_where_a_model_rarely_shows_foreground() -> None:
    evidence, cover, foot = _noise(1, 2), _noise(2, 3), (48.0, 50.0, 1.0)
    mask, spans = reference.model_mask(MAP, *foot), _spans()
    top, bottom, _ = kernels.fill_spans(_map_arrays(), *foot, 96, spans)
    expected_s, shown_s = np.zeros((2, 72, 96), np.float32)
    limits, hiding = measuring.HidingLimits(0.5, 0.15, 10.0), np.zeros((72, 96), np.uint8)
    measuring.learn_hiding(evidence, cover, spans, top, bottom, 0.5, limits, expected_s, shown_s, hiding)
    zero = np.zeros((72, 96), np.float32)
    times = reference.hiding_times(mask, evidence, cover, 0.5, zero, zero)
    np.testing.assert_array_equal((expected_s, shown_s), times)
    np.testing.assert_array_equal(hiding > 0, mask & (cover == 1) & (evidence == 0))


def test_what_was_hidden_long_ago_counts_less() -> None:
    evidence, cover, hiding = np.ones((3, 72, 96), np.uint8)
    foot, spans = (48.0, 50.0, 1.0), _spans()
    top, bottom, _ = kernels.fill_spans(_map_arrays(), *foot, 96, spans)
    expected_s, shown_s = np.full((72, 96), 10.0, np.float32), np.full((72, 96), 2.0, np.float32)
    limits, mask = measuring.HidingLimits(0.5, 0.15, 10.0), reference.model_mask(MAP, *foot)
    measuring.learn_hiding(evidence, cover, spans, top, bottom, 0.5, limits, expected_s, shown_s, hiding)
    np.testing.assert_array_equal(expected_s, np.where(mask, np.float32(10.0 * 0.95 + 0.5), np.float32(10.0)))
    np.testing.assert_allclose(shown_s, np.where(mask, 2.0 * 0.95 + 0.5, 2.0), rtol=1e-6)
    np.testing.assert_array_equal(hiding == 0, mask)


def test_distance_in_the_open_is_that_of_the_farthest_person_observed() -> None:
    evidence, cover, foot = _noise(1, 2), _noise(2, 3), (48.0, 50.0, 1.0)
    mask, spans = reference.model_mask(MAP, *foot), _spans()
    top, bottom, _ = kernels.fill_spans(_map_arrays(), *foot, 96, spans)
    before = _noise(3, 8).astype(np.float32)
    open_m = before.copy()
    measuring.learn_open(evidence, cover, spans, top, bottom, 4.5, open_m)
    np.testing.assert_array_equal(open_m, reference.open_distances(mask, evidence, cover, 4.5, before))


def test_unclaimed_foreground_that_stays_and_moves_agrees_with_the_twin() -> None:
    evidence, motion = _noise(1, 3), _noise(2, 2)
    labels, times = find_blobs(evidence).labels, 0.5 * _noise(3, 5).astype(np.float32)
    moved_s = _noise(4, 9).astype(np.float32)
    n, limits = labels.max() + 1, unclaimed.Limits(stay_s=2.0, rest_s=1.0, recent_s=3.0)
    expected = reference.unclaimed_times(evidence, motion, labels, 0.1, 9.0, (2.0, 1.0, 3.0), times, moved_s)
    area, moved = np.zeros((2, n), np.int64)
    unclaimed.watch_unclaimed(evidence, motion, labels, 0.1, 9.0, limits, times, moved_s, area, moved)
    for found, wanted in zip((times, moved_s, area, moved), expected, strict=True):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("people", [False, True])
def test_what_is_known_of_pixels_agrees_with_the_twin(people: bool) -> None:
    evidence, claimed, still_s = _noise(1, 3), _noise(2, 2), _noise(3, 5).astype(np.float32)
    labels = find_blobs(_noise(4, 8) // 7).labels
    lively = np.arange(labels.max() + 1) % 2 == 1
    known = np.full((72, 96), 9, np.uint8)
    unclaimed.mark_known(still_s, 3.0, labels, lively, claimed, evidence, people, known)
    expected = reference.known(still_s, 3.0, labels, lively, claimed, evidence, people)
    np.testing.assert_array_equal(known, expected)


def test_models_that_a_blob_may_be_agree_with_the_twin() -> None:
    scene, blob = _scene(), np.array([30.0, 10.0, 30.0, 50.0])
    fits = np.ones(len(MAP), np.bool_)
    limits = candidates.BoxLimits(0.5, 0.3, 15.0)
    candidates.boxes_over(scene.map_boxes, scene.map_inside, blob, 200.0, limits, fits)
    expected = reference.boxes_over(scene.map_boxes, scene.map_inside, blob, 200.0, (0.5, 0.3), 15.0)
    np.testing.assert_array_equal(fits, expected)
    assert 0 < fits.sum() < len(fits)


def test_colours_equal_a_histogram_of_the_mask() -> None:
    scene, foot = _scene(), (48.0, 50.0, 1.0)
    image = np.random.default_rng(1).integers(0, 256, (72, 96, 3), dtype=np.uint8)
    evidence = _noise(2, 3)
    scene.clear()
    scene.paint(scene.cover, np.array(foot[:2]), 1.0, 1)
    # Two parts of the body, six levels per channel, evenly spaced in the square root.
    level = np.minimum(5, np.sqrt(np.arange(256) / 256) * 6).astype(np.uint8)
    expected = reference.histogram(reference.model_mask(MAP, *foot), image, evidence, scene.cover, level, 6, 2)
    np.testing.assert_allclose(scene.colours(image, evidence, np.array(foot[:2]), 1.0), expected, atol=1e-6)


def test_floor_points_are_projected_as_by_the_camera() -> None:
    camera = GroundCamera(320, 240, 200.0, 3.0, math.radians(55), "normal", math.radians(4))
    xy = np.array([[0.5, 4.0], [-2.0, 9.0], [0.0, -30.0]])
    pixels, jacobian = foot_pixels(camera, xy)
    np.testing.assert_allclose(pixels, camera.project(np.column_stack([xy, np.zeros(3)])))
    assert np.isnan(pixels[2]).all()
    ahead = camera.project((0.5, 4.01, 0.0))
    np.testing.assert_allclose(jacobian[0, :, 1], (ahead - pixels[0]) / 0.01)


def test_line_of_a_model_reaches_its_outline() -> None:
    hull = np.array([[13, 30], [13, 52], [7, 52], [7, 30], [8, 8], [12, 8]], np.float32)
    foot, head = np.array([10, 50], np.float32), np.array([10, 10], np.float32)
    line = extents.line_of(foot, head, hull, 2.0, np.array([100.0, 90.0]))
    assert line.axis == pytest.approx((100.0, 90.0, 0.0, -80.0, 6.0))
    # 2 px of 40 below the foot and above the head, at any scale.
    assert (line.length, line.low, line.high) == pytest.approx((80.0, -0.05, 1.05))


@pytest.mark.parametrize("along", [(3.0, -40.0), (-25.0, 31.0), (50.0, 2.0), (40.0, 0.5), (0.0, -90.0)])
def test_body_extent_counts_along_the_axis(along: tuple[float, float]) -> None:
    evidence, cover, bins = _noise(3, 3), _noise(4, 3), np.zeros(60, np.int64)
    extents.body_extent(evidence, cover, extents.Axis(48.3, 60.0, *along, 6.0), bins)
    expected = reference.along_axis(evidence, cover, np.array([48.3, 60.0]), np.array(along), 6.0, 60)
    np.testing.assert_array_equal(bins, expected)


def test_body_extent_ends_where_the_body_does() -> None:
    evidence = np.zeros((72, 96), np.uint8)
    evidence[20:61, 44:53] = 2
    axis = extents.Axis(48.0, 60.0, 0.0, -40.0, 6.0)
    low, high, head = extents.body_extent(evidence, np.zeros_like(evidence), axis, np.zeros(60, np.int64))
    assert low == pytest.approx(0.0, abs=0.04)
    assert high == head == pytest.approx(1.0, abs=0.04)


def test_body_in_two_pieces_ends_where_they_do() -> None:
    evidence = np.zeros((72, 96), np.uint8)
    evidence[20:28, 44:53] = evidence[45:61, 44:53] = 2  # a shirt like the wall
    axis = extents.Axis(48.0, 60.0, 0.0, -40.0, 6.0)
    low, high, _ = extents.body_extent(evidence, np.zeros_like(evidence), axis, np.zeros(60, np.int64))
    assert (low, high) == pytest.approx((0.0, 1.0), abs=0.04)


def test_head_ends_where_it_does_though_another_covers_the_middle_of_the_body() -> None:
    evidence, cover = np.zeros((72, 96), np.uint8), np.zeros((72, 96), np.uint8)
    evidence[26:61, 44:53] = 2  # the body is 34 px of 40 long
    cover[36:61] = 2
    axis = extents.Axis(48.0, 60.0, 0.0, -40.0, 6.0)
    low, high, head = extents.body_extent(evidence, cover, axis, np.zeros(60, np.int64))
    assert (low, high) == (0.0, 0.0)
    assert head == pytest.approx(0.85, abs=0.04)


def test_covered_pixels_of_a_model_are_those_of_others_and_those_that_the_scene_hides() -> None:
    cover, hiding, spans = np.ones((10, 10), np.uint8), np.zeros((10, 10), np.uint8), kernels.Spans.of(10)
    spans.left[2:6], spans.right[2:6] = 3, 8
    cover[2, :5], hiding[5] = 2, 1
    assert measuring.count_covered(cover, hiding, spans, 2, 6) == (20, 2 + 5)


def test_matching_score_counts_free_foreground_twice_over_background() -> None:
    # 100 px: 60 free foreground (evidence 120), 10 taken, so 30 background; 8 foreground in the ring (evidence 16).
    assert kernels.matching_score(kernels.MatchCounts(100, 120, 10, 16, 0, 0), 100.0, 0.3) == pytest.approx(
        (60 + 4 - 30 - 3) / 100
    )


def test_matching_score_counts_what_the_scene_hides_as_neither() -> None:
    # As above, but 20 of the 30 pixels without foreground are hidden.
    assert kernels.matching_score(kernels.MatchCounts(100, 120, 10, 16, 20, 0), 100.0, 0.3) == pytest.approx(
        (60 + 4 - 10 - 3) / 100
    )


def test_matching_score_counts_background_below_the_waist_less() -> None:
    # As the first, but 20 of the 30 pixels of background are below the waist.
    assert kernels.matching_score(kernels.MatchCounts(100, 120, 10, 16, 0, 40), 100.0, 0.3) == pytest.approx(
        (60 + 4 - (10 + 0.8 * 20) - 3) / 100
    )


def test_match_finds_two_planted_people_together() -> None:
    scene = _scene()
    true = np.array([[40.0, 52.0], [50.0, 58.0]])
    evidence = np.zeros((72, 96), np.uint8)
    for foot in true:
        scene.paint(evidence, foot, 1.0, 1)
    evidence = 2 * (evidence > 0).astype(np.uint8)
    scene.clear()
    start = true + np.array([[3.0, -2.0], [-3.0, 2.0]])
    covariance = np.tile(16.0 * np.eye(2), (2, 1, 1))
    found = scene.match(evidence, start, np.ones(2), covariance, np.arange(2))
    assert np.abs(found - true).max() <= 1.5
    assert scene.cover.max() >= 1


def test_match_leaves_a_model_at_its_prediction_without_evidence() -> None:
    scene = _scene()
    scene.clear()
    at = np.array([[45.0, 55.0]])
    found = scene.match(np.zeros((72, 96), np.uint8), at, np.ones(1), 9.0 * np.eye(2)[None], np.arange(1))
    assert np.abs(found - at).max() <= 9.0
