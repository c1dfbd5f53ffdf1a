"""The calibration page in headless Chromium, driven over the WebDriver protocol, and who else may reach its server."""

import base64
import math
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from webdriver import Browser, free_port, stop, wait_for

from calib.errors import InputError
from calib.ground_camera import GroundCamera, load_ground_camera
from calib.people.model import HumanModel
from calib.people.samples import HumanSample
from planview.api.calibrate_pair import ui
from planview.calibration.people import draw_person
from tests.people import standing_people

pytest.importorskip("nicegui", reason="the extra ui is not installed")

CAMERA = GroundCamera(640, 480, 500.0, 3.5, math.radians(55), "pinhole")


@pytest.fixture
def browser() -> Iterator[Browser]:
    chromedriver, chromium = shutil.which("chromedriver"), shutil.which("chromium")
    if chromedriver is None or chromium is None:
        pytest.skip("chromium and chromedriver are not installed")
    port = free_port()
    driver = subprocess.Popen([chromedriver, f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_for(f"http://127.0.0.1:{port}/status", 30)
        opened = Browser(port)
        yield opened
        opened.quit()
    finally:
        stop(driver)


@pytest.fixture
def people() -> list[HumanSample]:
    return standing_people(CAMERA, 6, seed=3)


@pytest.fixture
def page(tmp_path, people) -> Iterator[str]:
    pytest.importorskip("nicegui", reason="the extra ui is not installed")
    frames = tmp_path / "frames"
    frames.mkdir()
    for i, sample in enumerate(people):
        image = np.full((480, 640, 3), (90, 100, 110), np.uint8)
        draw_person(image, CAMERA, HumanModel(), CAMERA.back_project(sample.foot_px), (255, 255, 255))
        cv2.imwrite(str(frames / f"{i:03d}.png"), image)
    port = free_port()
    command = [sys.executable, "-m", "planview", "calibrate", "ui", str(frames), "--out", str(tmp_path / "out")]
    # NiceGUI waits for a test's own set-up when it sees pytest's variables.
    outside = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST", "NICEGUI"))}
    server = subprocess.Popen(
        [*command, "--port", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=outside
    )
    try:
        wait_for(f"http://127.0.0.1:{port}/")
        yield f"http://127.0.0.1:{port}/"
    finally:
        stop(server)


class Picture:
    """Where the picture is in the window."""

    def __init__(self, browser: Browser) -> None:
        self._browser = browser

    def rectangle(self) -> list[float]:
        image = "document.querySelector('.pv-stage img')"
        return list(
            self._browser.run(f"const r = {image}.getBoundingClientRect(); return [r.left, r.top, r.width, r.height]")
        )

    def at(self, point: tuple[float, float]) -> tuple[float, float]:
        """The place in the window of a pixel of the picture."""
        left, top, width, _ = self.rectangle()
        return left + (point[0] + 0.5) * width / 640, top + (point[1] + 0.5) * width / 640


def draw(browser: Browser, picture: Picture, sample: HumanSample, number: int) -> None:
    x, y, w, h = sample.box_px
    one, other = picture.at((x, y)), picture.at((x + w, y + h))
    browser.mouse(("pointerDown", *one), ("pointerMove", *other), ("pointerUp", *other))
    browser.wait("return document.body.innerText.includes('click the top of the head')")
    counted = f"{number} people" if number > 1 else "1 person"
    for point, then in ((sample.head_px, "middle between the feet"), (sample.foot_px, counted)):
        browser.mouse(("pointerDown", *picture.at(point)), ("pointerUp", *picture.at(point)))
        browser.wait(f"return document.body.innerText.includes('{then}')")


@pytest.mark.slow
def test_people_marked_with_the_mouse_become_a_camera(browser, page, people, tmp_path):
    browser.open(page)
    browser.wait("return document.querySelector('.pv-stage img')?.naturalWidth > 0 && document.body.dataset.zoom")
    picture = Picture(browser)
    assert picture.rectangle()[2] > 700, "the picture is as large as its place"
    for number, sample in enumerate(people, 1):
        draw(browser, picture, sample, number)
    browser.wait("return document.body.innerText.includes('above the floor')")
    browser.wait("return !document.querySelector('.pv-side').innerText.includes('solving')")
    assert browser.run("return document.querySelectorAll('.model').length") == len(people)
    assert browser.run("return document.querySelectorAll('.grid').length") > 4
    _zoom_select_delete(browser, picture, people)
    browser.run("[...document.querySelectorAll('button')].find(b => b.innerText.toUpperCase() == 'EXPORT').click()")
    browser.wait("return document.body.innerText.match(/wrote|Write it all the same/)")
    (tmp_path / "page.png").write_bytes(browser.screenshot())
    browser.run("[...document.querySelectorAll('button')].find(b => b.innerText.includes('all the same'))?.click()")
    browser.wait("return document.body.innerText.includes('wrote')")
    assert load_ground_camera(tmp_path / "out" / "camera.toml").height_m == pytest.approx(3.5, rel=0.1)


def _zoom_select_delete(browser: Browser, picture: Picture, people: list[HumanSample]) -> None:
    """Zoom keeps the pixel under the mouse; a person that is selected is deleted, and comes back by undo."""
    before = picture.at(people[0].foot_px)
    browser.wheel(*before, -800)
    assert float(browser.wait("return document.body.dataset.zoom > 2 && document.body.dataset.zoom")) > 2
    assert picture.at(people[0].foot_px) == pytest.approx(before, abs=12)
    browser.mouse(("pointerMove", *before))
    assert browser.run("return document.querySelector('.pv-loupe').style.display") == "block"
    browser.key("0")
    browser.wait("return document.body.dataset.zoom == 1")
    browser.key("s")
    browser.wait("return document.body.innerText.includes('click a person or a point')")
    browser.mouse(("pointerDown", *picture.at(people[0].foot_px)), ("pointerUp", *picture.at(people[0].foot_px)))
    browser.key("\ue017")
    browser.wait(f"return document.body.innerText.includes('{len(people) - 1} people')")
    browser.run("[...document.querySelectorAll('button')].find(b => b.innerText == 'Undo').click()")
    browser.wait(f"return document.body.innerText.includes('{len(people)} people')")
    browser.wait("return !document.querySelector('.pv-side').innerText.includes('solving')")


def test_port_in_use_is_one_sentence(tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(InputError, match="in use"):
            ui(tmp_path, port=taken.getsockname()[1])


SERVER = """
import sys
import numpy as np
from pathlib import Path
from planview.calibration.page.page import serve
from planview.calibration.page.session import CalibrationSession

serve(CalibrationSession("clip", [np.zeros((48, 64, 3), np.uint8)], [0]), Path("."), int(sys.argv[1]))
"""


@pytest.fixture(scope="module")
def port(tmp_path_factory) -> Iterator[int]:
    number = free_port()
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("NICEGUI", "PYTEST"))}
    server = subprocess.Popen(
        [sys.executable, "-c", SERVER, str(number)],
        env={**environment, "PYTHONPATH": str(Path(__file__).resolve().parents[2])},
        cwd=tmp_path_factory.mktemp("page"),
        stderr=subprocess.DEVNULL,
    )
    try:
        wait_for(f"http://127.0.0.1:{number}/")
        yield number
    finally:
        stop(server)


def answered(port: int, path: str, *headers: str) -> int:
    """Status of the answer to one request, sent as written."""
    with socket.create_connection(("127.0.0.1", port), 30) as line:
        line.sendall("\r\n".join([f"GET {path} HTTP/1.1", *headers, "", ""]).encode())
        return int(line.recv(4096).split()[1])


def handshake(port: int, *headers: str) -> int:
    key = base64.b64encode(b"0123456789abcdef").decode()
    wanted = ("Upgrade: websocket", "Connection: Upgrade", f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13")
    return answered(port, "/_nicegui_ws/socket.io/?EIO=4&transport=websocket", *wanted, *headers)


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
def test_page_is_served_under_the_names_of_this_machine(port, name):
    own = f"{name}:{port}"
    assert answered(port, "/", f"Host: {own}") == 200
    assert handshake(port, f"Host: {own}", f"Origin: http://{own}") == 101


def test_other_host_name_is_refused(port):
    assert answered(port, "/", f"Host: evil.example:{port}") == 403
    assert handshake(port, f"Host: evil.example:{port}", f"Origin: http://evil.example:{port}") == 403


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1:1", ""])
def test_websocket_of_another_page_is_refused(port, origin):
    assert handshake(port, f"Host: 127.0.0.1:{port}", f"Origin: {origin}") == 403
