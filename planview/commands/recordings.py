"""``planview check``: what a recording holds, and whether it can be trusted."""

from __future__ import annotations

import json
import math
import shlex
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from cyclopts import Parameter
from rich.markup import escape
from rich.table import Column, Table

from calib.errors import InputError, WorkError
from calib.io import parse_length
from calib.rig import save_rig
from planview.checks.examine import Diagnosis, examine, write_pictures
from planview.commands.options import Flag, FrameRate, JsonFlag, Topics, in_range, open_options, plural, say, typed
from planview.engine.config import load_config
from planview.engine.setup import floor_search
from planview.output.progress import PlainConsole
from stereo.floor import PairFrames
from stereo.readers import find_layout
from stereo.readers.base import Layout, Reader
from stereo.readers.images import Stream
from stereo.readers.times import Rate, rate_of_times
from stereo.recording import Pair


@Parameter(name="*")
@dataclass(frozen=True)
class CheckOptions:
    """What is looked at, and what is written."""

    quick: Flag = False
    """Only list what it contains: layout, cameras, rates, gaps, calibration, and what is missing."""
    calibration: Path | None = None
    """Calibration file or folder, instead of the recording's own; or camera.toml or Tsai XML of one camera."""
    topics: Topics = None
    fps: FrameRate = None
    person_height: str | None = None
    """Height of a person who walks through, e.g. 1.78m: checks baseline and units."""
    frames: int = 60
    """Consecutive frames to look at for movement, besides those in which a run measures its floor."""
    out: Path | None = None
    """Folder for pictures: rectified rows, disparity, floor, exposure."""
    corrected_rig: Path | None = None
    """Write the calibration as corrected by this recording to this file, for other recordings of the rig."""
    config: Path | None = None
    """TOML file with parameters of the later run: analysis.setup_frames and tables rectify, sgbm, range, floor."""
    json_output: JsonFlag = False


def check(recording: Path, right: Path | None = None, /, *, options: CheckOptions = CheckOptions()) -> None:
    """Check a recording and its calibration before trusting results; exit status 1 when a check fails.

    Example: planview check recording --person-height 1.78m --out pictures

    Example of its contents only, without looking at its images: planview check recording.bag --quick

    Parameters
    ----------
    recording
        Folder, video, bag or address of a recording; or the left one of two videos or folders of images.
    right
        The right one.
    """
    opening = open_options(options.calibration, options.fps, options.topics, right)
    if options.quick:
        reader, layout = find_layout(recording, opening)
        found = _found(recording, reader, layout)
        if options.json_output:
            print(json.dumps(found, allow_nan=False))
        else:
            _show(found, reader.name)
        return
    in_range("--frames", options.frames, 4, 2000)
    known = None if options.person_height is None else _height(options.person_height)
    search = floor_search(load_config(options.config))
    diagnosis = examine(recording, opening, frames=options.frames, person_height_m=known, search=search)
    if options.json_output:
        print(json.dumps(diagnosis.to_json(), allow_nan=False))
    else:
        for line in verdict(diagnosis):
            PlainConsole(soft_wrap=True).print(line, highlight=False)
        PlainConsole(markup=True).print(table(diagnosis))
    if options.out is not None:
        written = write_pictures(diagnosis.seen, diagnosis.floor, options.out) if diagnosis.seen else []
        lines = [f"wrote {path}" for path in written] or [f"{options.out}: no pictures, which show a pair or depth"]
        say("\n".join(lines))
    _correct(recording, diagnosis.seen if isinstance(diagnosis.seen, PairFrames) else None, options.corrected_rig)
    failed = [check.name for check in diagnosis.checks if check.failed]
    if failed:
        raise WorkError(f"{recording}: {len(failed)} of {len(diagnosis.checks)} checks failed: {', '.join(failed)}")


def _correct(recording: Path, pair: PairFrames | None, corrected_rig: Path | None) -> None:
    """Write the calibration as the recording corrects it where a file is named, else print how; nothing where it fits.
    Raises WorkError: a file is named, and there is nothing to correct."""
    if pair is None or not pair.correction.is_applied.any():
        if corrected_rig is not None:
            why = pair.correction if pair else "no pair"
            raise WorkError(f"{recording}: nothing to write to {corrected_rig}: {why}")
        return
    text = f"planview check {shlex.quote(str(recording))} --corrected-rig rig.toml writes the corrected calibration"
    if corrected_rig is not None:
        rig = pair.correction(pair.plain.rig)
        save_rig(replace(rig, source=f"{rig.source}, {pair.correction}"), corrected_rig)
        text = f"wrote {corrected_rig}"
    say(f"{pair.correction}: {text}")


