"""A run shown in rerun while it goes on."""

import os
import signal
import socket
import subprocess
import sysconfig
import time
from itertools import islice
from pathlib import Path
from unittest.mock import Mock

import pytest

import planview
from calib.errors import InputError, WorkError
from planview.engine.engine import FrameResult
from planview.output import viewer
from planview.output.rerun_log import ViewerLog

RERUN = Path(sysconfig.get_path("scripts")) / "rerun"


def listening(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def wait_until(port: int, *, is_listened_on: bool) -> None:
    until = time.monotonic() + 60
    while listening(port) != is_listened_on:
        assert time.monotonic() < until
        time.sleep(0.1)


def test_a_viewer_receives_people_of_every_frame(engine, tmp_path):
    port, file = viewer.free_port(viewer.PORT), tmp_path / "received.rrd"
    command = [RERUN, "--serve-grpc", "--bind", "127.0.0.1", "--port", str(port), "--save", file]
    program = subprocess.Popen([*map(str, command)], env=viewer.quiet_environment(), start_new_session=True)
    try:
        wait_until(port, is_listened_on=True)
        log = ViewerLog(engine, f"rerun+http://127.0.0.1:{port}/proxy")
        for result in islice(engine, 6):
            log.frame(result)
        log.close()
        time.sleep(1.0)
    finally:
        os.killpg(program.pid, signal.SIGTERM)  # and the program that it started
        program.wait()
    printed = subprocess.run([RERUN, "rrd", "print", file], capture_output=True, text=True, timeout=60).stdout
    assert "/world/people" in printed
    assert "/image/left" in printed


def test_a_run_goes_on_without_a_viewer_that_was_closed(engine):
    log = ViewerLog(engine, "rerun+http://127.0.0.1:1/proxy")
    log._stream.flush = Mock(side_effect=RuntimeError("Flush timed out"))
    (result,) = islice(engine, 1)
    for _ in range(101):
        log.frame(result)
    assert log._stream is None
    log.close()


def test_the_viewer_serves_a_page_on_this_machine_only():
    port, web_port = viewer.free_port(0), viewer.free_port(0)
    shown = viewer.Viewer(web=True, port=port, web_port=web_port)
    try:
        wait_until(web_port, is_listened_on=True)
        assert shown.page.startswith(f"http://127.0.0.1:{web_port}/")
        with socket.socket() as probe:  # free on the machine's other addresses
            probe.bind(("127.0.0.2", web_port))
    finally:
        shown.close()
    wait_until(web_port, is_listened_on=False)


class Opened:
    """Stands for a viewer."""

    data = page = ""

    def __init__(self) -> None:
        self.frames = 0
        self.was_ended = False

    def close(self) -> None:
        self.was_ended = True


class Log:
    """Counts the frames that a viewer gets."""

    def __init__(self, viewer: Opened) -> None:
        self._viewer = viewer

    def frame(self, _: FrameResult) -> None:
        self._viewer.frames += 1

    def close(self) -> None:
        pass


@pytest.fixture
def opened(monkeypatch) -> list[Opened]:
    """The viewers that were opened, without their programs."""
    viewers = []

    def open_viewer(**_):
        viewers.append(Opened())
        return viewers[-1]

    monkeypatch.setattr(viewer, "Viewer", open_viewer)
    monkeypatch.setattr("planview.output.rerun_log.ViewerLog", lambda engine, address: Log(viewers[-1]))
    return viewers


@pytest.mark.parametrize(
    "refused_by",
    [{"frames": "900:901"}, {"rules": "none.toml", "out": "new"}, {"out": "/dev/null"}, {"rrd": True}, {"fps": 5.0}],
)
def test_a_run_that_is_refused_opens_no_viewer(engine, opened, refused_by, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((InputError, WorkError)):
        planview.run(engine, view=True, **refused_by)
    assert opened == []


@pytest.mark.parametrize(("error", "closed"), [(WorkError("full"), True), (KeyboardInterrupt(), False)])
def test_the_viewer_is_closed_when_the_run_fails(engine, opened, error, closed):
    show = viewer.LiveViewer()

    def run():
        with show.showing(engine) as frame:
            for result in islice(engine, 2):
                frame(result)
            raise error

    with pytest.raises(type(error)):
        run()
    (one,) = opened
    assert one.frames == 2
    assert one.was_ended == closed


def test_a_taken_port_gives_another():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert viewer.free_port(port) != port
