"""The engine: configuration, stages, feedback."""

import math
from collections.abc import Generator
from pathlib import Path

import numpy as np
import pytest
from toy_rgbd import CAMERA

from calib.errors import InputError
from calib.ground_camera import GroundCamera
from calib.params import descriptions, tables_of
from calib.pose import SE3
from calib.types import F32
from planview.engine.config import Config, FeedbackParams, config_of, load_config
from planview.engine.feedback import Feedback
from planview.engine.info import camera_info
from planview.engine.setup import set_up
from planview.foreground.params import BACKGROUND, NO_FEEDBACK, PERSON
from planview.maps.plan_view import FloorPoints
from planview.maps.view import NO_RAYS, View
from planview.tracking.base import BODY_RADIUS_M, NO_BOX, Decision, person_boxes
from planview.trajectories.state import State, TrackState
from stereo.depth import RectifiedGeometry
from stereo.matcher import DisparityRange
from stereo.measure import refuse_foreign_disparity
from stereo.recording import Decoded, DepthCamera, FrameClock, Recording, Shot


@pytest.fixture
def file(tmp_path) -> Path:
    (tmp_path / "c.toml").write_text("seed = 3\n[maps]\ncell_m = 0.05\n")
    return tmp_path / "c.toml"


def test_a_file_changes_only_what_it_names(file):
    expected = Config().model_copy(update={"seed": 3, "maps": Config().maps.model_copy(update={"cell_m": 0.05})})
    assert load_config() == Config()
    assert load_config(file) == expected


def test_overrides_beat_a_file(file):
    config = load_config(file, ["maps.cell_m=0.04", "feedback.enabled=false", "single_camera.foreground.beta=9"])
    assert config.maps.cell_m == 0.04
    assert not config.feedback.enabled
    defaults = Config().single_camera.foreground
    assert defaults.remove_colour_shadows
    assert config.single_camera.foreground == defaults.model_copy(update={"beta": 9.0})
    assert Config.model_validate_json(config.model_dump_json()) == config


def test_keys_with_dots_are_those_of_tables():
    nested = config_of({"foreground": {"beta": 4.0, "luma_noise": 3.0}, "single_camera": {"foreground": {"beta": 5.0}}})
    dotted = {"foreground.beta": 4.0, "foreground": {"luma_noise": 3.0}, "single_camera.foreground.beta": 5.0}
    assert config_of(dotted) == nested
    with pytest.raises(InputError, match=r"foreground\.bet\b.*did you mean foreground\.beta\?"):
        config_of({"foreground.bet": 4.0})


@pytest.mark.parametrize(
    ("override", "named"),
    [
        ("foreground.learning_rat=0.1", "foreground.learning_rat"),
        ("maps.cel_m=0.03", "did you mean maps.cell_m?"),
        ("cell_m=0.03", "did you mean maps.cell_m?"),
        ("foregruond.beta=9", "did you mean foreground?"),
        ("no_such_stage.x=1", "no_such_stage"),
        ("maps.cell_m=-1", "maps.cell_m"),
        ("maps.cell_m=nan", "maps.cell_m"),
        ("maps.cell_m=wide", "maps.cell_m"),
        ("maps=3", "maps"),
        ("seed.deeper.x=1", "seed"),
        ("maps.cell_m", "maps.cell_m"),
        ("maps.cell_m=0.0049", "maps.cell_m"),
        ("floor.max_below_fraction=0.999999", "floor.max_below_fraction"),
        (".=1", ".=1"),
        ("=1", "=1"),
    ],
)
def test_override_that_cannot_be_is_refused_by_name(override, named):
    with pytest.raises(InputError) as refused:
        load_config(None, [override])
    assert named in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"[maps]\ncell_m = 99\n", r": maps\.cell_m: .*99"),
        *[(text, ": expected a TOML configuration") for text in (b"[maps", b"\xff\xfe", b"x = " + b"[" * 5000)],
        (None, ".*no such file or folder"),
    ],
    ids=["bad value", "cut off", "no text", "nested", "missing"],
)
def test_a_file_that_is_no_configuration_is_refused_by_name(tmp_path, content, found):
    if content is not None:
        (tmp_path / "c.toml").write_bytes(content)
    with pytest.raises(InputError, match=rf"c\.toml{found}"):
        load_config(tmp_path / "c.toml")


