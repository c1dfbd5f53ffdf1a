"""The calibration page: its session and what it shows."""

import math
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_recordings import write_frames

from calib.errors import InputError
from calib.floor.find import floor_from_points
from calib.ground_camera import GroundCamera, load_ground_camera
from calib.people.model import KnownValues
from calib.people.samples import HumanSample, read_samples
from planview.calibration.page.marks import Handle, fit_plane
from planview.calibration.page.overlay import overlay
from planview.calibration.page.session import CalibrationSession, open_session
from planview.synthetic.assets import DEMO
from tests.people import standing_people

CAMERA = GroundCamera(640, 480, 500.0, 3.5, math.radians(55), "pinhole")
ONE = HumanSample((100.0, 100.0, 60.0, 150.0), (130.0, 105.0), (130.0, 245.0), 0)


def new_session(*samples: HumanSample) -> CalibrationSession:
    frames = [np.zeros((480, 640, 3), np.uint8)] * 3
    return CalibrationSession("clip.mp4", frames, [0, 10, 20], lens="pinhole", samples=list(samples))


def click(session: CalibrationSession, *points: tuple[float, float]) -> bool:
    changed = False
    for point in points:
        session.press(*point)
        changed = session.release(*point)
    return changed


def draw(session: CalibrationSession, sample: HumanSample) -> None:
    left, top, width, height = sample.box_px
    session.press(left, top)
    session.drag(left + width / 2, top + height)
    session.release(left + width, top + height)
    click(session, sample.head_px, sample.foot_px)


@pytest.fixture(scope="module")
def solved() -> CalibrationSession:
    """Six people on three frames, and their camera."""
    session = new_session()
    for number, sample in enumerate(standing_people(CAMERA, 6)):
        session.show(number % 3)
        draw(session, sample)
    session.solution = session.solve()
    return session


def test_session_turns_marked_people_into_a_camera(solved):
    assert solved.solution.found.camera.height_m == pytest.approx(3.5, rel=0.02)
    assert [s.frame for s in solved.samples] == [0, 10, 20, 0, 10, 20]
    rows = {row.name: row for row in solved.solution.rows()}
    assert rows["height above the floor"].value.startswith("3.5")
    assert all(rows[name].deviation.startswith("±") for name in ("height above the floor", "roll", "focal length"))
    assessment = solved.solution.assessment()
    assert assessment.sentence.startswith("enough" if assessment.enough else "not enough")


def test_session_leads_from_step_to_step():
    session = new_session()
    assert "3 more people" in session.message
    session.press(100, 100)
    session.release(150, 250)
    assert session.message == "click the top of the head"
    click(session, (125, 105))
    assert session.message == "click the middle between the feet"
    click(session, (125, 245))
    session.solution = session.solve()
    assert session.solution.found is None
    assert "2 more people" in session.message


def test_session_takes_a_slip_of_the_hand_for_no_box():
    session = new_session()
    session.press(100, 100)
    session.release(103, 104)
    assert session.draft.box_px is None


def test_session_refuses_a_head_far_from_its_box():
    session = new_session()
    session.press(300, 100)
    session.release(350, 250)
    assert not click(session, (20.0, 20.0), (325.0, 250.0))
    assert not session.samples
    assert "no standing person" in session.message


def test_undo_takes_back_every_kind_of_change():
    session = new_session()
    draw(session, ONE)
    session.choose("select")
    click(session, (130.0, 180.0))
    session.remove_selected()
    session.undo()
    assert session.samples == [ONE]
    session.undo()
    assert session.samples == []
    assert not session.undo()


def test_selected_head_is_moved_by_the_mouse_or_a_key():
    session = new_session(ONE)
    session.choose("select")
    session.press(131, 106)
    session.drag(134, 108)
    assert session.release(134, 108)
    assert session.samples[0].head_px == (133.0, 107.0)
    session.nudge(0, -1)
    assert session.samples[0].head_px == (133.0, 106.0)
    assert session.samples[0].foot_px == ONE.foot_px


