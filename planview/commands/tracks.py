"""``planview edit`` and ``export``: tracks changed, and written for other programs."""

from __future__ import annotations

import json
import re
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, cast

from cyclopts import Parameter

from calib.errors import InputError
from calib.io import read_text
from planview.commands.options import Flag, Ignored, JsonFlag, Region, open_options, plural, say
from planview.output.finished import edit_run, refine_run, scores_of_refinement, undo_edits
from planview.output.progress import PlainConsole
from planview.output.run_folder import RunFolder
from planview.trajectories.file import limited, region_of
from planview.trajectories.formats import FORMATS, ExportName, load_file, prepared, tracks_file, write_file
from planview.trajectories.layouts import stream_jsonl
from planview.trajectories.table import people_of

_Many = Annotated[Sequence[str], Parameter(negative="")]


@Parameter(name="*")
@dataclass(frozen=True)
class EditOptions:
    """What is done, in the order of these options; --list keeps the order of its lines, and comes first."""

    list: Path | None = None
    """File with an edit per line: "join 3 7", "split 5 120", "delete 9", "delete 9 100 200", "rename 4 12",
    "shorter 1.0", "join-gaps 2.0 0.6", "region POLYGON ((...))", "ignore POLYGON ((...))"; # begins a comment."""
    join: _Many = ()
    """A:B makes track B part of track A."""
    split: _Many = ()
    """ID@FRAME gives a track a new id from the frame on."""
    delete: _Many = ()
    """ID deletes a track, ID@FIRST:LAST its rows of these frames."""
    rename: _Many = ()
    """ID:NEW gives a track another id."""
    region: Region = None
    ignore: Ignored = None
    join_gaps: str | None = None
    """SECONDS:METRES joins tracks that begin within this time and distance of another one's end, nearest first."""
    shorter: float | None = None
    """Delete tracks that were confirmed for less, in seconds."""
    undo: Flag = False
    """Undo the last call; after all edits, the refinement."""
    undo_all: Flag = False
    """Undo all calls and the refinement: tracks.csv is as the tracker wrote it."""
    refine: Flag = False
    """Improve the tracks by the whole recording: fragments of one person are joined and paths smoothed.
    tracks_online.csv keeps the tracks as they were; refinement.csv gives the reason of every change."""
    json_output: JsonFlag = False


def edit(out: Annotated[Path, Parameter(name="RUN")], /, *, options: EditOptions = EditOptions()) -> None:
    """Join, split, delete and rename tracks of a finished run, one by one or by rule; every edit can be undone.

    edits.json lists what was done, and tracks_before.csv keeps the tracks without any edit. Counts are not updated: run
    planview count again.

    Example: planview edit out --join 3:7 --split 5@120 --delete 9

    Example by rule: planview edit out --join-gaps 2:0.6 --shorter 1 --ignore "POLYGON ((0 0, 2 0, 2 1, 0 1))"

    Example: planview edit out --undo

    Example of refining: planview edit out --refine

    Parameters
    ----------
    out
        Folder of a finished run.
    """
    lines = _lines(options)
    if options.undo + options.undo_all + options.refine + bool(lines) > 1:
        raise InputError("edits, --undo, --undo-all and --refine cannot be combined")
    if options.refine:
        refined, _ = refine_run(out)
        counts = dict.fromkeys(("join", "smooth"), 0) | Counter(change.kind for change in refined.changes)
        if options.json_output:
            print(json.dumps({"changes": counts, "rows": len(refined.tracks)}))
        else:
            joins, paths = plural(counts["join"], "join"), plural(counts["smooth"], "path")
            say(f"{out / 'tracks.csv'}: {joins}, {paths} smoothed")
            if scores := scores_of_refinement(out):
                say(f"{scores}; planview edit {out} --undo takes the refinement back")
        return
    if options.undo or options.undo_all:
        result = undo_edits(out, everything=options.undo_all)
    elif lines:
        result = edit_run(out, lines)
    else:
        raise InputError("edit needs an edit: --join, --delete, ... (planview edit --help)")
    if options.json_output:
        print(json.dumps(result._asdict()))
        return
    say(
        f"{out / 'tracks.csv'}: people {result.people_before} -> {result.people}, "
        f"rows {result.rows_before:,} -> {result.rows:,}; {result.steps or 'nothing'} left to undo"
    )


_BY_ID = {
    "join": ("A:B", r"\d+:\d+"),
    "split": ("ID@FRAME", r"\d+@\d+"),
    "delete": ("ID or ID@FIRST:LAST", r"\d+(@\d+:\d+)?"),
    "rename": ("ID:NEW", r"\d+:\d+"),
}
"""How the options that name tracks are written."""


