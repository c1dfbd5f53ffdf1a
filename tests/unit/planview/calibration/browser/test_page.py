import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="the extra ui is not installed")

from nicegui.testing.user_simulation import user_simulation

from calib.ground_camera import GroundCamera
from planview.calibration.browser.page import Page
from planview.calibration.browser.session import CalibrationSession
from tests.people import standing_people

CAMERA = GroundCamera(640, 480, 500.0, 3.5, math.radians(55), "pinhole")


@pytest.mark.asyncio
async def test_page_says_what_to_do_and_exports(tmp_path: Path) -> None:
    session = CalibrationSession("clip.mp4", [np.zeros((480, 640, 3), np.uint8)] * 2, [0, 5], lens="pinhole")
    async with user_simulation(root=lambda: Page(session, tmp_path)) as user:
        await user.open("/")
        await user.should_see("draw a box around a standing person")
        user.find("Export").click()
        await user.should_see("something drawn")
        session.samples += standing_people(CAMERA, 5)
        session.solve()
        user.find("Export").click()
        await user.should_see("wrote")
    assert (tmp_path / "camera.toml").is_file()


@pytest.mark.asyncio
async def test_page_undo_takes_back_a_person(tmp_path: Path) -> None:
    session = CalibrationSession("clip.mp4", [np.zeros((480, 640, 3), np.uint8)], [0], lens="pinhole")
    session.samples += standing_people(CAMERA, 2)
    async with user_simulation(root=lambda: Page(session, tmp_path)) as user:
        await user.open("/")
        await user.should_see("2 people")
        user.find("Undo").click()
        await user.should_see("1 people")
    assert len(session.samples) == 1
