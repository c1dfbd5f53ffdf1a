"""All checks on one recording."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.errors import InputError
from planview.checks.alignment import alignment_checks
from planview.checks.check import Check
from planview.checks.evidence import RecordingEvidence, RgbdEvidence, gather, gather_rgbd
from planview.checks.exposure import image_checks, light_checks
from planview.checks.people import people_checks
from planview.checks.scene import scene_checks
from planview.checks.timing import clock_checks, timing_checks
from stereo.floor import FloorSearch
from stereo.readers import OpenOptions, open_any
from stereo.readers.base import StereoRecording


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found.

    Attributes:
        checks: every question and its answer.
        evidence: what they looked at; None when the recording could not even be opened.
    """

    checks: tuple[Check, ...]
    evidence: RecordingEvidence | RgbdEvidence | None

    @property
    def ok(self) -> bool:
        return all(check.ok for check in self.checks)

    def to_json(self) -> dict[str, Any]:
        """The ``--json`` object of ``planview doctor``: ``ok`` and ``checks``."""
        return {"ok": self.ok, "checks": [check.to_json() for check in self.checks]}


def examine(
    path: Path,
    calibration: Path | None = None,
    *,
    frames: int = 60,
    person_height_m: float | None = None,
    search: FloorSearch | None = None,
) -> Diagnosis:
    """Examine a recording of a pair or of images with depth; of the latter the checks of a pair are skipped.

    A recording that is there but is refused (its calibration or its layout) fails the check "calibration and layout"
    with the reason, and nothing else is asked.

    Args:
        frames: consecutive frames to look at for movement, besides some spread over the recording.
        person_height_m: height of the people in it, when known: checks baseline and units.
        search: how a run looks for the floor, with the defaults of a run when None.
    Raises:
        InputError: there is nothing at that path.
        WorkError: not one frame can be decoded.
    """
    if not path.exists():
        raise InputError(f"{path}: expected a recording (folder or video), found nothing there")
    try:
        recording = open_any(path, OpenOptions(calibration))
    except InputError as error:
        return Diagnosis((Check("calibration and layout", False, 0.0, note=str(error)),), None)
    if not isinstance(recording, StereoRecording):
        return _examine_rgbd(gather_rgbd(recording, frames, search), person_height_m)
    evidence = gather(recording, frames, search)
    checks = [
        Check("calibration and layout", True, 1.0, note=evidence.recording.rig.source),
        *timing_checks(evidence),
        *image_checks(evidence.spread),
        *alignment_checks(evidence.plain, evidence.matches, evidence.vertical),
        *scene_checks(evidence),
        *people_checks(evidence, person_height_m),
    ]
    return Diagnosis(tuple(checks), evidence)


def _examine_rgbd(evidence: RgbdEvidence, person_height_m: float | None) -> Diagnosis:
    skipped = "skipped: images with depth have no left and right camera whose rows and order could be compared"
    checks = [
        Check("calibration and layout", True, 1.0, note=evidence.recording.source),
        *clock_checks(evidence),
        *light_checks([f.image for f in evidence.spread]),
        Check("alignment of a pair", True, math.nan, note=skipped),
        *scene_checks(evidence),
        *people_checks(evidence, person_height_m),
    ]
    return Diagnosis(tuple(checks), evidence)
