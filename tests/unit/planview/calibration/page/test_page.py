import json
import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="the extra ui is not installed")

from nicegui.testing.user_simulation import user_simulation

from calib.ground_camera import GroundCamera
from planview.calibration.page.marks import Solution
from planview.calibration.page.page import Page
from planview.calibration.page.session import CalibrationSession
from tests.people import standing_people

CAMERA = GroundCamera(640, 480, 500.0, 3.5, math.radians(55), "pinhole")
BLACK = np.zeros((480, 640, 3), np.uint8)


@pytest.mark.asyncio
async def test_page_shows_the_next_step(tmp_path):
    session = CalibrationSession("clip.mp4", [BLACK] * 2, [0, 5], lens="pinhole")
    async with user_simulation(root=lambda: Page(session, tmp_path)) as user:
        await user.open("/")
        await user.should_see("draw a box around a standing person")
        user.find("Export").click()
        await user.should_see("expected marks")
        session.samples += standing_people(CAMERA, 5)
        session.solution = session.solve()
        user.find("Export").click()
        await user.should_see("wrote")
    assert (tmp_path / "camera.toml").is_file()


@pytest.mark.asyncio
async def test_camera_that_is_not_enough_is_exported_only_when_asked_again(tmp_path):
    session = CalibrationSession("clip.mp4", [BLACK], [0], lens="pinhole")
    session.samples += standing_people(CAMERA, 4)
    session.solution = session.solve()
    found = session.solution.found
    doubtful = found.assessment._replace(enough=False, sentence="not enough: add people nearer to the camera")
    session.solution = Solution(replace(found, assessment=doubtful))
    async with user_simulation(root=lambda: Page(session, tmp_path)) as user:
        await user.open("/")
        await user.should_see("add people nearer")
        user.find("Export").click()
        await user.should_see("Write samples only")
        user.find("Write samples only").click()
        await user.should_see("wrote")
    assert [p.name for p in tmp_path.iterdir()] == ["samples.json"]


@pytest.mark.asyncio
async def test_page_undo_takes_back_a_person(tmp_path):
    session = CalibrationSession("clip.mp4", [BLACK], [0], lens="pinhole")
    session.load(standing_people(CAMERA, 2), None)
    async with user_simulation(root=lambda: Page(session, tmp_path)) as user:
        await user.open("/")
        await user.should_see("2 people")
        user.find("Undo").click()
        await user.should_see("0 people")
    assert session.samples == []


@pytest.mark.asyncio
async def test_file_without_samples_is_refused_by_its_name(tmp_path):
    session = CalibrationSession("clip.mp4", [BLACK], [0])
    pages: list[Page] = []
    async with user_simulation(root=lambda: pages.append(Page(session, tmp_path))) as user:
        await user.open("/")
        with user:
            await pages[0].load("mine.json", json.dumps({"people": []}).encode())
        await user.should_see("mine.json: expected a list of samples")
    assert session.samples == []
