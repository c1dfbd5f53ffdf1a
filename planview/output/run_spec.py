"""Specification of a run, and what makes it the same run as another one."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from calib.errors import InputError
from planview.counting.rules import RulePlane, load_rules
from planview.counting.stream import Analytics
from planview.engine.engine import Engine
from planview.output import resume
from planview.output.folder import HoldsResultsError, RunInfo, check_folder, refuse_held


@dataclass(frozen=True)
class RunSpec:
    """Frames that a run tracks, and what it writes.

    Raises InputError: wishes that exclude each other.
    """

    out: Path | None = None
    """Folder for the results; None for tracks in memory alone."""
    first_frame: int = 0
    """Frame of the recording to begin with, as if it were the first: the background is learned from it on."""
    last_frame: int | None = None
    """Last frame of the recording to track; None for all."""
    rules: Path | None = None
    """rules.toml with what is counted while tracking."""
    strict: bool = False
    """Refuse a recording that fails a check instead of warning."""
    refine: bool = False
    maps: bool = False
    rrd_every: int = 0
    """Images of every n-th frame go into run.rrd; 0 for no run.rrd."""
    report: bool = False
    overwrite: bool = False
    resume: bool = False
    checkpoint_every_s: float = 0.0
    """Time between two checkpoints [s]; 0 for none."""

    def __post_init__(self) -> None:
        if self.resume and self.overwrite:
            raise InputError("resume and overwrite cannot be combined")
        if self.out is None:
            needing = {"rules": self.rules, "rrd": self.rrd_every, "maps": self.maps, "resume": self.resume}
            given = [name for name, value in needing.items() if value]
            if given:
                raise InputError(f"{' and '.join(given)} need a folder for the results", remedy="out")

    @property
    def folder(self) -> Path:
        """Folder for the results of a run that writes any."""
        return self.out or Path()

    @property
    def log_names(self) -> list[str]:
        """Classes of the logs that take every frame."""
        return ["MapsLog"] * self.maps + ["RerunLog"] * (self.rrd_every > 0)

    def refuse_folder(self, recording: Path | None = None) -> None:
        """Raise InputError for a folder that cannot take the results (``check_folder``), before any work is done."""
        if self.out is None:
            return
        refuse_held(self.out)
        try:
            check_folder(self.out, self.overwrite or self.resume, recording)
        except HoldsResultsError as error:
            raise InputError(f"{error}; choose another folder or pass overwrite=True") from error

    def n_frames(self, announced: int) -> int | None:
        """Number of frames that are tracked of a recording that announces some, or 0; None where that is open. Raises
        InputError: it ends before the first one."""
        if announced and self.first_frame >= announced:
            raise InputError(f"the recording has only {announced} frames, 0 to {announced - 1}", argument="frames")
        ends = [announced] if announced else []
        if self.last_frame is not None:
            ends.append(self.last_frame + 1)
        return min(ends) - self.first_frame if ends else None

    def analytics(self, engine: Engine) -> Analytics | None:
        """Counter for the time of tracking. Raises InputError: rules that do not fit the camera."""
        if self.rules is None:
            return None
        plane = RulePlane(engine.camera, engine.size, has_floor=engine.camera is not None)
        return Analytics(load_rules(self.rules, plane))

    def info(self, engine: Engine) -> RunInfo:
        """run.json before the first frame."""
        recording = engine.recording
        path = recording.path
        return RunInfo(
            input=os.fspath(path),
            recording=os.fspath(path.resolve()) if path.exists() else "",
            opened=recording.options.resolve(),
            notes=list(recording.notes),
            size_px=engine.size,
            fps=recording.fps,
            plane="floor" if engine.camera is not None else "image",
            rig=engine.camera_info(),
            floor=engine.floor_info(),
            tracker=engine.tracker_name,
            own_parts={role: resume.part_name(part) for role, part in engine.own_parts.items()},
            first_frame=self.first_frame,
            config=engine.config.model_dump(mode="json"),
            started_at=datetime.now(UTC).astimezone().isoformat(timespec="seconds"),
            versions=resume.library_versions(),
        )

    def identity(self, engine: Engine) -> dict[str, dict[str, Any]]:
        """All that decides the tracks of a run, as JSON. Raises UnidentifiedError: a part or a recording that cannot be
        told from another one."""
        recording = engine.recording
        resume.refuse_unidentified(engine)
        identity = resume.known_identity(self.info(engine))
        identity["version"] = resume.library_versions() | {"planview": resume.code_version()}
        identity["recording"] |= {
            "images": resume.content_key(recording.path, recording.files),
            "calibration": resume.key_of(recording.identity),
            "frames": recording.n_frames,
        }
        identity["settings"] |= {"rules": "", "logs": sorted(self.log_names)}
        counts = self.analytics(engine)
        if counts is not None:
            rules = {"rules": replace(counts.rules, source=""), "params": counts.params}
            identity["settings"]["rules"] = resume.key_of(rules)
        return identity
