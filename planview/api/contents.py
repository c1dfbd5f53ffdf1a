"""What a recording holds: cameras, frames, rates and calibration, without looking at its images."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from calib.errors import InputError
from calib.times import Rate, rate_of_times
from calib.world import load_rigs
from planview.api.result import aligned, table_text
from stereo.readers import OpenOptions, find_layout
from stereo.readers.base import AnyRecording, Layout, Reader
from stereo.readers.images import Stream
from stereo.readers.open import is_multi_rig, rigs_file


@dataclass(frozen=True, eq=False)
class Contents:
    """What a recording holds and what it lacks.

    Attributes:
        layout: what kind of recording it is.
        values: cameras, frames, rates, calibration, and what is missing, as plain values.
        missing: why a run would refuse it.
        parts: the same of each of several sensors.
    """

    layout: str
    values: dict[str, Any]
    missing: tuple[InputError, ...]
    parts: tuple[Contents, ...] = ()

    @property
    def rows(self) -> Sequence[dict[str, Any]]:
        """Every camera."""
        return [camera for part in self.parts or [self] for camera in part.values["cameras"]]

    def text(self, sentence: Callable[[InputError], str] = str) -> str:
        """Tables in words; ``sentence``: of what is missing."""
        if self.parts:
            return "\n".join(part.text(sentence) for part in self.parts)
        values = self.values
        timed = f" at {values['fps']:.3f} per second, {values['duration_s']:.2f} s" if values["fps"] else ""
        alone = f", {values['unpaired']} without a mate" if values["unpaired"] else ""
        calibration = "missing" if values["calibration"] is None else _calibration_text(values["calibration"])
        facts = [
            ("frames", f"{values['frames']}{timed}{alone}"),
            ("calibration", calibration),
            ("floor", values["floor"]),
            *(("missing", sentence(error)) for error in self.missing),
            *(("note", note) for note in values["notes"]),
        ]
        cameras = table_text([_camera_cells(camera) for camera in values["cameras"]])
        return "\n".join([f"{values['path']}: {self.layout}", cameras, aligned(facts)])


def _camera_cells(camera: dict[str, Any]) -> dict[str, str]:
    cells = {
        "camera": camera["name"],
        "size": "x".join(map(str, camera["size"])),
        "pixels": camera["pixels"],
        "frames": str(camera["frames"]),
        "fps": f"{camera['fps']:.3f}" if camera["fps"] else "-",
        "jitter": "-",
        "gaps": "-",
    }
    if camera["jitter_ms"] is not None:
        cells["jitter"] = f"{camera['jitter_ms']:.2f} ms"
        cells["gaps"] = f"{camera['gaps']} ({camera['dropped']} frames)" if camera["gaps"] else "none"
    return cells


def _calibration_text(calibration: dict[str, Any]) -> str:
    across, down = calibration["fov_deg"]
    baseline = f", baseline {calibration['baseline_m'] * 100:.2f} cm" if "baseline_m" in calibration else ""
    return (
        f"focal length {calibration['focal_px']:.1f} px{baseline}, view {across:.0f} x {down:.0f} degrees, "
        f"lens {calibration['lens']} ({calibration['source']})"
    )


def contents_of(path: Path, options: OpenOptions) -> Contents:
    """What a recording holds, of several sensors each. Raises InputError: nothing that can be read, or one camera."""
    if is_multi_rig(path):
        file = rigs_file(path)
        folders = [file.parent / entry.folder for entry in load_rigs(file)]
        parts = tuple(_contents(folder, *find_layout(folder, options)) for folder in folders)
        missing = tuple(error for part in parts for error in part.missing)
        values = {"path": str(path), "reader": "sensors", "sensors": [part.values for part in parts]}
        return Contents("several sensors", values | {"missing": list(map(str, missing))}, missing, parts)
    try:
        return _contents(path, *find_layout(path, options))
    except InputError as error:
        if error.remedy != "tracker":
            raise
        found = f"found one camera in {path}, which is checked without it"
        raise InputError(f"expected a stereo pair or images with depth, {found}", argument="quick") from error


def _contents(path: Path, reader: Reader, layout: Layout) -> Contents:
    opened = None
    missing = list[InputError]()
    try:
        opened = layout.open()
    except InputError as error:
        error.remedy = error.remedy or "calibration"
        missing = [error]
    fps = layout.clock.fps if math.isfinite(layout.clock.fps) else None
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
        "size": list(layout.streams[0].size if opened is None else opened.sensor.camera.size),  # halves are stretched
        "calibration": None if opened is None else _calibration(opened),
        "floor": "world.toml" if has_world else "to be found in the recording",
        "missing": list(map(str, missing)),
        "notes": list(layout.notes if opened is None else opened.notes),
    }
    return Contents(reader.name, values, tuple(missing))


def _calibration(recording: AnyRecording) -> dict[str, Any]:
    sensor = recording.sensor
    camera = sensor.camera
    halves = (camera.width / (2.0 * camera.fx), camera.height / (2.0 * camera.fy))
    return {
        "source": sensor.source,
        "focal_px": camera.fx,
        "fov_deg": [math.degrees(2.0 * math.atan(half)) for half in halves],  # of the pinhole without its distortion
        "lens": camera.model if camera.distortion and any(camera.distortion) else "none",
        **sensor.lengths_m,
    }


def _camera(stream: Stream, nominal_fps: float | None) -> dict[str, Any]:
    measured = None if stream.times_s is None else rate_of_times(stream.times_s)
    rate = dict.fromkeys(field.name for field in fields(Rate)) | {"fps": nominal_fps}
    if measured is not None:
        rate = asdict(measured)
    size = list(stream.size)
    return {"name": stream.name, "size": size, "frames": stream.n_frames, "pixels": stream.pixels, **rate}
