"""``planview view``."""

from __future__ import annotations

import subprocess
import sysconfig
from pathlib import Path

from calib.errors import InputError, WorkError


def view(folder: Path, *, port: int = 9876) -> None:
    """Open a run in the rerun viewer, which listens on this machine only.

    Example: planview view out

    Parameters
    ----------
    folder
        Output folder of a run made with --rrd, or an .rrd file.
    port
        Port of the viewer on 127.0.0.1.
    """
    recording = folder if folder.suffix == ".rrd" else folder / "run.rrd"
    if not recording.is_file():
        raise InputError(f"{recording}: expected a rerun recording, found none; add --rrd to planview run")
    viewer = Path(sysconfig.get_path("scripts")) / "rerun"
    command = [str(viewer), "--bind", "127.0.0.1", "--port", str(port), str(recording)]
    try:
        status = subprocess.run(command, check=False).returncode
    except OSError as error:
        raise WorkError(f"the rerun viewer cannot be started ({error.strerror}); is rerun-sdk installed?") from error
    if status != 0:
        raise WorkError(f"the rerun viewer ended with status {status} (it needs a display and a graphics driver)")
