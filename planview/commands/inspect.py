"""``planview inspect``."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from calib.camera import Camera
from calib.errors import InputError
from planview.commands.options import JsonFlag
from planview.commands.source import open_options
from stereo.readers import find_layout
from stereo.readers.base import AnyRecording, Layout, Reader, StereoRecording, Stream
from stereo.readers.times import rate_of_times


def inspect(
    recording: Path,
    *,
    calibration: Path | None = None,
    topics: str | None = None,
    fps: float | None = None,
    json_output: JsonFlag = False,
) -> None:
    """Say what a recording holds: layout, cameras, rates, gaps, calibration, and what is missing.

    Example: planview inspect recording.bag

    Parameters
    ----------
    recording
        Folder, video, bag or address of a recording.
    calibration
        Calibration file or folder, instead of the one in the recording.
    topics
        Topics of a bag, LEFT,RIGHT or IMAGE,DEPTH, where they are not clear from their names.
    fps
        Frames per second, in place of the recording's own times.
    json_output
        Print one JSON object.
    """
    reader, layout = find_layout(recording, open_options(calibration, fps, topics))
    found = _found(recording, reader, layout)
    if json_output:
        print(json.dumps(found, allow_nan=False))
    else:
        _show(found, Console(), reader.name)


def _found(path: Path, reader: Reader, layout: Layout) -> dict[str, Any]:
    """The ``--json`` object."""
    opened, missing = _opened(layout)
    cameras = [_camera(stream, layout.fps) for stream in layout.streams]
    durations = [camera["duration_s"] for camera in cameras if camera["duration_s"] is not None]
    return {
        "path": str(path),
        "reader": reader.key,
        "kind": layout.kind,
        "cameras": cameras,
        "frames": layout.n_frames,
        "unpaired": layout.unpaired,
        "fps": layout.fps,
        "duration_s": max(durations, default=layout.n_frames / layout.fps),
        "size": list(_size(opened, layout)),
        "calibration": None if opened is None else _calibration(opened),
        "floor": "world.toml" if opened is not None and _has_world(opened) else "to be found in the recording",
        "missing": missing,
        "notes": list(layout.notes),
    }


def _opened(layout: Layout) -> tuple[AnyRecording | None, list[str]]:
    try:
        return layout.open(), []
    except InputError as error:
        text = str(error)
        return None, [text if "--calibration" in text else f"{text} (--calibration FILE gives one)"]


def _camera(stream: Stream, nominal_fps: float) -> dict[str, Any]:
    rate = None if stream.times_s is None else rate_of_times(stream.times_s)
    return {
        "name": stream.name,
        "size": list(stream.size),
        "frames": stream.n_frames,
        "pixels": stream.pixels,
        "fps": rate.fps if rate else nominal_fps,
        "jitter_ms": rate.jitter_ms if rate else None,
        "duration_s": rate.duration_s if rate else None,
        "gaps": rate.gaps if rate else None,
        "dropped": rate.dropped if rate else None,
        "longest_gap_s": rate.longest_gap_s if rate else None,
    }


def _size(opened: AnyRecording | None, layout: Layout) -> tuple[int, int]:
    """Of the images that are tracked: squeezed halves are stretched."""
    return layout.streams[0].size if opened is None else _main_camera(opened).size


def _calibration(opened: AnyRecording) -> dict[str, Any]:
    camera = _main_camera(opened)
    found: dict[str, Any] = {
        "source": opened.rig.source if isinstance(opened, StereoRecording) else opened.source,
        "focal_px": camera.fx,
        "fov_deg": [_fov(camera.width, camera.fx), _fov(camera.height, camera.fy)],
        "lens": camera.model if camera.distortion and any(camera.distortion) else "none",
    }
    if isinstance(opened, StereoRecording):
        found["baseline_m"] = opened.rig.baseline_m
    return found


def _main_camera(opened: AnyRecording) -> Camera:
    return opened.rig.left if isinstance(opened, StereoRecording) else opened.camera


def _has_world(opened: AnyRecording) -> bool:
    pose = opened.world_SE3_left if isinstance(opened, StereoRecording) else opened.world_SE3_camera
    return pose is not None


def _fov(pixels: int, focal_px: float) -> float:
    """Full angle of view, of the pinhole without its distortion [degrees]."""
    return math.degrees(2.0 * math.atan(pixels / (2.0 * focal_px)))


def _show(found: dict[str, Any], console: Console, name: str) -> None:
    console.print(f"{escape(found['path'])}: {name}", highlight=False)
    table = Table()
    for title in ("camera", "size", "pixels", "frames", "fps", "jitter", "gaps"):
        table.add_column(title, justify="left" if title in ("camera", "pixels") else "right")
    for camera in found["cameras"]:
        table.add_row(*_camera_row(camera))
    console.print(table)
    facts = Table(show_header=False, box=None, pad_edge=False)
    facts.add_row("frames", _frames_text(found))
    facts.add_row("calibration", _calibration_text(found["calibration"]))
    facts.add_row("floor", found["floor"])
    for title, key in (("missing", "missing"), ("note", "notes")):
        for text in found[key]:
            facts.add_row(title, escape(text))
    if not found["missing"]:
        facts.add_row("next", escape(f"planview run {shlex.quote(found['path'])} --out out --rrd"))
    console.print(facts)


def _camera_row(camera: dict[str, Any]) -> list[str]:
    width, height = camera["size"]
    row = [escape(camera["name"]), f"{width}x{height}", camera["pixels"], str(camera["frames"])]
    if camera["jitter_ms"] is None:
        return [*row, f"{camera['fps']:.3f}", "-", "-"]
    gaps = f"{camera['gaps']} ({camera['dropped']} frames)" if camera["gaps"] else "none"
    return [*row, f"{camera['fps']:.3f}", f"{camera['jitter_ms']:.2f} ms", gaps]


def _frames_text(found: dict[str, Any]) -> str:
    alone = f", {found['unpaired']} without a mate" if found["unpaired"] else ""
    return f"{found['frames']} at {found['fps']:.3f} per second, {found['duration_s']:.2f} s{alone}"


def _calibration_text(calibration: dict[str, Any] | None) -> str:
    if calibration is None:
        return "missing"
    across, down = calibration["fov_deg"]
    baseline = f", baseline {calibration['baseline_m'] * 100:.2f} cm" if "baseline_m" in calibration else ""
    view = f"focal length {calibration['focal_px']:.1f} px{baseline}, view {across:.0f} x {down:.0f} degrees"
    return f"{view}, lens {calibration['lens']} ({escape(calibration['source'])})"