@pytest.mark.parametrize(
    ("at", "to", "moved"),
    [
        ((100, 100), (90, 95), HumanSample((90.0, 95.0, 70.0, 155.0), ONE.head_px, ONE.foot_px, 0)),
        ((140, 180), (150, 185), HumanSample((110.0, 105.0, 60.0, 150.0), (140.0, 110.0), (140.0, 250.0), 0)),
    ],
    ids=["a corner and its two edges", "the whole person"],
)
def test_part_that_is_picked_up_moves_alone(at, to, moved):
    session = new_session(ONE)
    session.choose("select")
    session.press(*at)
    session.release(*to)
    assert session.samples == [moved]


@pytest.mark.parametrize(("frame", "selected"), [(0, Handle(0, "whole")), (1, None)])
def test_click_selects_people_of_the_frame_shown(frame, selected):
    session = new_session(ONE)
    session.show(frame)
    session.choose("select")
    assert not click(session, (140.0, 180.0))
    assert session.selected == selected


def test_person_asked_for_is_selected():
    session = new_session(HumanSample(ONE.box_px, ONE.head_px, ONE.foot_px, 20))
    session.show_sample(0)
    assert (session.shown, session.tool, session.selected) == (2, "select", Handle(0, "whole"))
    assert "drag to move it" in session.message


def test_floor_point_that_is_picked_up_moves_with_the_mouse():
    session = new_session()
    session.choose("floor")
    click(session, (200.0, 300.0))
    session.press(205, 303)
    session.drag(240, 330)
    session.release(250, 340)
    assert session.floor_points == [(245.0, 337.0)]


def test_floor_points_have_metres_once_the_camera_is_known(solved):
    session = new_session()
    session.solution = solved.solution
    session.floor_points = [solved.solution.found.camera.project((0.5, 4.0, 0.0)).tolist()]
    assert ">0.50, 4.00 m<" in overlay(session)


def test_known_focal_length_is_kept_to(solved):
    session = new_session(*solved.samples)
    session.known = KnownValues(focal_px=520.0)
    session.solution = session.solve()
    assert session.solution.found.camera.focal_px == pytest.approx(520, rel=0.03)


def test_session_exports_what_the_commands_read(solved, tmp_path):
    written = solved.export(tmp_path / "new")
    assert {p.name for p in written} == {"samples.json", "camera.toml"}
    assert len(read_samples(tmp_path / "new" / "samples.json")) == 6
    assert load_ground_camera(tmp_path / "new" / "camera.toml").height_m == pytest.approx(3.5, rel=0.03)


def test_session_exports_samples_alone_on_request(solved, tmp_path):
    assert [p.name for p in solved.export(tmp_path, solution=False)] == ["samples.json"]


def test_session_without_marks_exports_nothing(tmp_path):
    with pytest.raises(InputError, match="expected marks"):
        new_session().export(tmp_path)


def test_loaded_samples_of_another_image_size_are_refused():
    with pytest.raises(InputError, match="640x480 px, found 320x240"):
        new_session().load([ONE], (320, 240))


def test_overlay_shows_the_people_of_the_frame_shown(solved):
    svg = overlay(solved)
    assert (svg.count('class="sample"'), svg.count('class="model"'), svg.count('class="crowd"')) == (2, 2, 0)
    assert 'class="grid"' in svg
    assert "nan" not in svg
    assert 'class="crowd"' in overlay(solved, everywhere=True)