def _lines(options: EditOptions) -> list[str]:
    """The options as lines of ``planview.offline.edit``."""
    listed = "" if options.list is None else read_text(options.list, "a list of edits")
    lines = [line for text in listed.splitlines() if (line := text.partition("#")[0].strip())]
    for kind, (form, pattern) in _BY_ID.items():
        for edit in getattr(options, kind):
            if not re.fullmatch(pattern, edit):
                raise InputError(f"--{kind}: expected {form}, found {edit!r}")
            lines.append(f"{kind} {re.sub('[:@]', ' ', edit)}")
    for kind, text in (("region", options.region), ("ignore", options.ignore)):
        lines += [f"{kind} {region_of(text, f'--{kind}').wkt}"] if text is not None else []
    lines += [f"join-gaps {options.join_gaps.replace(':', ' ')}"] if options.join_gaps is not None else []
    return lines + ([f"shorter {options.shorter:g}"] if options.shorter is not None else [])


@Parameter(name="*")
@dataclass(frozen=True)
class ExportOptions:
    """Where the export goes and what it holds."""

    out: Annotated[Path | None, Parameter(allow_leading_hyphen=True)] = None
    """File to write; next to the tracks by default, named after the format. - writes JSON lines to standard output."""
    unit: Literal["m", "cm"] = "m"
    """Unit of a PedPy text file."""
    fps: float | None = None
    """Frame rate written; that of the timestamps by default."""
    area: str | None = None
    """Walkable area as well-known text in metres, or a file with it, e.g. "POLYGON ((0 0, 4 0, 4 3, 0 3, 0 0))"; that
    of the trajectories by default, else the rectangle 1 m around them."""
    region: Region = None
    ignore: Ignored = None
    lost: Flag = False
    """Formats without states also get rows in which a person was hidden and only predicted."""
    overwrite: Flag = False
    """Replace a file that is there."""
    cloud: Path | None = None
    """Write the static scene as a coloured cloud of points to this file (.ply, .pcd or .xyz), instead of tracks."""
    calibration: Path | None = None
    """Calibration of the recording, for --cloud, if it is not in it."""


def export(tracks: Path, /, *, to: ExportName | None = None, options: ExportOptions = ExportOptions()) -> None:
    """Write tracks in the format of another program: pedpy (PeTrack text), ped-data-archive (HDF5), jupedsim (sqlite),
    motchallenge, parquet, csv or jsonl; or the scene they walk in.

    Parquet, CSV and JSON lines hold every row with its state, the other formats confirmed rows only.

    Example: planview export out --to pedpy --out tracks.txt

    Example of one room: planview export out --to csv --region "POLYGON ((0 0, 4 0, 4 3, 0 3, 0 0))"

    Example of a stream: planview export out --to jsonl --out - | head

    Example of the scene, in metres on the axes of the tracks: planview export out --cloud scene.ply

    Parameters
    ----------
    tracks
        Folder of a run, its tracks.csv, or trajectories in any of the formats; with --cloud the folder of a run whose
        recording is still where it was, or a recording.
    to
        Format to write.
    """
    if (to is None) == (options.cloud is None):
        raise InputError(f"export needs --to with a format ({', '.join(FORMATS)}), or --cloud with a file")
    if options.cloud is not None:
        from planview.output.render import scene_of, write_cloud

        _refuse_existing(options.cloud, tracks, options.overwrite)
        with PlainConsole(stderr=True).status("opening the recording, finding the floor, matching"):
            n_points = write_cloud(options.cloud, scene_of(tracks, open_options(options.calibration)))
        say(f"{options.cloud}: {n_points:,} points [m], origin on the floor below the camera, z up")
    elif to is not None:
        _export_tracks(tracks, to, options)


def _export_tracks(tracks: Path, to: ExportName, options: ExportOptions) -> None:
    if options.fps is not None and not 0 < options.fps <= 10_000:
        raise InputError(f"--fps: expected a rate above 0, found {options.fps:g}")
    source = tracks_file(tracks)
    area = region_of(options.area, "--area").wkt if options.area else None
    try:
        found = limited(load_file(source), options.region, options.ignore)
        file = prepared(found, to, fps=options.fps, area=area, lost=options.lost)
    except InputError as error:
        raise error if str(source) in str(error) else error.about(str(source)) from error
    if options.out == Path("-"):
        if to != "jsonl":
            raise InputError(f"only --to jsonl can be written to standard output, not {to}")
        stream_jsonl(sys.stdout, file.table)
        return
    out = options.out or source.with_name(f"{source.stem}_{to}{FORMATS[to].suffix}")
    _refuse_existing(out, source, options.overwrite)
    write_file(out, file, to, options.unit)
    run = RunFolder.around(tracks)
    rate = cast(float, file.fps)
    people = len(people_of(found.table, 1 / rate if run is None else run.frame_s))
    say(f"{out}: {len(file.table):,} rows of {people} people, {rate:g} frames per second")


def _refuse_existing(out: Path, source: Path, overwrite: bool) -> None:
    if out.exists() and out.resolve() == source.resolve():
        raise InputError(f"{out} is the file that is read; choose another")
    if out.is_dir():
        raise InputError(f"{out} is a folder; name a file")
    if out.exists() and not overwrite:
        raise InputError(f"{out}: exists; choose another file or add --overwrite")