def verdict(diagnosis: Diagnosis) -> list[str]:
    """Whether results can be trusted, then a sentence on each check beyond its limit, failures first."""
    failed = [check for check in diagnosis.checks if check.failed]
    warned = [check for check in diagnosis.checks if not check.ok and check.warns]
    warnings = plural(len(warned), "warning") if warned else ""
    lines = [*(f"failed: {c.sentence}" for c in failed), *(f"warning: {c.sentence}" for c in warned)]
    if failed:
        also = f" and {warnings}" if warned else ""
        first = f"Results of this recording cannot be trusted: {len(failed)} of {len(diagnosis.checks)} checks failed"
        return [f"{first}{also}.", *lines]
    if warned:
        return [f"Results can be used, with {warnings}.", *lines]
    unknown = [check.name for check in diagnosis.checks if not math.isfinite(check.value)]
    also = f"; not measured: {', '.join(unknown)}" if unknown else ""
    return [f"Nothing wrong was found: {len(diagnosis.checks) - len(unknown)} checks passed{also}."]


def table(diagnosis: Diagnosis) -> Table:
    """The checks as a table for people."""
    right = partial(Column, justify="right")
    result = Table("", "check", right("value"), right("limit"), "meaning")
    for check in diagnosis.checks:
        mark = "[green]ok[/]" if check.ok else "[yellow]warning[/]" if check.warns else "[bold red]NO[/]"
        number = f"{check.value:,.0f}" if check.value >= 1000 else f"{check.value:.3g}"
        value = f"{number} {check.unit}".strip() if math.isfinite(check.value) else "-"
        result.add_row(mark, check.name, value, check.limit_text, escape(check.note))
    return result


def _height(text: str) -> float:
    bare = text.strip().replace(".", "", 1).isdigit()
    height = parse_length(f"{text}m" if bare else text, "--person-height")
    in_range("--person-height", height, 0.5, 2.5, " m")
    return height


def _found(path: Path, reader: Reader, layout: Layout) -> dict[str, Any]:
    """The ``--json`` object of what a recording holds."""
    opened, missing = None, []
    try:
        opened = layout.open()
    except InputError as error:
        error.remedy = error.remedy or "calibration"
        missing = [typed(error)]
    fps = layout.clock.fps if math.isfinite(layout.clock.fps) else None
    if fps is None:
        missing.append(f"{path}: the times of the frames; use --fps, or add a timestamps.csv")
    cameras = [_camera(stream, fps) for stream in layout.streams]
    durations = [camera["duration_s"] for camera in cameras if camera["duration_s"] is not None]
    size, calibration, has_world = layout.streams[0].size, None, False
    if opened is not None:
        camera, head = opened.head.camera, opened.head
        size, has_world = camera.size, head.world_SE3_left is not None  # squeezed halves are stretched
        calibration = {
            "source": head.source,
            "focal_px": camera.fx,
            "fov_deg": [
                math.degrees(2.0 * math.atan(pixels / (2.0 * focal)))  # of the pinhole without its distortion
                for pixels, focal in ((camera.width, camera.fx), (camera.height, camera.fy))
            ],
            "lens": camera.model if camera.distortion and any(camera.distortion) else "none",
        } | ({"baseline_m": head.rig.baseline_m} if isinstance(head, Pair) else {})
    return {
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
        "missing": missing,
        "notes": list(getattr(opened, "notes", layout.notes)),
    }


def _camera(stream: Stream, nominal_fps: float | None) -> dict[str, Any]:
    rate = None if stream.times_s is None else rate_of_times(stream.times_s)
    known = asdict(rate) if rate else dict.fromkeys(field.name for field in fields(Rate)) | {"fps": nominal_fps}
    size = list(stream.size)
    return {"name": stream.name, "size": size, "frames": stream.n_frames, "pixels": stream.pixels, **known}


def _show(found: dict[str, Any], name: str) -> None:
    console, right = PlainConsole(highlight=False), partial(Column, justify="right")
    console.print(f"{found['path']}: {name}")
    titles = "camera", right("size"), "pixels", right("frames"), right("fps"), right("jitter"), right("gaps")
    table = Table(*titles)
    for camera in found["cameras"]:
        jitter, gaps = "-", "-"
        if camera["jitter_ms"] is not None:
            jitter = f"{camera['jitter_ms']:.2f} ms"
            gaps = f"{camera['gaps']} ({camera['dropped']} frames)" if camera["gaps"] else "none"
        size, rate = "x".join(map(str, camera["size"])), f"{camera['fps']:.3f}" if camera["fps"] else "-"
        table.add_row(camera["name"], size, camera["pixels"], str(camera["frames"]), rate, jitter, gaps)
    console.print(table)
    alone = f", {found['unpaired']} without a mate" if found["unpaired"] else ""
    calibration, text = found["calibration"], "missing"
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
    if not found["missing"]:
        facts.add_row("next", f"planview run {shlex.quote(found['path'])} --out out --rrd")
    console.print(facts)
