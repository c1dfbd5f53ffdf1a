"""Cameras whose pixels rules may be given in."""

from __future__ import annotations

from pathlib import Path

from calib.errors import InputError
from calib.formats import load_rig
from calib.world import load_world
from planview.counting.geometry import RulePlane
from stereo.depth import StereoFloorCamera
from stereo.rectify import RectifyParams, common_geometry


def stereo_plane(rig_path: Path, world_path: Path | None = None) -> RulePlane:
    """The plane of a rig: its calibration, and world.toml beside it unless given.

    Raises:
        InputError: no rig or no world.toml there.
    """
    rig = load_rig(rig_path)
    folder = rig_path if rig_path.is_dir() else rig_path.parent
    world = world_path or folder / "world.toml"
    if not world.is_file():
        raise InputError(f"{world}: expected the pose of the rig (planview calibrate floor writes it), found no file")
    params = RectifyParams()
    geometry = common_geometry(rig, rig.rectifying_rotations()[0], params.working_px, params.field_quantile)
    return RulePlane(StereoFloorCamera(geometry, load_world(world).world_SE3_left))