def test_every_parameter_says_what_it_means():
    parameters = [(name, each) for name, table in tables_of(Config) for each in descriptions(table)]
    assert len(parameters) > 50
    assert [(name, p.name) for name, p in parameters if not p.meaning] == []


SHAPE, SEARCHED = (48, 64), DisparityRange(0, 64)


@pytest.fixture
def disparity() -> F32:
    """Rows from 8 to 40 px, the upper quarter unknown."""
    rows = np.linspace(8, 40, SHAPE[0], dtype=np.float32)[:, None] * np.ones((1, SHAPE[1]), np.float32)
    rows[:12] = np.nan
    return rows


@pytest.mark.parametrize(
    ("change", "printed"),
    [
        (lambda disparity: disparity * 16, "sixteenths"),
        (lambda disparity: np.float32(54_000) / disparity, "or depth"),
        (lambda disparity: np.nan_to_num(disparity, nan=0.0), "expected NaN"),
        (lambda disparity: np.nan_to_num(disparity, nan=-1.0), "expected NaN"),
        (lambda disparity: disparity[1:], "expected float32"),
        (lambda disparity: disparity.astype(np.float64), "expected float32"),
        (lambda disparity: None, "NoneType"),
    ],
    ids=["sixteenths of a pixel", "millimetres", "0 for none", "-1 for none", "other shape", "other numbers", "none"],
)
def test_disparity_of_another_kind_is_refused(disparity, change, printed):
    refuse_foreign_disparity(disparity, SHAPE, SEARCHED)
    with pytest.raises(InputError, match=printed):
        refuse_foreign_disparity(change(disparity), SHAPE, SEARCHED)


def test_view_of_an_oblique_camera_reaches_far_in_its_directions():
    camera = GroundCamera(640, 480, 500.0, 3.0, math.radians(80))
    outline = np.array(camera_info(camera, {}).view_m)
    far = outline[np.hypot(*outline.T) > 40]
    half_angle = np.degrees(np.arctan2(far[:, 0], far[:, 1]))
    assert (half_angle.min(), half_angle.max()) == pytest.approx((-32.6, 32.6), abs=3)
    assert np.hypot(*outline.T).max() == pytest.approx(1.7 * 500 / 20)


def test_view_straight_down_is_the_image_on_the_floor():
    camera = GroundCamera(641, 481, 500.0, 3.0, 0.0)
    outline = np.array(camera_info(camera, {}).view_m)
    assert np.abs(outline).max(axis=0) == pytest.approx([3 * 320 / 500, 3 * 240 / 500])


def decoded(shot: Shot) -> Generator[tuple[Decoded, ...], None, None]:
    """One frame."""
    yield tuple(Decoded(0, 0.0, image) for image in shot)


def test_a_floor_that_the_camera_does_not_see_is_refused_by_name():
    upwards = SE3(np.eye(3), np.array([0.0, 0.0, 3.0]))
    width, height = CAMERA.size
    shot = np.zeros((height, width), np.uint8), np.ones((height, width), np.float32)
    sensor = DepthCamera(CAMERA, "calib.json", "structured-light", np.asarray, upwards)
    hall = Recording(Path("hall"), lambda _: decoded(shot), 1, FrameClock(10.0), [], sensor)
    with pytest.raises(InputError, match=r"hall \(floor: world\.toml\)"):
        set_up(hall, Config())


GEOMETRY = RectifiedGeometry(320, 240, 100.0, 100.0, 160.0, 120.0, 0.1)
LEVEL = SE3(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.array([0.0, 0.0, 1.0]))
"""A camera 1 m above the floor that looks along y."""
DOWN = SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 3.0]))
"""A camera 3 m above the floor that looks straight down."""


def box(world_SE3_left: SE3, x_m: float, y_m: float, height_m: float) -> tuple[float, float, float, float]:
    return person_boxes(GEOMETRY.above(world_SE3_left), [(x_m, y_m, height_m)])[0]


