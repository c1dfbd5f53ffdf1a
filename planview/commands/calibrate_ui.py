"""``planview calibrate ui``: calibrate in the browser."""

from __future__ import annotations

import socket
from pathlib import Path

from calib.errors import InputError, WorkError
from planview.output.progress import PlainConsole


def calibrate_ui(
    recording: Path,
    *,
    out: Path = Path("."),
    calibration: Path | None = None,
    port: int = 8600,
) -> None:
    """Calibrate in the browser: draw standing people or floor points, see the fit and how well it is known, export.

    Example: planview calibrate ui street.mp4 --out calibration

    The page says where the next person would help most, takes values that are known (focal length or field of view,
    also from a phone's photo, camera height, people's height), and loads and saves samples.

    Parameters
    ----------
    recording
        Video of one camera (draw people: samples.json, camera.toml), or a stereo recording (click floor points:
        world.toml).
    out
        Folder that Export writes to.
    calibration
        Calibration of a stereo recording, when it does not lie in it.
    port
        Port on 127.0.0.1; other machines cannot connect.
    """
    if not 1024 <= port <= 65535:
        raise InputError(f"--port: expected 1024 to 65535, found {port}")
    _refuse_used(port)
    try:
        from planview.calibration.browser.page import serve
    except ImportError as error:
        raise WorkError(f'planview calibrate ui needs the extra "ui" (pip install "planview[ui]"): {error}') from error
    from planview.calibration.browser.opening import open_session

    session = open_session(recording, calibration)
    PlainConsole(stderr=True).print(f"open http://127.0.0.1:{port}/ in a browser; Ctrl-C ends")
    serve(session, out, port, None if session.view else recording)


def _refuse_used(port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise InputError(f"--port: {port} is in use by another program; choose another, e.g. {port + 1}") from error
