"""The static scene of a run, or of a recording that was not run."""

from __future__ import annotations

from pathlib import Path

from calib.errors import InputError
from planview.engine.config import Config, config_of
from planview.engine.scene_cloud import SceneCloud, scene_cloud
from planview.engine.setup import set_up_any
from planview.output.info import read_run_info
from planview.output.scene.source import source_of
from stereo.readers import OpenOptions, holds_pair, open_any


def scene_of(path: Path, options: OpenOptions | None = None) -> SceneCloud:
    """Points of what does not move, in the world frame of the run's tracks.

    Args:
        path: folder of a run, whose recording and configuration are taken, or a recording of one stereo head.
        options: how the recording is opened.
    Raises:
        InputError: no recording of a pair or of images with depth.
        WorkError: no floor is visible.
    """
    config, recording = Config(), path
    if (path / "run.json").is_file():
        info = read_run_info(path / "run.json")
        config, recording = config_of(info.config, str(path / "run.json")), source_of(info)
    calibration = options.calibration if options else None
    if not recording.exists() or not (calibration or holds_pair(recording)):
        raise InputError(f"{recording}: expected a recording of a stereo pair or of images with depth, found none")
    opened = open_any(recording, options)
    return scene_cloud(opened, set_up_any(opened, config), config)