@pytest.fixture(scope="module")
def video(tmp_path_factory) -> Path:
    """Six frames of the demo with both views side by side, and its calibration next to them."""
    folder = tmp_path_factory.mktemp("pair")
    sides = [cv2.VideoCapture(str(DEMO / f"{side}.mp4")) for side in ("left", "right")]
    frames = [np.hstack([side.read()[1] for side in sides]) for _ in range(6)]
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(folder / "both.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 15.0, (width, height))
    for frame in frames:
        writer.write(frame)
    writer.release()
    shutil.copy(DEMO / "rig.toml", folder)
    return folder / "both.mp4"


def test_page_opens_a_side_by_side_video_as_a_stereo_recording(video):
    for path in (video, video.parent):
        session = open_session(path)
        assert session.size[0] == session.view.image.shape[1]


def test_page_needs_a_stereo_calibration_for_a_side_by_side_video(video, tmp_path):
    shutil.copy(video, tmp_path)
    with pytest.raises(InputError, match="stereo calibration"):
        open_session(tmp_path / video.name)
    assert open_session(tmp_path / video.name, video.parent / "rig.toml").view is not None


def test_page_refuses_a_stereo_calibration_for_one_camera(tmp_path):
    shutil.copy(DEMO / "left.mp4", tmp_path / "one.mp4")
    assert open_session(tmp_path / "one.mp4").view is None
    with pytest.raises(InputError, match="needs both cameras"):
        open_session(tmp_path / "one.mp4", DEMO / "rig.toml")


def test_every_frame_of_a_video_can_be_shown_one_by_one(video, tmp_path):
    write_frames(tmp_path / "one.avi", [np.full((48, 64, 3), 2 * level, np.uint8) for level in range(100)])
    session = open_session(tmp_path / "one.avi")
    assert len(session.frames) == 100
    assert list(session.indices) == list(range(100))
    for _ in range(57):
        session.show(session.shown + 1)
    assert float(session.frames[session.shown].mean()) == pytest.approx(114, abs=2)
    session.show(99)
    assert float(session.frames[session.shown].mean()) == pytest.approx(198, abs=2)


def test_more_people_are_asked_for_only_where_something_moved(tmp_path):
    pictures = np.full((40, 240, 320, 3), 90, np.uint8)
    for i, picture in enumerate(pictures):
        picture[100:160, 4 * i : 4 * i + 20] = 220  # somebody walks through the left half
    write_frames(tmp_path / "one.avi", pictures)
    walked = open_session(tmp_path / "one.avi").walked
    assert walked[130, 60]
    assert not walked[130, 260]
    assert not walked[30, 60]


FLOOR = np.array([(-1.0, 2.0, 3.0), (1.0, 2.0, 3.0), (0.0, 2.0, 5.0), (1.5, 2.0, 4.0), (-1.5, 2.0, 4.5)])
"""On a floor 2 m below a level camera (x right, y down, z forward)."""
LIMIT, DEPTH_STD = np.full(6, 0.06), np.full(6, 0.03)


def test_points_off_the_plane_are_refused_with_their_height_once_the_others_agree():
    points = np.vstack([FLOOR[:4], [(0.5, 1.6, 4.0)]])
    fit = fit_plane(points, LIMIT[:5], DEPTH_STD[:5])
    assert fit.used.tolist() == [True, True, True, True, False]
    assert fit.distance_m[4] == pytest.approx(0.4)
    assert fit.floor.height_m == pytest.approx(2.0)
    points = np.vstack([[(0.0, 1.0, 3.0)], FLOOR])
    assert fit_plane(points, LIMIT, DEPTH_STD).used.tolist() == [False, True, True, True, True, True]


def test_four_points_on_a_plane_are_enough():
    three, four = (fit_plane(FLOOR[:n], LIMIT[:n], DEPTH_STD[:n]).assessment() for n in (3, 4))
    assert not three.enough
    assert "fourth" in three.sentence
    assert four.enough


def test_four_clicks_close_together_are_not_enough():
    close = np.array([(-0.25, 2.0, 3.0), (0.25, 2.0, 3.0), (0.25, 2.0, 3.5), (-0.25, 2.0, 3.5)])
    fit = fit_plane(close, LIMIT[:4], DEPTH_STD[:4])
    verdict = fit.assessment()
    assert not verdict.enough
    assert "points far from the others" in verdict.sentence
    height, tilt, _, _ = fit.rows(fit.floor)
    assert height.deviation.endswith("(found 2.00 m)")
    assert tilt.value == "90.0°"
    assert float(tilt.deviation.split("°")[0].lstrip("± ")) > 1.0


def test_deviations_of_a_floor_from_points_are_the_scatter_of_floors_from_noisy_points():
    rng = np.random.default_rng(0)
    noisy = FLOOR * (1 + 0.02 / FLOOR[:, 2:] * rng.normal(size=(400, 5, 1)))
    floors = [floor_from_points(points) for points in noisy]
    scatter = np.std([(floor.height_m, floor.tilt_rad, floor.roll_rad) for floor in floors], axis=0)
    covariance = floor_from_points(FLOOR, depth_std_m=np.full(5, 0.02)).covariance
    np.testing.assert_allclose(np.sqrt(covariance.diagonal()), scatter, rtol=0.15)
