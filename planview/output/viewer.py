"""The rerun viewer as a process of its own: a window, or a page that a browser on this machine opens."""

from __future__ import annotations

import atexit
import logging
import os
import signal
import socket
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from calib.errors import InputError, WorkError
from calib.io import reason, refuse_missing
from planview.output.folder import rrd_parts

if TYPE_CHECKING:
    from planview.engine.engine import Engine, FrameResult
    from planview.output.rerun_log import ViewerLog

log = logging.getLogger(__name__)
PORT = 9876
WEB_PORT = 9090
"""Ports at which rerun's programs look for data and for the page."""


class Viewer:
    """A running viewer, which listens on 127.0.0.1 only and sends no usage statistics.

    Attributes:
        data: address that frames are sent to.
        page: address for a browser; "" when the viewer is a window.

    Args:
        recordings: files to show.
        web: serve a page instead of opening a window.
        port: of the data.
        web_port: of the page.
    Raises:
        WorkError: the viewer cannot be started.
    """

    def __init__(
        self, recordings: Sequence[Path] = (), *, web: bool = False, port: int = PORT, web_port: int = WEB_PORT
    ) -> None:
        program = Path(sysconfig.get_path("scripts")) / "rerun"
        command = [str(program), "--bind", "127.0.0.1", "--port", str(port)]
        self.data = f"rerun+http://127.0.0.1:{port}/proxy"
        self.page = ""
        if web:
            command += ["--serve-web", "--web-viewer-port", str(web_port), "--server-memory-limit", "75%"]
            self.page = f"http://127.0.0.1:{web_port}/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{port}%2Fproxy"
        elif not recordings:
            command += ["--expect-data-soon"]
        try:
            self._process = subprocess.Popen(
                [*command, *map(str, recordings)], env=quiet_environment(), start_new_session=True
            )
        except OSError as error:
            raise WorkError(f"the rerun viewer cannot be started ({reason(error)}); is rerun-sdk installed?") from error

    def wait(self) -> None:
        """Wait until the user closes the viewer; whatever ends the wait, it and the processes that it started end, too.

        Raises WorkError: the viewer failed.
        """
        try:
            status = self._process.wait()
        finally:
            self.close()
        if status != 0:
            if self.page:
                raise WorkError(f"the rerun viewer ended with status {status} (is the port free?)")
            needs = "a window needs a display and a graphics driver, a page needs none"
            raise WorkError(f"the rerun viewer ended with status {status} ({needs})", remedy="web=True")

    def close(self) -> None:
        """End the viewer and the processes that it started."""
        with suppress(OSError):
            os.killpg(self._process.pid, signal.SIGTERM)
        self._process.wait()


class LiveViewer:
    """The viewer of one run while it runs, on free ports: a window where there is a display, else a page, which a
    notebook shows; its address is printed, and it is served as long as this program runs.

    Attributes:
        viewer: what runs; None before the first frame.
    """

    def __init__(self) -> None:
        self.viewer: Viewer | None = None

    def open(self) -> Viewer:
        """Start the viewer."""
        is_notebook = in_notebook()
        viewer = Viewer(web=is_notebook or not has_display(), port=free_port(PORT), web_port=free_port(WEB_PORT))
        self.viewer = viewer
        if viewer.page:
            atexit.register(viewer.close)
            log.warning("open %s", viewer.page)  # a warning is seen where nobody has set up logging
        if is_notebook:
            from IPython.display import IFrame, display

            display(IFrame(viewer.page, width="100%", height=720))  # type: ignore[no-untyped-call]
        return viewer

    @contextmanager
    def showing(self, engine: Engine) -> Iterator[Callable[[FrameResult], None]]:
        """Show the frames of a run. The viewer opens with the first one, when all that can refuse the run has passed,
        and ends with a run that fails."""
        log: ViewerLog | None = None

        def show(result: FrameResult) -> None:
            nonlocal log
            if log is None:
                from planview.output.rerun_log import ViewerLog  # rerun takes a second

                log = ViewerLog(engine, self.open().data)
            log.frame(result)

        has_failed = True
        try:
            yield show
            has_failed = False
        except KeyboardInterrupt:
            has_failed = False  # what the user stopped can still be looked at
            raise
        finally:
            if log is not None:
                log.close()
            if has_failed and self.viewer is not None:
                self.viewer.close()


def in_notebook() -> bool:
    """True where this program is the kernel of a notebook."""
    return "ipykernel" in sys.modules and "IPython" in sys.modules


def has_display() -> bool:
    """True where a window can be opened."""
    return sys.platform in ("darwin", "win32") or any(os.environ.get(k) for k in ("DISPLAY", "WAYLAND_DISPLAY"))


def free_port(usual: int) -> int:
    """The usual port on 127.0.0.1, or a free one where another program listens on it."""
    for port in (usual, 0):
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return int(probe.getsockname()[1])
    raise WorkError("no free port on 127.0.0.1")


def quiet_environment() -> dict[str, str]:
    """Variables under which rerun's programs send no usage statistics: they send none where ``CI`` is set."""
    environment = {**os.environ, "CI": "1"}
    environment.pop("FORCE_RERUN_ANALYTICS", None)
    return environment


def open_viewer(folder: Path, *, web: bool, port: int, web_port: int) -> Viewer:
    """The viewer of a run's folder, or of an .rrd file. Raises InputError: no recording for it, or one that it cannot
    read. WorkError: there is no display, or it cannot be started."""
    recording = folder if folder.suffix == ".rrd" else folder / "run.rrd"
    refuse_missing(folder)
    if not recording.is_file():
        raise InputError(f"{folder}: no run.rrd in it, which a run writes", remedy="rrd=True")
    parts = [recording] if folder.suffix == ".rrd" else rrd_parts(recording)
    for part in parts:
        refuse_broken(part)
    if not web and not has_display():
        raise WorkError("there is no display to open a window on", remedy="web=True")
    viewer = Viewer(parts, web=web, port=port, web_port=web_port)
    if viewer.page:
        log.warning("open %s   (Ctrl-C ends it)", viewer.page)  # a warning is seen where nobody has set up logging
    return viewer


def refuse_broken(part: Path) -> None:
    """Raise InputError for what the viewer would show as an empty page: no recording, of another version, cut off."""
    with part.open("rb") as file:
        head = file.read(8)
        file.seek(max(0, part.stat().st_size - 12))
        end = file.read()
    own = tuple(map(int, version("rerun-sdk").split(".")[:2]))
    found = ""
    if len(head) < 8 or not head.startswith(b"RRF"):
        found = "a file of another kind" if head else "an empty file"
    elif not (0, 23) <= (head[4], head[5]) <= own or head[:4] != b"RRF2":  # each reads what 0.23 and later wrote
        found = f"one of rerun {head[4]}.{head[5]}, which rerun {own[0]}.{own[1]} does not read: install that version"
    elif (head[4], head[5]) == own and not end.startswith(b"RRF2FOOT"):
        found = f"one that was cut off: rerun rrd merge {part} -o whole.rrd recovers what is there"
    if found:
        raise InputError(f"{part}: expected a rerun recording, found {found}")
