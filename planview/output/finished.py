"""Tracks of a finished run changed in its folder: edits that can be taken back, and refinement."""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from calib.errors import InputError
from calib.io import read_text, refuse_missing
from planview.offline.edit import edited
from planview.offline.refine import Refined, changes_csv, refine
from planview.output.folder import RunInfo, finished_run, folder_lock, read_model, write_result, write_run_info, writing
from planview.output.report.page import write_report
from planview.output.report.snapshots import read_decision_log
from planview.output.run_folder import TRACKS_BEFORE, TRACKS_ONLINE, RunFolder
from planview.trajectories.table import Trajectories, doubt, people_of, read_tracks, write_table

EDITS = "edits.json"


class EditStep(BaseModel):
    """One call of ``planview edit``: when, and its edits as ``planview.offline.edit`` reads them."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    at: str
    """ISO 8601 time with zone."""
    edits: list[str] = Field(max_length=100_000)


class _EditsFile(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    steps: list[EditStep] = Field(max_length=10_000)


class EditedRun(NamedTuple):
    """Rows and people before and after a call, and the number of steps that can be undone."""

    rows_before: int
    rows: int
    people_before: int
    people: int
    left_to_undo: int


def read_edits(file: Path) -> list[str]:
    """The edits of a file, one per line, without comments. Raises InputError: it cannot be read."""
    rows = (row.partition("#")[0].strip() for row in read_text(file, "a list of edits").splitlines())
    return [row for row in rows if row]


def edit_run(folder: Path, lines: Sequence[str]) -> EditedRun:
    """Apply edits to ``tracks.csv``; the tracks without any edit are kept in ``tracks_before.csv``.

    All edits so far are applied to these again, so that the tracks always follow from ``edits.json``. An edit that is
    refused changes nothing. Raises InputError: no finished run in the folder, another call holds it, or an edit that
    cannot be applied."""
    step = EditStep(at=datetime.now(UTC).isoformat(timespec="seconds"), edits=list(lines))
    with _finished_run_lock(folder):
        before = _readable_run(folder)
        _rewrite(before, [*read_steps(folder), step])
        return _change_of(before)


def undo_edits(folder: Path, *, everything: bool = False) -> EditedRun:
    """Undo the last call of edits or, where none is left, the refinement; or all of them, after which ``tracks.csv`` is
    what the tracker wrote, byte for byte. Raises InputError: as ``edit_run``, or nothing to undo."""
    with _finished_run_lock(folder):
        before = _readable_run(folder)
        done = read_steps(folder)
        if not done and not before.info.refined:
            raise InputError(f"{folder}: nothing to undo")
        if done:
            _rewrite(before, [] if everything else done[:-1])
        if before.info.refined and (everything or not done):
            _without_refinement(folder)
        return _change_of(before)


def _change_of(before: RunFolder) -> EditedRun:
    after = RunFolder(before.path)
    steps = len(read_steps(after.path)) + after.info.refined
    return EditedRun(len(before.tracks), len(after.tracks), len(before.people), len(after.people), steps)


def _without_refinement(folder: Path) -> None:
    online = folder / TRACKS_ONLINE
    if not online.is_file():
        raise InputError(f"{online}: the tracks before the refinement are missing")
    write_result(folder / "tracks.csv", online.read_text(encoding="utf-8"))
    run = RunFolder(folder)
    write_run_info(run.info.model_copy(update={"refined": False, "people": len(run.people)}), folder / "run.json")
    for path in (online, folder / "refinement.csv"):
        path.unlink(missing_ok=True)
    write_report(folder)


EQUAL_SCORE = 5e-4
"""Scores that differ by less print alike."""


def scores_of_refinement(folder: Path) -> str:
    """Change of the scores by a refinement: "better", "worse" or "equal", then a line before and one after; empty where
    the recording has no truth."""
    refined = RunFolder(folder)
    if refined.truth_file is None:
        return ""
    before = refined.as_tracked.evaluate()
    after = refined.evaluate()
    gains = [(after.mota or 0) - (before.mota or 0), (after.idf1 or 0) - (before.idf1 or 0)]
    verdict = "equal"
    if max(gains) > EQUAL_SCORE:
        verdict = "better"
    if min(gains) < -EQUAL_SCORE:
        verdict = "worse"
    return f"{verdict} against the truth\nbefore: {before.headline}\nafter:  {after.headline}"


def read_steps(folder: Path) -> list[EditStep]:
    """The edits of a folder, oldest first. Raises InputError: edits.json cannot be read, or its tracks are missing."""
    path = folder / EDITS
    if not path.is_file():
        return []
    steps = read_model(path, _EditsFile, "the edits of a run").steps
    if steps and not (folder / TRACKS_BEFORE).is_file():
        raise InputError(f"{folder / TRACKS_BEFORE}: expected the tracks before the edits, found no file")
    return steps


@contextmanager
def _finished_run_lock(folder: Path) -> Iterator[None]:
    """Hold the folder of a finished run; what it holds is read inside, since a call before may have changed it. Raises
    InputError: no finished run, or another call holds the folder."""
    refuse_missing(folder)
    if not folder.is_dir() or finished_run(folder) is None:
        raise InputError(f"{folder}: no finished run in it")
    with folder_lock(folder):
        yield


def _readable_run(folder: Path) -> RunFolder:
    """Read a run; raises InputError, before anything changes, for what no page could be written from."""
    run = RunFolder(folder).read_all()
    if odd := doubt(run.tracks):
        warnings.warn(f"{folder / 'tracks.csv'}: {odd}", stacklevel=3)
    read_decision_log(folder / "decisions.csv", set(run.tracks.track_id.tolist()))
    return run


def _rewrite(run: RunFolder, steps: list[EditStep]) -> None:
    """Write the tracks again that follow from all steps."""
    tracks = run.path / "tracks.csv"
    kept = run.path / TRACKS_BEFORE
    before = read_tracks(kept) if kept.is_file() else run.tracks
    after = edited(before, [line for step in steps for line in step.edits])
    if not kept.is_file():
        write_result(kept, tracks.read_text(encoding="utf-8"))
    write_result(run.path / EDITS, json.dumps({"steps": [step.model_dump() for step in steps]}, indent=2) + "\n")
    if steps:
        write_result(tracks, _csv_text(after))
    else:
        with writing(tracks):
            kept.replace(tracks)
            (run.path / EDITS).unlink()
    people = len(people_of(after, run.frame_s))
    write_run_info(run.info.model_copy(update={"people": people}), run.path / "run.json")
    write_report(run.path)


def refine_run(folder: Path) -> tuple[Refined, RunInfo]:
    """Refine the tracks of a finished run (see ``refine_held_run``). Raises InputError: no finished run in the folder,
    another call holds it, or as ``refine_held_run``."""
    with _finished_run_lock(folder):
        return refine_held_run(folder)


def refine_held_run(folder: Path) -> tuple[Refined, RunInfo]:
    """Write ``tracks.csv`` again from ``tracks_online.csv``, and ``refinement.csv`` with the reason of every change, in
    a folder that the caller holds.

    The first time the online tracks become ``tracks_online.csv``; every time is a refinement of these. ``run.json`` has
    ``refined: true`` before tracks.csv changes, so that refined tracks never pass for online ones. report.html is
    written last: a folder without it is refined again when its run is resumed. Raises InputError: an edited run, a
    refined one without its online tracks, or tracks without floor positions."""
    run = _readable_run(folder)
    if read_steps(folder):
        raise InputError(f"{folder}: its tracks were edited; undo the edits first")
    tracks = folder / "tracks.csv"
    online = folder / TRACKS_ONLINE
    if run.info.refined and not online.is_file():
        raise InputError(f"{online}: expected the online tracks of a refined run, found no file")
    source = online if run.info.refined else tracks
    tracked = read_tracks(source)
    try:
        refined = refine(tracked)
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    if source is tracks:
        write_result(online, tracks.read_text(encoding="utf-8"))
    (folder / "report.html").unlink(missing_ok=True)
    people = len(people_of(refined.tracks, run.frame_s))
    info = run.info.model_copy(update={"refined": True, "people": people})
    write_run_info(info, folder / "run.json")
    write_result(folder / "refinement.csv", changes_csv(refined.changes))
    write_result(tracks, _csv_text(refined.tracks))
    write_report(folder)
    return refined, info


def _csv_text(tracks: Trajectories) -> str:
    text = io.StringIO()
    write_table(text, tracks)
    return text.getvalue()
