"""The calibration page in headless Chromium, driven with real mouse events over the WebDriver protocol."""

import base64
import json
import math
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calib.ground_camera import GroundCamera, load_ground_camera
from calib.human.model import HumanModel
from calib.human.samples import HumanSample
from planview.calibration.pictures import draw_person
from tests.people import standing_people

CAMERA = GroundCamera(640, 480, 500.0, 3.5, math.radians(55), "pinhole")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Browser:
    """A few WebDriver calls."""

    def __init__(self, port: int) -> None:
        self._base = f"http://127.0.0.1:{port}"
        arguments = ["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
        options = {"goog:chromeOptions": {"args": [*arguments, "--window-size=1200,1000"]}}
        session = self._call("POST", "/session", {"capabilities": {"alwaysMatch": options}})
        self._session = f"/session/{session['sessionId']}"

    def open(self, url: str) -> None:
        self._call("POST", f"{self._session}/url", {"url": url})

    def run(self, script: str) -> Any:
        return self._call("POST", f"{self._session}/execute/sync", {"script": script, "args": []})

    def wait(self, script: str, seconds: float = 60.0) -> Any:
        until = time.monotonic() + seconds
        while not (value := self.run(script)):
            assert time.monotonic() < until, (
                f"waited in vain for {script}; page: {self.run('return document.body.innerText')}"
            )
            time.sleep(0.1)
        return value

    def mouse(self, *steps: tuple[str, float, float]) -> None:
        actions: list[dict[str, Any]] = []
        for kind, x, y in steps:
            actions.append({"type": "pointerMove", "duration": 40, "x": round(x), "y": round(y)})
            if kind != "pointerMove":
                actions.append({"type": kind, "button": 0})
        pointer = {"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": actions}
        self._call("POST", f"{self._session}/actions", {"actions": [pointer]})

    def screenshot(self) -> bytes:
        return base64.b64decode(self._call("GET", f"{self._session}/screenshot"))

    def quit(self) -> None:
        self._call("DELETE", self._session)

    def _call(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self._base + path, data, {"Content-Type": "application/json"}, method=method)
        with urllib.request.urlopen(request, timeout=60) as reply:
            return json.loads(reply.read())["value"]


def wait_for(url: str, seconds: float = 90.0) -> None:
    until = time.monotonic() + seconds
    while True:
        try:
            urllib.request.urlopen(url, timeout=2).close()
            return
        except (urllib.error.URLError, OSError):
            assert time.monotonic() < until, f"nothing answers at {url}"
            time.sleep(0.2)


def stop(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(timeout=20)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


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
    return standing_people(CAMERA, 5, seed=3)


@pytest.fixture
def page(tmp_path: Path, people: list[HumanSample]) -> Iterator[str]:
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


def test_people_drawn_with_the_mouse_become_a_camera(
    browser: Browser, page: str, people: list[HumanSample], tmp_path: Path
) -> None:
    browser.open(page)
    browser.wait("return document.querySelector('.nicegui-interactive-image img, img')?.naturalWidth > 0")
    rect = "const r = document.querySelector('.nicegui-interactive-image img, img').getBoundingClientRect();"
    left, top, width = browser.run(rect + "return [r.left, r.top, r.width]")
    assert width == pytest.approx(640, abs=2)
    for number, sample in enumerate(people, 1):
        x, y, w, h = sample.box_px
        corners = (left + x, top + y), (left + x + w, top + y + h)
        browser.mouse(("pointerDown", *corners[0]), ("pointerMove", *corners[1]), ("pointerUp", *corners[1]))
        browser.wait("return document.body.innerText.includes('click the top of the head')")
        for (u, v), then in ((sample.head_px, "middle between the feet"), (sample.foot_px, f"{number} people")):
            browser.mouse(("pointerDown", left + u, top + v), ("pointerUp", left + u, top + v))
            browser.wait(f"return document.body.innerText.includes('{then}')")
    browser.wait("return document.body.innerText.includes('above the floor')")
    assert browser.wait("return document.querySelectorAll('.model').length") == 5
    assert browser.run("return document.querySelectorAll('.grid').length") > 4
    picture = browser.screenshot()
    (tmp_path / "page.png").write_bytes(picture)
    assert cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR) is not None
    browser.run("[...document.querySelectorAll('button')].find(b => b.innerText.toUpperCase() == 'EXPORT').click()")
    browser.wait("return document.body.innerText.includes('wrote')")
    assert load_ground_camera(tmp_path / "out" / "camera.toml").height_m == pytest.approx(3.5, rel=0.1)
