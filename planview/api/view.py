"""A run in the rerun viewer."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

from calib.errors import InputError, WorkError
from calib.io import missing
from planview.output.folder import rrd_parts
from planview.output.progress import PlainConsole
from planview.output.viewer import PORT, WEB_PORT, Viewer, has_display


def view(folder: Path | str, *, port: int = PORT, web: bool = False, web_port: int = WEB_PORT) -> None:
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
        WorkError: there is no display, or the viewer cannot be started, or it failed.
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
    if not web and not has_display():
        raise WorkError("there is no display to open a window on", remedy="web=True")
    viewer = Viewer(parts, web=web, port=port, web_port=web_port)
    if viewer.page:
        console = PlainConsole(stderr=True, soft_wrap=True, highlight=False)
        console.print(f"open {viewer.page}   (Ctrl-C ends it)")
    viewer.wait()


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
