"""The engine: configuration, stages, feedback."""

import math
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel
from toy_rgbd import CAMERA

from calib.errors import InputError
from calib.ground_camera import GroundCamera
from calib.params import field_docs
from calib.pose import SE3
from calib.rig import Floor
from calib.types import F32
from planview.engine.config import Config, FeedbackParams, load_config
from planview.engine.gated import SAME_LEVELS, alike, solid
from planview.engine.info import ground_camera_info
from planview.engine.setup import Setup, refuse_foreign_disparity
from planview.engine.stereo import BODY_RADIUS_M, BodyBoxes, Feedback, stereo_engine
from planview.foreground.params import BACKGROUND, NO_FEEDBACK, PERSON
from planview.maps.builder import FloorPoints
from planview.trajectories.state import State, TrackState
from stereo.depth import RectifiedGeometry
from stereo.matcher import DisparityRange
from stereo.rgbd import RgbdRectifier


def test_no_file_and_no_override_give_the_defaults() -> None:
    assert load_config() == Config()


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    file.write_text("seed = 3\n[maps]\ncell_m = 0.05\n")
    expected = Config().model_copy(update={"seed": 3, "maps": Config().maps.model_copy(update={"cell_m": 0.05})})
    assert load_config(file) == expected


def test_an_override_beats_the_file(tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    file.write_text("[maps]\ncell_m = 0.05\n")
    assert load_config(file, ["maps.cell_m=0.04", "feedback.enabled=false"]).maps.cell_m == 0.04


def test_an_override_leaves_the_other_defaults_of_its_stage() -> None:
    found = load_config(None, ["single_camera.foreground.beta=9"]).single_camera.foreground
    assert found == Config().single_camera.foreground.model_copy(update={"beta": 9.0})
    assert found.remove_colour_shadows


@pytest.mark.parametrize(
    ("override", "meant"),
    [("maps.cel_m=0.03", "maps.cell_m"), ("cell_m=0.03", "maps.cell_m"), ("foregruond.beta=9", "foreground")],
)
def test_an_unknown_name_is_answered_with_the_one_it_resembles(override: str, meant: str) -> None:
    with pytest.raises(InputError, match=rf"did you mean {meant}\?"):
        load_config(None, [override])


@pytest.mark.parametrize(
    ("override", "named"),
    [
        ("foreground.learning_rat=0.1", "foreground.learning_rat"),
        ("no_such_stage.x=1", "no_such_stage"),
        ("maps.cell_m=-1", "maps.cell_m"),
        ("maps.cell_m=nan", "maps.cell_m"),
        ("maps.cell_m=wide", "maps.cell_m"),
        ("maps=3", "maps"),
        ("seed.deeper.x=1", "seed"),
        ("maps.cell_m", "maps.cell_m"),
        (".=1", ".=1"),
        ("=1", "=1"),
    ],
)
def test_unknown_names_and_bad_values_are_refused_by_name(override: str, named: str) -> None:
    with pytest.raises(InputError) as refused:
        load_config(None, [override])
    assert named in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_bad_value_in_a_file_names_the_file_and_the_key(tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    file.write_text("[maps]\ncell_m = 99\n")
    with pytest.raises(InputError, match=r"c\.toml: maps\.cell_m: .*99"):
        load_config(file)


@pytest.mark.parametrize("content", [b"[maps", b"\xff\xfe", b"x = " + b"[" * 5000])
def test_a_file_that_is_not_toml_is_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "c.toml"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"c\.toml: expected a TOML configuration"):
        load_config(file)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml"):
        load_config(tmp_path / "none.toml")


def test_the_effective_configuration_survives_json() -> None:
    config = load_config(None, ["maps.cell_m=0.04"])
    assert Config.model_validate_json(config.model_dump_json()) == config


@given(st.text(max_size=40))
def test_any_override_is_taken_or_refused_in_one_sentence(override: str) -> None:
    told = ""
    try:
        load_config(None, [override])
    except InputError as error:
        told = str(error)
    assert len(told) < 400


def parameters_of(table: BaseModel, name: str) -> Iterator[tuple[str, str | None]]:
    meanings = field_docs(type(table))
    for key in type(table).model_fields:
        value = getattr(table, key)
        if isinstance(value, BaseModel):
            yield from parameters_of(value, f"{name}.{key}")
        else:
            yield f"{name}.{key}", meanings.get(key)


def test_every_parameter_says_what_it_means() -> None:
    described = dict(parameters_of(Config(), "config"))
    assert len(described) > 50
    assert [name for name, text in described.items() if not text] == []


SHAPE, SEARCHED = (48, 64), DisparityRange(0, 64)


@pytest.fixture
def disparity() -> F32:
    """Rows from 8 to 40 px, the upper quarter unknown."""
    rows = np.linspace(8, 40, SHAPE[0], dtype=np.float32)[:, None] * np.ones((1, SHAPE[1]), dtype=np.float32)
    rows[:12] = np.nan
    return rows


def test_disparity_in_pixels_passes_unchanged(disparity: F32) -> None:
    given = disparity.copy()
    refuse_foreign_disparity(given, SHAPE, SEARCHED)
    np.testing.assert_array_equal(given, disparity)


def test_sixteenths_of_a_pixel_are_told(disparity: F32) -> None:
    with pytest.raises(InputError, match="sixteenths"):
        refuse_foreign_disparity(disparity * 16, SHAPE, SEARCHED)


def test_depth_in_millimetres_is_told(disparity: F32) -> None:
    with pytest.raises(InputError, match="or depth"):
        refuse_foreign_disparity(np.float32(54_000) / disparity, SHAPE, SEARCHED)


@pytest.mark.parametrize("none", [0.0, -1.0])
def test_number_that_stands_for_none_is_told(disparity: F32, none: float) -> None:
    with pytest.raises(InputError, match="expected NaN"):
        refuse_foreign_disparity(np.nan_to_num(disparity, nan=none), SHAPE, SEARCHED)


def test_other_shape_or_kind_of_number_is_told(disparity: F32) -> None:
    for other in (disparity[1:], disparity.astype(np.float64)):
        with pytest.raises(InputError, match="expected float32"):
            refuse_foreign_disparity(other, SHAPE, SEARCHED)


def test_view_with_the_horizon_in_the_image_reaches_far_in_its_directions() -> None:
    camera = GroundCamera(640, 480, 500.0, 3.0, math.radians(80))
    outline = np.array(ground_camera_info(camera).view_m)
    far = outline[np.hypot(*outline.T) > 40]
    half_angle = np.degrees(np.arctan2(far[:, 0], far[:, 1]))
    assert (half_angle.min(), half_angle.max()) == pytest.approx((-32.6, 32.6), abs=3)
    assert np.hypot(*outline.T).max() == pytest.approx(1.7 * 500 / 20)


def test_view_straight_down_is_the_image_on_the_floor() -> None:
    camera = GroundCamera(641, 481, 500.0, 3.0, 0.0)
    outline = np.array(ground_camera_info(camera).view_m)
    assert np.abs(outline).max(axis=0) == pytest.approx([3 * 320 / 500, 3 * 240 / 500])


def test_a_floor_that_the_camera_does_not_see_is_refused_by_name() -> None:
    rectifier = RgbdRectifier(CAMERA, "structured-light")
    upwards = Floor(SE3(np.eye(3), np.array([0.0, 0.0, 3.0])))
    setup = Setup(rectifier, upwards, rectifier.disparities(), "world.toml", "calib.json", "structured-light")
    with pytest.raises(InputError, match=r"hall \(floor: world.toml\): expected a camera that sees"):
        stereo_engine(cast(Any, SimpleNamespace(path="hall")), Config(), setup=setup)


GEOMETRY = RectifiedGeometry(320, 240, 100.0, 100.0, 160.0, 120.0, 0.1)
LEVEL = SE3(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.array([0.0, 0.0, 1.0]))
"""A camera 1 m above the floor that looks along y."""
DOWN = SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 3.0]))
"""A camera 3 m above the floor that looks straight down."""


