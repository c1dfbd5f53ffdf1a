"""What a run found out about a recording before its first frame, kept for the next run on the same recording."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ValidationError

from calib.errors import WorkError
from calib.io import write_whole
from calib.pose import SE3
from calib.rig import Floor, StereoRig
from planview.checks.check import Check
from planview.engine.config import Config
from planview.engine.setup import AnySetup, Setup, set_up, set_up_any
from stereo.matcher import disparity_range
from stereo.recording import Recording, RgbdRecording
from stereo.rectify import Rectifier
from stereo.row_offset import VerticalFit, VerticalModel


class _KeptFloor(BaseModel):
    """A ``Floor`` as JSON, whose numbers are read back bit for bit."""

    rotation: list[list[float]]
    translation: list[float]
    inlier_fraction: float
    residual_m: float
    covariance: list[list[float]] | None
    extent_m: tuple[float, float, float, float] | None


class _KeptSetup(BaseModel):
    """A ``Setup`` as JSON; the rectifier follows from calibration and row offset."""

    offset_px: float
    per_u: float
    per_v: float
    before_px: float
    after_px: float
    floor: _KeptFloor
    floor_source: str
    checks: list[Check]


class KeptSetup:
    """The file of one recording with one configuration in the user's cache.

    Args:
        key: of the recording's content, its calibration, the configuration and the version of the code.
        folder: where setups are kept; ``$XDG_CACHE_HOME`` or ``~/.cache``, below ``planview/setups``, when None.
    """

    def __init__(self, key: str, folder: Path | None = None) -> None:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        self.path = (folder or base / "planview" / "setups") / f"{key}.json"

    def load(self, rig: StereoRig, config: Config) -> Setup | None:
        """The setup of a rig's recording; None where none is kept, or what is kept cannot be read."""
        try:
            kept = _KeptSetup.model_validate_json(self.path.read_bytes())
            vertical = VerticalModel(kept.offset_px, kept.per_u, kept.per_v)
            f = kept.floor
            covariance = None if f.covariance is None else np.array(f.covariance)
            pose = SE3(np.array(f.rotation), np.array(f.translation))
            floor = Floor(pose, f.inlier_fraction, f.residual_m, covariance, f.extent_m)
        except (OSError, ValidationError, ValueError):
            return None
        rectifier = Rectifier(rig, config.rectify, vertical if vertical != VerticalModel() else None)
        fit = VerticalFit(vertical, before_px=kept.before_px, after_px=kept.after_px)
        searched = disparity_range(rectifier.geometry, config.range, floor)
        return Setup(rectifier, floor, searched, kept.floor_source, fit, checks=tuple(kept.checks))

    def save(self, setup: Setup) -> None:
        """Keep a setup; where the cache cannot be written, nothing is kept."""
        floor, fit = setup.floor, setup.vertical
        pose = floor.world_SE3_left
        kept = _KeptSetup(
            **asdict(fit.model),
            before_px=fit.before_px,
            after_px=fit.after_px,
            floor=_KeptFloor(
                rotation=pose.rotation.tolist(),
                translation=pose.translation.tolist(),
                inlier_fraction=float(floor.inlier_fraction),
                residual_m=float(floor.residual_m),
                covariance=None if floor.covariance is None else floor.covariance.tolist(),
                extent_m=floor.extent_m,
            ),
            floor_source=setup.floor_source,
            checks=list(setup.checks),
        )
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self.path, json.dumps(kept.model_dump()))
        except (OSError, WorkError):
            return


def set_up_kept(recording: Recording | RgbdRecording, config: Config, kept: KeptSetup | None) -> AnySetup:
    """What was kept of a recording, else what is found now (errors of ``set_up_any``)."""
    if kept is None or isinstance(recording, RgbdRecording):
        return set_up_any(recording, config)
    setup = kept.load(recording.rig, config)
    if setup is None:
        setup = set_up(recording, config)
        kept.save(setup)
    return setup
