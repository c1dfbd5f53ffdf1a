"""Tracks changed, and written for other programs."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from calib.errors import InputError
from planview.api.arguments import given_tracks, in_range, one_of, opening
from planview.api.result import Result
from planview.offline.edit import edit_line
from planview.offline.refine import Refined
from planview.output.finished import EditedRun, edit_run, read_edits, refine_run, undo_edits
from planview.trajectories.file import limit, region_of, warn_of
from planview.trajectories.formats import FORMATS, ExportName, prepare_export, write_file
from planview.trajectories.layouts import stream_jsonl
from planview.trajectories.rows import METRES
from planview.trajectories.table import Trajectories, people_of
from stereo.readers import OpenOptions

if TYPE_CHECKING:
    from pandas import DataFrame

log = logging.getLogger(__name__)
Edits = Sequence[Sequence[int] | int | str] | int | str
"""Each as numbers, or as words that hold them; a single one may stand alone."""


def edit(
    run: Path | str,
    *,
    file: Path | str | None = None,
    join: Edits = (),
    split: Edits = (),
    delete: Edits = (),
    rename: Edits = (),
    region: str | None = None,
    ignore: str | None = None,
    join_gaps: tuple[float, float] | str | None = None,
    shorter: float | None = None,
    undo: bool = False,
    undo_all: bool = False,
) -> Result[EditedRun]:
    """Join, split, delete and rename tracks; edits can be undone.

    The tracks are those of a finished run. edits.json lists what was done, and tracks_before.csv keeps the tracks
    without any edit. Counts are not updated: count again. What is done follows the order of these arguments; ``file``
    keeps the order of its lines, and comes first.

    ```python
    planview.edit("out", join=[(3, 7)], split=[(5, 120)], delete=[9, (4, 0, 60)])
    planview.edit("out", join_gaps=(2, 0.6), shorter=1, ignore="POLYGON ((0 0, 2 0, 2 1, 0 1))")
    planview.edit("out", undo=True)
    ```

    Args:
        run: Folder of a finished run.
        file: File with an edit per line: "join 3 7", "split 5 120", "delete 9", "delete 9 100 200", "rename 4 12",
            "shorter 1.0", "join-gaps 2.0 0.6", "region POLYGON ((...))", "ignore POLYGON ((...))"; # begins a comment.
        join: A:B makes track B part of track A. In Python also (A, B), and so of all edits.
        split: ID@FRAME gives a track a new id from the frame on.
        delete: ID deletes a track, ID@FIRST:LAST its rows of these frames.
        rename: ID:NEW gives a track another id.
        region: Polygon in well-known text [m], or a file with it: rows outside are left out.
        ignore: Polygon in well-known text [m], or a file with it: rows inside are left out.
        join_gaps: SECONDS:METRES joins tracks that begin within this time and distance of another one's end, nearest
            first.
        shorter: Delete tracks that were confirmed for less, in seconds.
        undo: Undo the last call; after all edits, the refinement.
        undo_all: Undo all calls and the refinement: tracks.csv is as the tracker wrote it.

    Raises:
        InputError: no finished run in the folder, another process writes there, or an edit that cannot be applied.
    """
    folder = Path(run)
    lines = [] if file is None else read_edits(Path(file))
    for kind, edits in {"join": join, "split": split, "delete": delete, "rename": rename}.items():
        several = [edits] if isinstance(edits, int | str) else edits
        lines += [edit_line(kind, edit) for edit in several]
    for kind, text in {"region": region, "ignore": ignore}.items():
        if text is not None:
            lines.append(f"{kind} {region_of(text, f'{kind}=').wkt}")
    for kind, values in {"join-gaps": join_gaps, "shorter": shorter}.items():
        if values is not None:
            lines.append(edit_line(kind, values))
    if undo + undo_all + bool(lines) > 1:
        raise InputError("edits, undo and undo-all cannot be combined")
    if not (undo or undo_all or lines):
        raise InputError("expected an edit, e.g. a track to delete, found none")
    done = undo_edits(folder, everything=undo_all) if undo or undo_all else edit_run(folder, lines)
    return Result(done, done._asdict(), files=[folder / "tracks.csv"])


def refine(run: Path | str) -> Result[Refined]:
    """Join fragments and smooth paths, knowing the whole recording.

    The tracks are those of a finished run. tracks_online.csv keeps them as they were; refinement.csv gives the reason
    of every change. The refinement comes before edits, and can be undone as they can.

    ```python
    smooth = planview.refine("out").value.tracks
    ```

    Args:
        run: Folder of a finished run.

    Returns:
        The tracks, and every change.

    Raises:
        InputError: no finished run in the folder, an edited one, or tracks without floor positions.
    """
    folder = Path(run)
    refined, _ = refine_run(folder)
    kinds = [change.kind for change in refined.changes]
    counts = {"join": kinds.count("join"), "smooth": kinds.count("smooth")}
    return Result(refined, {"changes": counts, "rows": len(refined.tracks)}, files=[folder / "tracks.csv"])


def export(
    tracks: Trajectories | DataFrame | Path | str,
    to: ExportName | None = None,
    *,
    out: Path | str | None = None,
    unit: Literal["m", "cm"] = "m",
    fps: float | None = None,
    area: str | None = None,
    region: str | None = None,
    ignore: str | None = None,
    lost: bool = False,
    overwrite: bool = False,
    cloud: Path | str | None = None,
    calibration: Path | str | None = None,
) -> Result[Path]:
    """Write tracks in the format of another program.

    The formats are pedpy (PeTrack text), ped-data-archive (HDF5), jupedsim (sqlite), motchallenge, parquet, csv and
    jsonl; or the scene they walk in is written, in metres on the axes of the tracks. Parquet, CSV and JSON lines hold
    every row with its state, the other formats confirmed rows only.

    ```python
    planview.export(tracks, "pedpy", out="tracks.txt")
    planview.export("out", "csv", region="POLYGON ((0 0, 4 0, 4 3, 0 3, 0 0))")  # of one room
    planview.export("out", cloud="scene.ply")
    ```

    Args:
        tracks: Folder of a run, its tracks.csv, or trajectories in any of the formats; with ``cloud`` the folder of a
            run whose recording is still where it was, or a recording.
        to: Format to write.
        out: File to write; next to the tracks by default, named after the format. A dash (-) stands for standard
            output, which takes JSON lines.
        unit: Unit of a PedPy text file.
        fps: Frame rate written; that of the timestamps by default.
        area: Walkable area as well-known text in metres, or a file with it, e.g. "POLYGON ((0 0, 4 0, 4 3, 0 3, 0 0))";
            that of the trajectories by default, else the rectangle 1 m around them.
        region: Polygon in well-known text [m], or a file with it: rows outside are left out.
        ignore: Polygon in well-known text [m], or a file with it: rows inside are left out.
        lost: Formats without states also get rows in which a person was hidden and only predicted.
        overwrite: Replace a file that is there.
        cloud: Write the static scene as a coloured cloud of points to this file (.ply, .pcd or .xyz), instead of
            tracks.
        calibration: Calibration of the recording, for ``cloud``, if it is not in it.

    Returns:
        The file.

    Raises:
        InputError: a file that cannot be read, one that is there already, or tracks that the format cannot hold.
        WorkError: the file cannot be written.
    """
    if cloud and to is None and isinstance(tracks, Path | str):
        return _export_cloud(Path(tracks), Path(cloud), opening(calibration), overwrite)
    if to is None or cloud:
        raise InputError(f"expected a format ({', '.join(FORMATS)}), or a file for the cloud of a run", argument="to")
    one_of("to", to, FORMATS)
    one_of("unit", unit, METRES)
    if fps is not None:
        in_range("fps", fps, 0.001, 10_000)
    walkable = region_of(area, "area=") if area else None
    content, file, run = given_tracks(tracks)
    found = limit(content, region, ignore)
    if not len(found.table) and run:
        found = replace(found, fps=found.fps or run.info.fps)
    try:
        written = prepare_export(found, to, fps=fps, area=walkable.wkt if walkable else None, lost=lost)
    except InputError as error:
        raise error.about(str(file or "the tracks")) from error
    if walkable is not None:
        warn_of(walkable.doubt(written.table))
    if not (file or out):
        raise InputError("expected a file for a table of tracks, found None", argument="out")
    path = Path(out) if out else file.with_name(f"{file.stem}_{to}{FORMATS[to].suffix}")  # type: ignore[union-attr]
    rate = written.fps or 0.0
    people = people_of(found.table, run.frame_s if run else 1.0 / rate)
    values = {"file": str(path), "rows": len(written.table), "people": len(people), "fps": rate}
    text = f"{path}: {values['rows']:,} rows of {len(people)} people, {rate:g} frames per second"
    exported = Result(path, values, files=[path], text=text)
    if path == Path("-"):
        if to != "jsonl":
            raise InputError(f"only jsonl can be written to standard output, not {to}")
        stream_jsonl(sys.stdout, written.table)
        return exported
    _refuse_existing(path, file, overwrite)
    write_file(path, written, to, unit)
    return exported


def _export_cloud(source: Path, path: Path, options: OpenOptions, overwrite: bool) -> Result[Path]:
    from planview.output.render import scene_of, write_cloud  # the engine's parts take half a second

    _refuse_existing(path, source, overwrite)
    log.debug("opening the recording, finding the floor, matching")
    points = write_cloud(path, scene_of(source, options))
    return Result(path, {"file": str(path), "points": points}, files=[path])


def _refuse_existing(out: Path, source: Path | None, overwrite: bool) -> None:
    if source is not None and out.exists() and out.samefile(source):
        raise InputError(f"{out} is the file that is read; choose another")
    if out.is_dir():
        raise InputError(f"{out} is a folder; name a file")
    if out.exists() and not overwrite:
        raise InputError(f"{out}: already exists", remedy="overwrite=True")
