"""A run in the rerun viewer."""

from __future__ import annotations

import os
import signal
import subprocess
import sysconfig
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

from calib.errors import InputError, WorkError
from calib.io import missing, reason
from planview.output.folder import rrd_parts
from planview.output.progress import PlainConsole


def view(folder: Path | str, *, port: int = 9876, web: bool = False, web_port: int = 9090) -> None:
    """Open a run in the rerun viewer, which listens on this machine only and sends no usage statistics.

    Example: planview view out

    Example on a machine without a display, then on yours, where a browser opens the address that it prints:
        planview view out --web
        ssh -L 9090:127.0.0.1:9090 -L 9876:127.0.0.1:9876 MACHINE

    Args:
        folder: Output folder of a run made with --rrd, or an .rrd file.
        port: Port of the viewer, or with ``web`` of the data, on 127.0.0.1.
        web: Serve the viewer to a browser instead of opening a window.
        web_port: Port of the page, on 127.0.0.1.

    Raises:
        InputError: no recording for the viewer in the folder, or one that it cannot read.
        WorkError: the viewer cannot be started, or it failed.
    """
    folder = Path(folder)
    recording = folder if folder.suffix == ".rrd" else folder / "run.rrd"
    if not folder.exists():
        raise missing(folder)
    if not recording.is_file():
        raise InputError(f"{folder}: no run.rrd in it, which a run writes", remedy="rrd=True")
    parts = [recording] if folder.suffix == ".rrd" else rrd_parts(recording)
    for part in parts:
        refuse_broken(part)
    viewer = Path(sysconfig.get_path("scripts")) / "rerun"
    command = [str(viewer), "--bind", "127.0.0.1", "--port", str(port)]
    if web:
        command += ["--serve-web", "--web-viewer-port", str(web_port), "--server-memory-limit", "75%"]
        data = f"rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{port}%2Fproxy"
        PlainConsole(stderr=True, soft_wrap=True, highlight=False).print(
            f"open http://127.0.0.1:{web_port}/?url={data}   (Ctrl-C ends it)"
        )
    try:
        status = _viewed([*command, *map(str, parts)])
    except OSError as error:
        raise WorkError(f"the rerun viewer cannot be started ({reason(error)}); is rerun-sdk installed?") from error
    if status != 0:
        hint = "is the port free?" if web else "it needs a display and a graphics driver; a browser needs none"
        raise WorkError(f"the rerun viewer ended with status {status} ({hint})")


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


def _viewed(command: list[str]) -> int:
    """Exit status of the viewer; whatever ends the wait, it and the processes that it started end, too."""
    viewer = subprocess.Popen(command, env=quiet_environment(), start_new_session=True)
    try:
        return viewer.wait()
    finally:
        with suppress(OSError):
            os.killpg(viewer.pid, signal.SIGTERM)
        viewer.wait()


def quiet_environment() -> dict[str, str]:
    """Variables under which rerun's programs send no usage statistics: they send none where ``CI`` is set."""
    return {**{k: v for k, v in os.environ.items() if k != "FORCE_RERUN_ANALYTICS"}, "CI": "1"}
