"""What a recording holds: cameras, frames, rates and calibration, without looking at its images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, NamedTuple

from calib.errors import InputError
from calib.times import Rate, rate_of_times
from planview.api.result import plain_values
from stereo.readers import OpenOptions, find_layout
from stereo.readers.base import AnyRecording
from stereo.readers.images import Stream
from stereo.readers.open import sensor_folders


class Contents(NamedTuple):
    """Cameras, frames, rates and calibration of a recording, and why a run would refuse it."""

    values: dict[str, Any]
    missing: Sequence[InputError]

    @property
    def cameras(self) -> list[dict[str, Any]]:
        """Those of all sensors."""
        return [camera for sensor in self.values.get("sensors", [self.values]) for camera in sensor["cameras"]]


def contents_of(path: Path, options: OpenOptions) -> Contents:
    """What a recording holds, of several sensors each. Raises InputError: nothing that can be read, or one camera."""
    try:
        parts = [_contents(folder, options) for folder in sensor_folders(path, options.calibration)]
        if not parts:
            return _contents(path, options)
    except InputError as error:
        if error.remedy != "tracker":
            raise
        found = f"found one camera in {path}, which is checked without it"
        raise InputError(f"expected a stereo pair or images with depth, {found}", argument="quick") from error
    sensors = [part.values for part in parts]
    values = {"path": str(path), "reader": "sensors", "sensors": sensors}
    return Contents(values, [error for part in parts for error in part.missing])


def _contents(path: Path, options: OpenOptions) -> Contents:
    reader, layout = find_layout(path, options)
    opened = None
    missing = list[InputError]()
    try:
        opened = layout.open()
    except InputError as error:
        error.remedy = error.remedy or "calibration"
        missing = [error]
    fps = layout.clock.fps if layout.clock.fps > 0 else None
    if fps is None:
        missing.append(InputError(f"{path}: the frames have no times, and there is no timestamps.csv", remedy="fps"))
    cameras = [_camera(stream, fps) for stream in layout.streams]
    durations = [camera["duration_s"] for camera in cameras if camera["duration_s"] is not None]
    has_world = opened is not None and opened.sensor.world_SE3_left is not None
    values = {
        "path": str(path),
        "reader": reader.key,
        "kind": layout.kind,
        "cameras": cameras,
        "frames": layout.n_frames,
        "unpaired": layout.unpaired,
        "fps": fps,
        "duration_s": max(durations, default=fps and layout.n_frames / fps),
        "size": layout.streams[0].size if opened is None else opened.sensor.camera.size,  # halves are stretched
        "calibration": None if opened is None else _calibration(opened),
        "floor": "world.toml" if has_world else "to be found in the recording",
        "notes": list(layout.notes if opened is None else opened.notes),
    }
    return Contents(values, missing)


def _calibration(recording: AnyRecording) -> dict[str, Any]:
    sensor = recording.sensor
    camera = sensor.camera
    halves = (camera.width / (2.0 * camera.fx), camera.height / (2.0 * camera.fy))
    return {
        "source": sensor.source,
        "focal_px": camera.fx,
        "fov_deg": [math.degrees(2.0 * math.atan(half)) for half in halves],  # of the pinhole without its distortion
        "lens": camera.model if any(camera.distortion or ()) else "none",
        **sensor.lengths_m,
    }


def _camera(stream: Stream, nominal_fps: float | None) -> dict[str, Any]:
    measured = None if stream.times_s is None else rate_of_times(stream.times_s)
    rate = dict.fromkeys(field.name for field in fields(Rate)) | {"fps": nominal_fps}
    if measured:
        rate = asdict(measured)
    return plain_values(stream, "name", "size", "pixels") | {"frames": stream.n_frames, **rate}