def box(world_SE3_left: SE3, x_m: float, y_m: float, height_m: float) -> tuple[float, float, float, float]:
    track = TrackState(1, "confirmed", x_m, y_m, 0.0, 0.0, height_m)
    return BodyBoxes(GEOMETRY, world_SE3_left)(track).box_px


def test_box_of_a_person_ahead_spans_head_to_feet_of_the_near_side() -> None:
    r, near = BODY_RADIUS_M, 4.25 - BODY_RADIUS_M  # 4 m: 25 px per metre
    assert near == 4.0
    assert box(LEVEL, 0.0, 4.25, 2.0) == pytest.approx((160 - 25 * r, 120 - 25, 50 * r, 50))


def test_box_of_a_person_below_is_as_large_as_the_top_of_the_head() -> None:
    # The top is 1 m below the camera: 100 px per metre.
    assert box(DOWN, 0.0, 0.0, 2.0) == pytest.approx((160 - 25, 120 - 25, 50, 50))


def test_box_is_clipped_to_the_outer_edges_of_the_image() -> None:
    left, top, width, height = box(DOWN, 0.0, 0.0, 2.9)
    assert (left, top, width, height) == pytest.approx((-0.5, -0.5, 320, 240))


@pytest.mark.parametrize(("x_m", "y_m"), [(0.0, -5.0), (40.0, 5.0)])
def test_somebody_out_of_view_has_no_box(x_m: float, y_m: float) -> None:
    assert all(math.isnan(side) for side in box(LEVEL, x_m, y_m, 1.8))


def test_unknown_height_or_place_gives_no_box() -> None:
    for track in (TrackState(1, "lost"), TrackState(1, "confirmed", 0.0, 4.0)):
        assert BodyBoxes(GEOMETRY, LEVEL)(track) is track


def test_fleck_that_fills_less_than_half_of_a_head_is_no_change() -> None:
    mask = np.zeros((40, 40), np.uint8)
    mask[10:14, 10:14] = 255
    assert not solid(mask, 7).any()


