"""A run shown in rerun while it goes on."""

import socket
import subprocess
import sysconfig
import time
from itertools import islice
from pathlib import Path
from unittest.mock import Mock

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
    program = subprocess.Popen([*map(str, command)], env=viewer.quiet_environment())
    try:
        wait_until(port, is_listened_on=True)
        log = ViewerLog(engine, f"rerun+http://127.0.0.1:{port}/proxy")
        for result in islice(engine, 6):
            log.frame(result)
        log.close()
        time.sleep(1.0)
    finally:
        program.terminate()
        program.wait()
    printed = subprocess.run([RERUN, "rrd", "print", file], capture_output=True, text=True, timeout=60).stdout
    assert "/world/people" in printed and "/image/left" in printed


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


def test_a_taken_port_gives_another():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert viewer.free_port(port) != port
