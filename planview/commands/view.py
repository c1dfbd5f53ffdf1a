"""``planview view``."""

from __future__ import annotations

import subprocess
import sysconfig
from pathlib import Path

from calib.errors import InputError, WorkError
from calib.text import reason
from planview.commands.options import Flag
from planview.output.progress import PlainConsole
from planview.output.rerun.parts import quiet_environment, recorded_parts


def view(folder: Path, *, port: int = 9876, web: Flag = False, web_port: int = 9090) -> None:
    """Open a run in the rerun viewer, which listens on this machine only and sends no usage statistics.

    Example: planview view out

    Example on a machine without a display: planview view out --web; then, on yours, ssh -L 9090:127.0.0.1:9090 -L
    9876:127.0.0.1:9876 MACHINE, and open the address that it prints.

    Parameters
    ----------
    folder
        Output folder of a run made with --rrd, or an .rrd file.
    port
        Port of the viewer, or with --web of the data, on 127.0.0.1.
    web
        Serve the viewer to a browser instead of opening a window.
    web_port
        Port of the page, on 127.0.0.1.
    """
    parts = [folder] if folder.suffix == ".rrd" else recorded_parts(folder)
    if not parts or not parts[0].is_file():
        raise InputError(f"{folder / 'run.rrd'}: expected a rerun recording, found none; add --rrd to planview run")
    viewer = Path(sysconfig.get_path("scripts")) / "rerun"
    command = [str(viewer), "--bind", "127.0.0.1", "--port", str(port)]
    if web:
        command += ["--serve-web", "--web-viewer-port", str(web_port), "--server-memory-limit", "75%"]
        data = f"rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{port}%2Fproxy"
        PlainConsole(stderr=True, soft_wrap=True).print(
            f"open http://127.0.0.1:{web_port}/?url={data}   (Ctrl-C ends it)"
        )
    try:
        status = subprocess.run([*command, *map(str, parts)], check=False, env=quiet_environment()).returncode
    except OSError as error:
        raise WorkError(f"the rerun viewer cannot be started ({reason(error)}); is rerun-sdk installed?") from error
    if status != 0:
        hint = "is the port free?" if web else "it needs a display and a graphics driver; --web needs none"
        raise WorkError(f"the rerun viewer ended with status {status} ({hint})")