def test_disc_as_wide_as_a_head_keeps_its_middle() -> None:
    mask = np.zeros((40, 40), np.uint8)
    cv2.circle(mask, (20, 20), 3, 255, -1)
    assert solid(mask, 7)[20, 20] == 255


@pytest.mark.parametrize("seed", range(3))
def test_smallest_square_is_the_median_of_nine(seed: int) -> None:
    mask = np.where(np.random.default_rng(seed).random((30, 50)) < 0.5, 255, 0).astype(np.uint8)
    assert np.array_equal(solid(mask, 3), cv2.medianBlur(mask, 3))


@pytest.mark.parametrize("channels", [(), (3,)])
def test_images_are_alike_up_to_the_level_in_every_channel(channels: tuple[int, ...]) -> None:
    image, other = np.full((1, 4, *channels), 50, np.uint8), np.full((1, 4, *channels), 50, np.uint8)
    other[0, 1], other[0, 2] = 50 + SAME_LEVELS, 50 - SAME_LEVELS
    other[0, 3, ..., None][-1] = 50 + SAME_LEVELS + 1
    assert alike(image, other).tolist() == [[255, 255, 255, 0]]


BELIEF_SHAPE = (1, 40)


def point(x_m: float, z_m: float, pixel: int) -> FloorPoints:
    xyz = np.array([[x_m, 0.0, z_m]], dtype=np.float32)
    return FloorPoints(xyz, np.ones(1, dtype=np.float32), np.array([pixel], dtype=np.int32))


def person(x_m: float, state: State = "confirmed", track_id: int = 1) -> TrackState:
    return TrackState(track_id, state, x_m, 0.0, 0.0, 0.0, 1.7)


def mask_after(feedback: Feedback, points: FloorPoints, *tracks: TrackState) -> list[int]:
    mask = feedback(points, tracks, BELIEF_SHAPE)
    assert mask is not None
    return [int(v) for v in mask[0]]


def walked(spread_px: int = 2) -> Feedback:
    feedback = Feedback(FeedbackParams(spread_px=spread_px))
    mask_after(feedback, point(0.0, 1.0, 20), person(0.0))
    return feedback


def test_body_of_a_track_that_has_walked_is_protected_and_widened():
    mask = mask_after(walked(), point(1.0, 1.0, 20), person(1.0))
    assert mask[18:23] == [PERSON] * 5
    assert mask.count(PERSON) == 5
    assert mask.count(NO_FEEDBACK) == 35


@pytest.mark.parametrize(
    ("where", "who", "expected"),
    [
        (point(0.2, 1.0, 20), person(0.2), {NO_FEEDBACK}),
        (point(1.0, 1.0, 20), person(1.0, "lost"), {NO_FEEDBACK}),
        (point(3.0, 1.0, 20), person(1.0), {NO_FEEDBACK}),
        (point(3.0, 0.05, 20), person(1.0), {NO_FEEDBACK, BACKGROUND}),
        (point(1.0, 0.05, 20), person(1.0), {NO_FEEDBACK, PERSON}),
    ],
    ids=["has not moved", "lost", "high, away from people", "low, away from people", "feet of a person"],
)
def test_foreground_is_a_persons_the_floors_or_left_to_the_model(where, who, expected):
    mask = mask_after(walked(), where, who)
    assert set(mask) == expected
    assert mask[20] == max(expected, key=lambda label: label != NO_FEEDBACK)
    assert mask.count(BACKGROUND) == (BACKGROUND in expected)


def test_track_that_comes_back_under_its_id_must_walk_again():
    feedback = walked()
    mask_after(feedback, point(1.0, 1.0, 20), person(1.0))
    mask_after(feedback, point(1.0, 1.0, 20))
    assert PERSON not in mask_after(feedback, point(1.0, 1.0, 20), person(1.0))


def test_reset_forgets_which_tracks_have_walked():
    feedback = walked()
    mask_after(feedback, point(1.0, 1.0, 20), person(1.0))
    feedback.reset()
    assert PERSON not in mask_after(feedback, point(1.0, 1.0, 20), person(1.0))


def test_ground_is_what_no_person_is_near_of_several():
    xyz = np.array([[1.0, 0.0, 0.05], [2.5, 0.0, 0.05], [4.0, 0.0, 0.05], [4.0, 0.0, 1.0]], dtype=np.float32)
    points = FloorPoints(xyz, np.ones(4, dtype=np.float32), np.array([5, 15, 25, 35], dtype=np.int32))
    feedback = Feedback(FeedbackParams(spread_px=0))
    mask_after(feedback, points, person(0.0), person(4.0, track_id=2))
    mask = mask_after(feedback, points, person(1.0), person(4.0, track_id=2))
    assert [mask[i] for i in (5, 15, 25, 35)] == [PERSON, BACKGROUND, NO_FEEDBACK, NO_FEEDBACK]


def test_feedback_that_is_off_gives_no_mask():
    assert Feedback(FeedbackParams(enabled=False))(point(0, 1, 2), [], BELIEF_SHAPE) is None
