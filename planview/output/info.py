"""``run.json``: what a run read, with which settings, and how it went."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, JsonValue, ValidationError

from calib.errors import InputError, WorkError
from calib.io import reason, write_whole
from calib.params import first_problem
from planview.engine.info import CameraInfo, FloorInfo, InfoPart


class SkippedFrame(InfoPart):
    """A frame that could not be used."""

    index: int
    """Frame, from 0."""
    why: str


class RunWarning(InfoPart):
    """A check of the recording that failed before or during the run."""

    name: str
    """As ``planview doctor`` calls it."""
    value: float | None = None
    """What was found; None when it could not be measured."""
    unit: str = ""
    text: str
    """What was expected and found, in one sentence."""


class PaceInfo(InfoPart):
    """How a run in real time kept up (``planview run --pace``).

    Latency is the time from the moment that a frame's timestamp says to its tracks in tracks.csv.
    """

    frames_dropped: int = 0
    """Frames that were due while earlier ones were tracked, and gave way to newer ones."""
    latency_median_ms: float | None = None
    """None before the first frame, as are the two others; of an even sample of at most 4096 frames."""
    latency_95_ms: float | None = None
    """95 % of the frames are not later [ms]."""
    latency_99_ms: float | None = None
    """99 % of the frames are not later [ms]."""


class RunInfo(InfoPart):
    """All of run.json. Every field has a default, so that a page can be made of what there is."""

    input: str = ""
    """The recording as given."""
    tracker: str = ""
    """"template", "human-model" or "ellipse-particle"."""
    state: Literal["", "running", "interrupted", "finished"] = ""
    """How the run stands: "running" while it runs, and after it was killed; "interrupted" when it was stopped or
    failed; empty in files of versions that did not say."""
    finished: bool = False
    """The run came to its end; false while it runs and when it was interrupted."""
    started_at: str = ""
    """ISO 8601 time with zone."""
    elapsed_s: float = 0.0
    versions: dict[str, str] = Field(default_factory=dict)
    """planview, Python and the libraries that matter."""
    config: dict[str, JsonValue] = Field(default_factory=dict)
    """The full effective configuration, a table per stage."""
    refined: bool = False
    """tracks.csv was refined after the run (``planview refine``); tracks_online.csv holds what was tracked online."""
    frames_read: int = 0
    frames_skipped: int = 0
    skipped: list[SkippedFrame] = Field(default_factory=list)
    """The skipped frames (the first 1000) and why."""
    notes: list[str] = Field(default_factory=list)
    """What the reader of the recording assumed, mended or missed, and the size of people that a tracker learned, a
    sentence each."""
    rig: CameraInfo | None = None
    floor: FloorInfo | None = None
    stages_ms: dict[str, float | None] = Field(default_factory=dict)
    """Median time of every stage per frame [ms], in the order of the pipeline."""
    pace: PaceInfo | None = None
    """Frames dropped and latency of a run in real time; None of others."""
    people: int = 0
    """Ids that were ever confirmed."""
    remark: str = ""
    """What a reader of the results should know, in one sentence: why there are none."""
    warnings: list[RunWarning] = Field(default_factory=list)
    """Why the tracks may be wrong although the run finished: checks of the recording that failed."""
    counts: dict[str, JsonValue] = Field(default_factory=dict)
    """Totals per rule when rules were given (the ``rules`` object of ``count --json``)."""


def write_run_info(info: RunInfo, path: Path) -> None:
    """Write run.json in one step, so that a half-written file is never seen.

    Raises:
        WorkError: the disk is full or the file cannot be written; an earlier run.json is kept.
    """
    write_result(path, info.model_dump_json(indent=2) + "\n")


def write_result(path: Path, text: str) -> None:
    """Replace a file of results in one step (same errors as ``write_run_info``)."""
    try:
        write_whole(path, text)
    except OSError as error:
        raise WorkError(f"{path}: cannot be written ({reason(error)})") from error


def unfinished_beside(tracks: Path) -> str:
    """A sentence where tracks are of a run that has not finished; empty elsewhere (errors of ``read_run_info``)."""
    path = tracks.parent / "run.json"
    info = read_run_info(path) if tracks.name == "tracks.csv" and path.is_file() else None
    if info is None or info.finished or not info.started_at:
        return ""
    how = "is still running or was killed" if info.state == "running" else "was interrupted"
    return f"{tracks}: the run {how}: what follows is of the frames tracked until then (planview run --resume goes on)"


def read_run_info(path: Path) -> RunInfo:
    """Read run.json.

    Raises:
        InputError: unreadable, or a value of another kind.
    """
    try:
        return RunInfo.model_validate_json(path.read_text(encoding="utf-8"))
    except ValidationError as error:
        raise InputError(f"{path}: expected a run.json: {first_problem(error)}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected a run.json, found {reason(error)}") from error
