"""Where a run's recording is."""

from __future__ import annotations

from pathlib import Path

from planview.output.info import RunInfo, read_run_info

MAPS_OF_MAPS = 4
"""Plan-view recordings are followed so far back to the recording with the images."""


def source_of(info: RunInfo) -> Path:
    """The recording with the images: of maps.h5 that of the run that wrote it, as far as it tells."""
    path = Path(info.input)
    for _ in range(MAPS_OF_MAPS):
        beside = path.parent / "run.json"
        if not (path.is_file() and beside.is_file()):
            break
        from planview.maps.recording import is_maps  # brings HDF5

        if not is_maps(path):
            break
        path = Path(read_run_info(beside).input)
    return path
