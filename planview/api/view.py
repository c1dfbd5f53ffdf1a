"""A run in the rerun viewer."""

from __future__ import annotations

from pathlib import Path

from planview.output.viewer import PORT, WEB_PORT, open_viewer


def view(run: Path | str, *, port: int = PORT, web: bool = False, web_port: int = WEB_PORT) -> None:
    """Open a run in the rerun viewer.

    It listens on this machine only, sends no usage statistics, and is waited for until it is closed.

    ```python
    planview.view("out")
    ```

    Args:
        run: Folder of a run that wrote run.rrd, or an .rrd file.
        port: Port of the viewer, or with ``web`` of the data, on 127.0.0.1.
        web: Serve the viewer to a browser instead of opening a window.
        web_port: Port of the page, on 127.0.0.1.

    Raises:
        InputError: no recording for the viewer in the folder, or one that it cannot read.
        WorkError: there is no display, or the viewer cannot be started, or it failed.
    """
    open_viewer(Path(run), web=web, port=port, web_port=web_port).wait()