@pytest.mark.parametrize(
    ("pose", "person", "expected"),
    [
        # The near side is at 4 m: 25 px per metre.
        (LEVEL, (0.0, 4.25, 2.0), (160 - 25 * BODY_RADIUS_M, 120 - 25, 50 * BODY_RADIUS_M, 50)),
        # The top is 1 m below the camera: 100 px per metre.
        (DOWN, (0.0, 0.0, 2.0), (160 - 25, 120 - 25, 50, 50)),
        (DOWN, (0.0, 0.0, 2.9), (-0.5, -0.5, 320, 240)),
    ],
    ids=["ahead, of the near side", "below, of the top of the sensor", "clipped to the outer edges of the image"],
)
def test_box_of_a_person_spans_sensor_to_feet(pose, person, expected):
    assert BODY_RADIUS_M == 0.25
    assert box(pose, *person) == pytest.approx(expected)


def test_somebody_out_of_view_or_of_unknown_height_or_place_has_no_box():
    for x_m, y_m in ((0.0, -5.0), (40.0, 5.0)):
        assert all(math.isnan(side) for side in box(LEVEL, x_m, y_m, 1.8))
    for place in ((math.nan, math.nan, math.nan), (0.0, 4.0, math.nan)):
        assert person_boxes(GEOMETRY.above(LEVEL), [place]) == [NO_BOX]


def seen(points: FloorPoints) -> View:
    return View(NO_RAYS, np.zeros((1, 40), np.uint8), np.zeros((1, 40), np.float32), None, points)


def point(x_m: float, z_m: float, pixel: int) -> FloorPoints:
    xyz = np.array([[x_m, 0.0, z_m]], np.float32)
    return FloorPoints(xyz, np.ones(1, np.float32), np.array([pixel], np.int32))


def person(x_m: float, state: State = "confirmed", track_id: int = 1) -> TrackState:
    return TrackState(track_id, state, x_m, 0.0, 0.0, 0.0, 1.7)


def mask_after(feedback: Feedback, points: FloorPoints, *tracks: TrackState) -> list[int]:
    return [int(v) for v in feedback.update(tracks, seen(points))[0]]


def walked(spread_px: int = 2) -> Feedback:
    feedback = Feedback(FeedbackParams(spread_px=spread_px))
    mask_after(feedback, point(0.0, 1.0, 20), person(0.0))
    return feedback


def test_body_of_a_track_that_has_walked_is_protected_with_a_margin():
    mask = mask_after(walked(), point(1.0, 1.0, 20), person(1.0))
    assert mask[18:23] == [PERSON] * 5
    assert mask.count(PERSON) == 5
    assert mask.count(NO_FEEDBACK) == 35


def test_nothing_is_protected_where_feedback_is_off():
    assert Feedback(FeedbackParams(enabled=False)).update([], seen(point(0, 1, 2))) is None


def test_a_track_that_is_given_an_id_has_walked_as_far_as_before():
    feedback = Feedback(FeedbackParams(spread_px=0))
    mask_after(feedback, point(0.0, 1.0, 20), person(0.0, "tentative", -3))
    confirmed = Decision(1, "confirmed", "was -3", was=-3)
    assert feedback.update([person(1.0)], seen(point(1.0, 1.0, 20)), [confirmed])[0, 20] == PERSON


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
    mask = mask_after(walked(), where, who, person(9.0, track_id=2))
    assert set(mask) == expected
    assert mask[20] == max(expected, key=lambda label: label != NO_FEEDBACK)
    assert mask.count(BACKGROUND) == (BACKGROUND in expected)


@pytest.mark.parametrize("reset", [False, True], ids=["came back under its id", "reset"])
def test_track_must_walk_again_when_it_was_away_or_forgotten(reset):
    feedback = walked()
    mask_after(feedback, point(1.0, 1.0, 20), person(1.0))
    if reset:
        feedback.reset()
    else:
        mask_after(feedback, point(1.0, 1.0, 20))
    assert PERSON not in mask_after(feedback, point(1.0, 1.0, 20), person(1.0))
