"""``planview calibrate floor`` and ``human``: what they print."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from calib.people.calibration import HumanCalibration
from calib.rig import Floor
from planview.api import calibrate_pose as api
from planview.commands.options import say
from planview.commands.shell import JSON, Call, command


@command(api.floor, types={"points": Annotated[Sequence[str], Parameter(consume_multiple=True, negative="")]}, own=JSON)
def calibrate_floor(call: Call) -> None:
    floor, files = call()
    say(_sentence(floor))
    if floor.doubt:
        say(f"is that the floor? {floor.doubt} (--points gives another floor)")
    for path in files:
        say(f"wrote {path}")
    target = next((path for path in files if path != call["picture"] and path.suffix != ".png"), None)
    if target is None:
        say("no world.toml written: --save keeps this floor in the recording, --out FILE elsewhere")
    call.prints_json(_report(floor, target, next((path for path in files if path != target), None)))


def _sentence(floor: Floor) -> str:
    text = (
        f"camera {floor.height_m:.3f} m above the floor, tilt {math.degrees(floor.tilt_rad):.2f} and roll "
        f"{math.degrees(floor.roll_rad):.2f} degrees"
    )
    if math.isfinite(floor.inlier_fraction):
        text += f"; {floor.inlier_fraction:.0%} of the depth lies on it"
    if math.isfinite(floor.residual_m):
        text += f", {1000 * floor.residual_m:.0f} mm rms from it"
    if floor.covariance is not None:
        height, *angles = np.sqrt(floor.covariance.diagonal()).tolist()
        text += f"; height known to {100 * height:.1f} cm, angles to {math.degrees(max(angles)):.2f} degrees"
    return text


def _report(floor: Floor, target: Path | None, image: Path | None) -> dict[str, Any]:
    fit = {name: getattr(floor, name) for name in ("inlier_fraction", "residual_m")}
    values: dict[str, Any] = {
        "height_m": floor.height_m,
        "tilt_deg": math.degrees(floor.tilt_rad),
        "roll_deg": math.degrees(floor.roll_rad),
        **{name: value if math.isfinite(value) else None for name, value in fit.items()},
    }
    if floor.covariance is not None:
        height, tilt, roll = np.sqrt(floor.covariance.diagonal()).tolist()
        values |= {"height_std_m": height, "tilt_std_deg": math.degrees(tilt), "roll_std_deg": math.degrees(roll)}
    files = {name: path and str(path) for name, path in (("world", target), ("picture", image))}
    return {**values, "extent_m": floor.extent_m, **files}


@command(api.human, own=JSON)
def calibrate_human(call: Call) -> None:
    found, files = call()
    _summarise(found)
    say(f"wrote {files[0]} and {files[1]}")
    call.prints_json(_camera_report(found, files[0]))


def _summarise(found: HumanCalibration) -> None:
    camera = found.camera
    std = found.std
    say(
        f"camera {camera.height_m:.2f} m (+-{std.height * camera.height_m:.2f}) above the floor, tilt "
        f"{math.degrees(camera.tilt_rad):.1f} (+-{math.degrees(std.tilt_rad):.1f}) degrees, roll "
        f"{math.degrees(camera.roll_rad):.1f} (+-{math.degrees(std.roll_rad):.1f}), focal length {camera.focal_px:.0f} "
        f"(+-{std.focal * camera.focal_px:.0f}) px, lens {camera.lens}; error {found.error:.3f} over "
        f"{len(found.sample_errors)} samples, search {found.search_s:.2f} s"
    )
    if found.odd:
        say(f"samples that fit badly, look at them again: {', '.join(str(i + 1) for i in found.odd)}")
    if found.boxes_only:
        say("heads and feet are the middles of the boxes' edges: the focal length rests on the lens class")
    say(found.assessment.sentence)


def _camera_report(found: HumanCalibration, out: Path) -> dict[str, Any]:
    camera = found.camera
    std = found.std
    verdict = found.assessment
    following = verdict.next_sample
    return {
        "height_m": camera.height_m,
        "tilt_deg": math.degrees(camera.tilt_rad),
        "roll_deg": math.degrees(camera.roll_rad),
        "focal_px": camera.focal_px,
        "lens": camera.lens,
        "error": found.error,
        "height_std_m": std.height * camera.height_m,
        "tilt_std_deg": math.degrees(std.tilt_rad),
        "focal_std_px": std.focal * camera.focal_px,
        "roll_std_deg": math.degrees(std.roll_rad),
        "enough": verdict.enough,
        "floor_error_m": round(verdict.floor_error_m, 3) if math.isfinite(verdict.floor_error_m) else None,
        "verdict": verdict.sentence,
        "next_sample_px": None if following is None else [round(v, 1) for v in following.foot_px],
        "odd_samples": [i + 1 for i in found.odd],
        "sample_errors": [round(float(e), 4) for e in found.sample_errors],
        "samples": len(found.sample_errors),
        "boxes_only": found.boxes_only,
        "search_s": round(found.search_s, 3),
        "camera": str(out),
    }
