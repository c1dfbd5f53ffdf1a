import math
from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError
from calib.ground_camera import GroundCamera, load_ground_camera
from calib.human.samples import HumanSample, read_samples
from planview.calibration.browser.overlay import overlay
from planview.calibration.browser.session import CalibrationSession
from tests.people import standing_people

CAMERA = GroundCamera(640, 480, 500.0, 3.5, math.radians(55), "pinhole")


def new_session() -> CalibrationSession:
    frames = [np.zeros((480, 640, 3), np.uint8)] * 3
    return CalibrationSession("clip.mp4", frames, [0, 10, 20], lens="pinhole")


def draw(session: CalibrationSession, sample: HumanSample) -> None:
    left, top, width, height = sample.box_px
    session.press(left, top)
    session.drag(left + width / 2, top + height)
    session.release(left + width, top + height)
    for point in (sample.head_px, sample.foot_px):
        session.press(*point)
        if session.release(*point):
            session.solve()


def test_session_turns_drawn_people_into_a_camera() -> None:
    session = new_session()
    for number, sample in enumerate(standing_people(CAMERA, 6)):
        session.show(number % 3)
        draw(session, sample)
    assert session.found is not None
    assert session.found.camera.height_m == pytest.approx(3.5, rel=0.02)
    assert session.found.camera.focal_px == pytest.approx(500, rel=0.03)
    assert [s.frame for s in session.samples] == [0, 10, 20, 0, 10, 20]


def test_session_says_how_many_people_are_missing() -> None:
    session = new_session()
    assert "3 more people" in session.message
    draw(session, standing_people(CAMERA, 1)[0])
    assert session.found is None
    assert "2 more people" in session.message


def test_session_leads_from_box_to_head_to_foot() -> None:
    session = new_session()
    session.press(100, 100)
    session.release(150, 250)
    assert session.tool == "head"
    session.press(125, 105)
    session.release(125, 105)
    assert session.tool == "foot"


def test_session_keeps_the_next_step_of_a_person_begun_while_it_solves() -> None:
    session = new_session()
    for sample in standing_people(CAMERA, 3):
        draw(session, sample)
    session.press(100, 100)
    session.release(150, 250)
    session.solve()
    assert session.message.startswith("camera 3.5")
    assert session.message.endswith("click the top of the head")


def test_session_takes_a_slip_of_the_hand_for_no_box() -> None:
    session = new_session()
    session.press(100, 100)
    session.release(103, 104)
    assert session.tool == "box"
    assert session.draft.box_px is None


def test_session_refuses_a_head_far_from_its_box_and_says_so() -> None:
    session = new_session()
    draw(session, HumanSample((100, 100, 60, 150), (130, 100), (130, 250)))
    session.press(300, 100)
    session.release(350, 250)
    for point in ((20.0, 20.0), (325.0, 250.0)):
        session.press(*point)
        session.release(*point)
    assert len(session.samples) == 1
    assert "no standing person" in session.message


def test_session_undo_takes_back_the_last_person() -> None:
    session = new_session()
    for sample in standing_people(CAMERA, 4):
        draw(session, sample)
    session.remove_last()
    assert len(session.samples) == 3


def test_session_moves_a_floor_point_that_is_picked_up() -> None:
    session = new_session()
    session.tool = "floor"
    session.press(200, 300)
    session.release(200, 300)
    session.press(205, 303)
    session.drag(240, 330)
    session.release(250, 340)
    assert session.floor_points == [(250.0, 340.0)]


def test_session_gives_floor_points_in_metres_once_the_camera_is_known() -> None:
    session = new_session()
    for sample in standing_people(CAMERA, 6):
        draw(session, sample)
    session.tool = "floor"
    pixel = CAMERA.project((0.5, 4.0, 0.0))
    session.press(*pixel)
    session.release(*pixel)
    assert session.floor_metres()[0] == pytest.approx((0.5, 4.0), abs=0.15)


def test_session_exports_what_the_commands_read(tmp_path: Path) -> None:
    session = new_session()
    for sample in standing_people(CAMERA, 5):
        draw(session, sample)
    written = session.export(tmp_path / "new")
    assert {p.name for p in written} == {"samples.json", "camera.toml"}
    assert len(read_samples(tmp_path / "new" / "samples.json")) == 5
    assert load_ground_camera(tmp_path / "new" / "camera.toml").height_m == pytest.approx(3.5, rel=0.03)


def test_session_refuses_to_export_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="something drawn"):
        new_session().export(tmp_path)


def test_overlay_shows_grid_models_and_samples_of_a_solved_session() -> None:
    session = new_session()
    for sample in standing_people(CAMERA, 4):
        draw(session, sample)
    svg = overlay(session)
    assert svg.count('class="sample"') == 4
    assert svg.count('class="model"') == 4
    assert 'class="grid"' in svg
    assert "nan" not in svg
