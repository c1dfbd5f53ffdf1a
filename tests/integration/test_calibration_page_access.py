"""Other pages in the same browser reach 127.0.0.1 too: they get neither the page nor its websocket."""

import base64
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from webdriver import free_port, stop, wait_for

pytest.importorskip("nicegui", reason="the extra ui is not installed")

SERVER = """
import sys
import numpy as np
from pathlib import Path
from planview.calibration.page.page import serve
from planview.calibration.page.session import CalibrationSession

serve(CalibrationSession("clip", [np.zeros((48, 64, 3), np.uint8)], [0]), Path("."), int(sys.argv[1]))
"""


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
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
def test_page_and_websocket_are_served_under_the_names_of_this_machine(port: int, name: str) -> None:
    own = f"{name}:{port}"
    assert answered(port, "/", f"Host: {own}") == 200
    assert handshake(port, f"Host: {own}", f"Origin: http://{own}") == 101


def test_other_host_name_is_refused(port: int) -> None:
    assert answered(port, "/", f"Host: evil.example:{port}") == 403
    assert handshake(port, f"Host: evil.example:{port}", f"Origin: http://evil.example:{port}") == 403


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1:1", ""])
def test_websocket_of_another_page_is_refused(port: int, origin: str) -> None:
    assert handshake(port, f"Host: 127.0.0.1:{port}", f"Origin: {origin}") == 403
