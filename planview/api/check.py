"""Whether a recording can be trusted, and what it holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calib.io import parse_length
from calib.rig import save_rig
from planview.api.arguments import Settings, in_range, opening, path_of, settings
from planview.api.contents import Contents, contents_of
from planview.api.result import Result, table_text
from planview.checks.check import Check
from planview.checks.examine import Diagnosis, examine
from planview.checks.pictures import write_pictures
from planview.engine.setup import floor_search
from stereo.floor import DepthFrames, PairFrames


def check(
    recording: Path | str,
    right: Path | str | None = None,
    *,
    quick: bool = False,
    calibration: Path | str | None = None,
    topics: str | None = None,
    fps: float | None = None,
    person_height: float | str | None = None,
    frames: int = 60,
    out: Path | str | None = None,
    corrected_rig: Path | str | None = None,
    config: Settings | None = None,
) -> Result[tuple[Check, ...]] | Result[Contents]:
    """Check a recording and its calibration: can I trust them?

    ```python
    found = planview.check("my_recording", person_height=1.78, out="pictures")
    print(found)
    assert found.ok  # no check failed; warnings leave it true
    planview.check("recording.bag", quick=True).to_json()["fps"]
    ```

    Args:
        recording: Folder, video, bag or address of a recording; the left one of two videos or folders of images; or
            the folder of several sensors with rigs.toml, which must agree on where people are.
        right: The right one.
        quick: Only list what it contains: layout, cameras, rates, gaps, calibration, and what is missing.
        calibration: Calibration file or folder, instead of the recording's own; or camera.toml or Tsai XML of one
            camera.
        topics: Topics of a bag, LEFT,RIGHT or IMAGE,DEPTH, where they are not clear from their names.
        fps: Frames per second, where times are missing or wrong.
        person_height: Height of a person who walks through, e.g. 1.78m: checks baseline and units. In Python also a
            float, in metres.
        frames: Consecutive frames to look at for movement, besides those in which a run measures its floor.
        out: Folder for pictures: rectified rows, disparity, floor, exposure.
        corrected_rig: Write the calibration as corrected by this recording to this file, for other recordings of the
            rig.
        config: TOML file with parameters of the later run: analysis.setup_frames and tables rectify, sgbm, range,
            floor. In Python also a dict of those that differ, or a Config.

    Returns:
        Every check; with ``quick`` what the recording holds, and ``ok`` whether a run would take it.

    Raises:
        InputError: there is nothing that can be read, or nothing gives the times of its frames.
        WorkError: not one frame can be decoded.
    """
    path = Path(recording)
    options = opening(calibration, fps, topics, right)
    if quick:
        found = contents_of(path, options)
        values = found.values | {"missing": [str(error) for error in found.missing]}
        return Result(found, values, found.cameras, ok=not found.missing)
    in_range("frames", frames, 4, 2000)
    if isinstance(person_height, str):
        person_height = parse_length(person_height, "person_height=")
    if person_height is not None:
        in_range("person_height", person_height, 0.5, 2.5, " m")
    search = floor_search(settings(config))
    diagnosis = examine(path, options, frames=frames, person_height_m=person_height, search=search)
    checks = diagnosis.checks
    rows = [check.to_json() for check in checks]
    correction = _correct(diagnosis.seen, path_of(corrected_rig))
    ok = not any(check.failed for check in checks)
    files = [] if out is None else _write_pictures(diagnosis, Path(out))
    text = "\n".join([*verdict(checks), _table(checks)])
    return Result(checks, {"ok": ok, "checks": rows, "correction": correction}, rows, files, ok, text)


def _write_pictures(diagnosis: Diagnosis, folder: Path) -> list[Path]:
    files = []
    for name, each in {"": diagnosis, **diagnosis.sensors}.items():
        if each.seen:
            files += write_pictures(each.seen, each.floor, folder / name)
    return files


def _correct(seen: PairFrames | DepthFrames | None, file: Path | None) -> str:
    """The correction of the calibration by the recording, in words, written to the file; empty where it fits."""
    if not isinstance(seen, PairFrames) or not seen.correction.is_applied.any():
        return ""
    if file is not None:
        rig = seen.correction(seen.plain.rig)
        save_rig(replace(rig, source=f"{rig.source}, {seen.correction}"), file)
    return str(seen.correction)


def verdict(checks: Sequence[Check]) -> list[str]:
    """Whether results can be trusted, then what explains it and a sentence on each check beyond its limit, failures
    first."""
    failed = [check for check in checks if check.failed]
    warned = [check for check in checks if not check.ok and check.warns]
    warnings = f"{len(warned)} warning{'s' * (len(warned) > 1)}"
    beyond = sorted([*failed, *warned], key=lambda check: check.name != "explanation")
    lines = [f"{'failed' if check.failed else 'warning'}: {check.sentence}" for check in beyond]
    if failed:
        also = f" and {warnings}" if warned else ""
        count = f"{len(failed)} of {len(checks)} checks failed{also}"
        return [f"Results of this recording cannot be trusted: {count}.", *lines]
    if warned:
        return [f"Results can be used, with {warnings}.", *lines]
    unknown = [check.name for check in checks if check.is_unknown]
    also = f"; not measured: {', '.join(unknown)}" if unknown else ""
    return [f"Nothing wrong was found: {len(checks) - len(unknown)} checks passed{also}."]


def _table(checks: Sequence[Check]) -> str:
    rows = []
    for check in checks:
        mark = "ok"
        if not check.ok:
            mark = "warning" if check.warns else "NO"
        value = f"{check.number_text} {check.unit}".strip() if check.number_text else "-" * check.is_unknown
        limit = check.limit_text if value else check.note
        rows.append({"": mark, "check": check.name, "value": value, "limit": limit})
    return table_text(rows)
