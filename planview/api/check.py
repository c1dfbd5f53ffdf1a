"""Whether a recording can be trusted, and what it holds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Column, Table
from rich.text import Text

from calib.errors import InputError
from calib.io import parse_length
from calib.rig import save_rig
from calib.times import Rate, rate_of_times
from calib.world import load_rigs
from planview.api.arguments import Settings, in_range, opening, path_of, settings
from planview.checks.check import Check
from planview.checks.examine import Diagnosis, examine, write_pictures
from planview.engine.setup import floor_search
from planview.output.progress import as_text
from stereo.floor import PairFrames
from stereo.readers import OpenOptions, find_layout
from stereo.readers.base import Layout, Reader
from stereo.readers.images import Stream
from stereo.readers.open import is_multi_rig, rigs_file
from stereo.recording import StereoPair


@dataclass(frozen=True, eq=False)
class RecordingChecks:
    """Every check of a recording with its value and limit; printed, a verdict and a table.

    Attributes:
        files: pictures that were written.
        correction: of the calibration by the recording, in words; empty where there is nothing to correct, and then no
            file is written.
    """

    checks: tuple[Check, ...]
    files: tuple[Path, ...] = ()
    correction: str = ""

    @property
    def ok(self) -> bool:
        """Whether results can be trusted; warnings leave it true."""
        return not any(check.failed for check in self.checks)

    def __repr__(self) -> str:
        return as_text(self)

    def __rich__(self) -> RenderableType:
        return Group(*map(Text, verdict(self.checks)), _table(self.checks))

    def to_json(self) -> dict[str, Any]:
        """Plain values: ``ok`` and ``checks``."""
        return {"ok": self.ok, "checks": [check.to_json() for check in self.checks]}


@dataclass(frozen=True, eq=False)
class RecordingContents:
    """What a recording holds and what it lacks; printed, a table.

    Attributes:
        layout: what kind of recording it is.
        found: cameras, frames, rates, calibration, and what is missing, as plain values.
        missing: why a run would refuse it.
    """

    layout: str
    found: dict[str, Any]
    missing: tuple[InputError, ...]

    def __repr__(self) -> str:
        return as_text(self)

    def __rich__(self) -> RenderableType:
        sensors = self.found.get("sensors", [self.found])
        return Group(*(_listing(sensor, self.layout) for sensor in sensors))

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return self.found


def check(
    recording: Path | str,
    right: Path | str | None = None,
    *,
    quick: bool = False,
    calibration: Path | str | None = None,
    topics: str | None = None,
    fps: float | None = None,
    person_height: str | None = None,
    frames: int = 60,
    out: Path | str | None = None,
    corrected_rig: Path | str | None = None,
    config: Settings | None = None,
    set: Sequence[str] = (),
) -> RecordingChecks | RecordingContents:
    """Check a recording and its calibration before trusting results; exit status 1 when a check fails.

    Example: planview check recording --person-height 1.78m --out pictures

    Example of its contents only, without looking at its images: planview check recording.bag --quick

    Args:
        recording: Folder, video, bag or address of a recording; the left one of two videos or folders of images; or
            the folder of several sensors with rigs.toml, which must agree on where people are.
        right: The right one.
        quick: Only list what it contains: layout, cameras, rates, gaps, calibration, and what is missing.
        calibration: Calibration file or folder, instead of the recording's own; or camera.toml or Tsai XML of one
            camera.
        topics: Topics of a bag, LEFT,RIGHT or IMAGE,DEPTH, where they are not clear from their names.
        fps: Frames per second, where times are missing or wrong.
        person_height: Height of a person who walks through, e.g. 1.78m: checks baseline and units.
        frames: Consecutive frames to look at for movement, besides those in which a run measures its floor.
        out: Folder for pictures: rectified rows, disparity, floor, exposure.
        corrected_rig: Write the calibration as corrected by this recording to this file, for other recordings of the
            rig.
        config: TOML file with parameters of the later run: analysis.setup_frames and tables rectify, sgbm, range,
            floor.
        set: One parameter, e.g. ``set`` foreground.learning_rate=0.002; can be repeated.

    Returns:
        Every check; with ``quick`` what the recording holds.

    Raises:
        InputError: there is nothing that can be read, or nothing gives the times of its frames.
        WorkError: not one frame can be decoded.
    """
    path = Path(recording)
    options = opening(calibration, fps, topics, right)
    several = is_multi_rig(path)
    foreign = calibration or topics or right or corrected_rig
    if several and foreign is not None:
        raise InputError(f"{foreign}: expected none of it for {path}, whose sensors have their own")
    if quick and several:
        return _contents_of_sensors(path, options)
    if quick:
        try:
            reader, layout = find_layout(path, options)
        except InputError as error:
            if error.remedy != "tracker":
                raise
            found = f"found one camera in {path}, which is checked without it"
            raise InputError(f"expected a stereo pair or images with depth, {found}", argument="quick") from error
        return _contents(path, reader, layout)
    in_range("frames", frames, 4, 2000)
    known = None if person_height is None else _height(str(person_height))
    search = floor_search(settings(config, set))
    diagnosis = examine(path, options, frames=frames, person_height_m=known, search=search)
    files = []
    for name, each in {"": diagnosis, **diagnosis.sensors}.items():
        if out is not None and each.seen:
            files += write_pictures(each.seen, each.floor, Path(out) / name)
    return RecordingChecks(diagnosis.checks, tuple(files), _corrected(diagnosis, path_of(corrected_rig)))


def _corrected(diagnosis: Diagnosis, file: Path | None) -> str:
    """How the recording corrects the calibration, in words, written to the file; empty where it fits."""
    pair = diagnosis.seen if isinstance(diagnosis.seen, PairFrames) else None
    if pair is None or not pair.correction.is_applied.any():
        return ""
    if file is not None:
        rig = pair.correction(pair.plain.rig)
        save_rig(replace(rig, source=f"{rig.source}, {pair.correction}"), file)
    return str(pair.correction)


def verdict(checks: Sequence[Check]) -> list[str]:
    """Whether results can be trusted, then a sentence on each check beyond its limit, failures first."""
    failed = [check for check in checks if check.failed]
    warned = [check for check in checks if not check.ok and check.warns]
    warnings = f"{len(warned)} warning{'s' * (len(warned) != 1)}"
    lines = [*(f"failed: {c.sentence}" for c in failed), *(f"warning: {c.sentence}" for c in warned)]
    if failed:
        also = f" and {warnings}" if warned else ""
        first = f"Results of this recording cannot be trusted: {len(failed)} of {len(checks)} checks failed"
        return [f"{first}{also}.", *lines]
    if warned:
        return [f"Results can be used, with {warnings}.", *lines]
    unknown = [check.name for check in checks if check.is_unknown]
    also = f"; not measured: {', '.join(unknown)}" if unknown else ""
    return [f"Nothing wrong was found: {len(checks) - len(unknown)} checks passed{also}."]


def _table(checks: Sequence[Check]) -> Table:
    right = partial(Column, justify="right")
    result = Table("", "check", right("value"), right("limit"), "meaning")
    for check in checks:
        mark, style = ("ok", "green") if check.ok else ("warning", "yellow") if check.warns else ("NO", "bold red")
        value = f"{check.number_text or '-' * check.is_unknown} {check.unit if check.number_text else ''}".strip()
        result.add_row(Text(mark, style), check.name, value, check.limit_text, Text(check.note))
    return result


def _height(text: str) -> float:
    bare = text.strip().replace(".", "", 1).isdigit()
    height = parse_length(f"{text}m" if bare else text, "person_height=")
    in_range("person_height", height, 0.5, 2.5, " m")
    return height


def _contents(path: Path, reader: Reader, layout: Layout) -> RecordingContents:
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
    size = layout.streams[0].size
    calibration = None
    has_world = False
    if opened is not None:
        camera = opened.sensor.camera
        sensor = opened.sensor
        size = camera.size  # squeezed halves are stretched
        has_world = sensor.world_SE3_left is not None
        calibration = {
            "source": sensor.source,
            "focal_px": camera.fx,
            "fov_deg": [
                math.degrees(2.0 * math.atan(pixels / (2.0 * focal)))  # of the pinhole without its distortion
                for pixels, focal in ((camera.width, camera.fx), (camera.height, camera.fy))
            ],
            "lens": camera.model if camera.distortion and any(camera.distortion) else "none",
        } | ({"baseline_m": sensor.rig.baseline_m} if isinstance(sensor, StereoPair) else {})
    found = {
        "path": str(path),
        "reader": reader.key,
        "kind": layout.kind,
        "cameras": cameras,
        "frames": layout.n_frames,
        "unpaired": layout.unpaired,
        "fps": fps,
        "duration_s": max(durations, default=fps and layout.n_frames / fps),
        "size": list(size),
        "calibration": calibration,
        "floor": "world.toml" if has_world else "to be found in the recording",
        "missing": list(map(str, missing)),
        "notes": list(getattr(opened, "notes", layout.notes)),
    }
    return RecordingContents(reader.name, found, tuple(missing))


def _contents_of_sensors(path: Path, options: OpenOptions) -> RecordingContents:
    """What the recording of each sensor holds."""
    file = rigs_file(path)
    folders = [file.parent / entry.folder for entry in load_rigs(file)]
    sensors = [_contents(folder, *find_layout(folder, options)) for folder in folders]
    missing = tuple(error for sensor in sensors for error in sensor.missing)
    found = {"path": str(path), "reader": "sensors", "sensors": [sensor.found for sensor in sensors]}
    return RecordingContents("several sensors", found | {"missing": list(map(str, missing))}, missing)


def _camera(stream: Stream, nominal_fps: float | None) -> dict[str, Any]:
    rate = None if stream.times_s is None else rate_of_times(stream.times_s)
    known = asdict(rate) if rate else dict.fromkeys(field.name for field in fields(Rate)) | {"fps": nominal_fps}
    size = list(stream.size)
    return {"name": stream.name, "size": size, "frames": stream.n_frames, "pixels": stream.pixels, **known}


def _listing(found: dict[str, Any], name: str) -> RenderableType:
    right = partial(Column, justify="right")
    titles = "camera", right("size"), "pixels", right("frames"), right("fps"), right("jitter"), right("gaps")
    table = Table(*titles)
    for camera in found["cameras"]:
        jitter = "-"
        gaps = "-"
        if camera["jitter_ms"] is not None:
            jitter = f"{camera['jitter_ms']:.2f} ms"
            gaps = f"{camera['gaps']} ({camera['dropped']} frames)" if camera["gaps"] else "none"
        size = "x".join(map(str, camera["size"]))
        rate = f"{camera['fps']:.3f}" if camera["fps"] else "-"
        table.add_row(camera["name"], size, camera["pixels"], str(camera["frames"]), rate, jitter, gaps)
    alone = f", {found['unpaired']} without a mate" if found["unpaired"] else ""
    calibration = found["calibration"]
    text = "missing"
    if calibration is not None:
        across, down = calibration["fov_deg"]
        baseline = f", baseline {calibration['baseline_m'] * 100:.2f} cm" if "baseline_m" in calibration else ""
        text = (
            f"focal length {calibration['focal_px']:.1f} px{baseline}, view {across:.0f} x {down:.0f} degrees, "
            f"lens {calibration['lens']} ({calibration['source']})"
        )
    facts = Table(show_header=False, box=None, pad_edge=False)
    timed = f" at {found['fps']:.3f} per second, {found['duration_s']:.2f} s" if found["fps"] else ""
    facts.add_row("frames", f"{found['frames']}{timed}{alone}")
    facts.add_row("calibration", text)
    facts.add_row("floor", found["floor"])
    for title, lines in (("missing", found["missing"]), ("note", found["notes"])):
        for line in lines:
            facts.add_row(title, line)
    return Group(Text(f"{found['path']}: {name}"), table, facts)
