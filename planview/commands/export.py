"""``planview export``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from calib.errors import InputError
from planview.commands.options import Flag
from planview.commands.source import open_options
from planview.output.progress import PlainConsole
from planview.trajectories.export import FORMATS, ExportName, prepared
from planview.trajectories.file import TrajectoryFile
from planview.trajectories.jsonl import stream_jsonl
from planview.trajectories.layouts import load_file
from planview.trajectories.pairs import tracks_file
from planview.trajectories.petrack import write_petrack
from planview.trajectories.regions import limited, region_of


@Parameter(name="*")
@dataclass(frozen=True)
class ExportOptions:
    """Where the export goes and what it holds."""

    out: Annotated[Path | None, Parameter(allow_leading_hyphen=True)] = None
    """File to write; beside the tracks by default, named after the format. - writes JSON lines to standard output."""
    unit: Literal["m", "cm"] = "m"
    """Unit of a PedPy text file."""
    fps: float | None = None
    """Frame rate written; that of the timestamps by default."""
    area: str | None = None
    """Walkable area as well-known text in metres, or a file with it, e.g. "POLYGON ((0 0, 4 0, 4 3, 0 3, 0 0))"; that
    of the trajectories by default, else the rectangle 1 m around them."""
    region: str | None = None
    """Polygon in well-known text [m], or a file with it: rows outside are left out."""
    ignore: str | None = None
    """Polygon in well-known text [m], or a file with it: rows inside are left out."""
    lost: Flag = False
    """Formats without states also get rows in which a person was hidden and only predicted."""
    overwrite: Flag = False
    """Replace a file that is there."""
    cloud: Path | None = None
    """Write the static scene as a coloured cloud of points to this file (.ply, .pcd or .xyz), instead of tracks."""
    calibration: Path | None = None
    """Calibration of the recording, for --cloud, when it does not lie in it."""


def export(tracks: Path, *, to: ExportName | None = None, options: ExportOptions | None = None) -> None:
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
    options = options or ExportOptions()
    if (to is None) == (options.cloud is None):
        raise InputError(f"expected --to with a format ({', '.join(FORMATS)}) or --cloud with a file, one of them")
    if to is not None:
        _export_tracks(tracks, to, options)
    elif options.cloud is not None:
        _export_cloud(tracks, options.cloud, options)


def _export_tracks(tracks: Path, to: ExportName, options: ExportOptions) -> None:
    if options.fps is not None and not 0 < options.fps <= 10_000:
        raise InputError(f"--fps: expected a rate above 0, found {options.fps:g}")
    source = tracks_file(tracks)
    area = region_of(options.area, "--area").wkt if options.area else None
    try:
        found = limited(load_file(source), options.region, options.ignore)
        file = prepared(found, to, fps=options.fps, area=area, lost=options.lost)
    except InputError as error:
        raise InputError(str(error) if str(source) in str(error) else f"{source}: {error}") from error
    if options.out == Path("-"):
        if to != "jsonl":
            raise InputError(f"--out -: expected --to jsonl, found {to}")
        stream_jsonl(sys.stdout, file.table)
        return
    out = options.out or source.with_name(f"{source.stem}_{to}{FORMATS[to].suffix}")
    _refuse_existing(out, source, options.overwrite)
    _write(out, file, to, options.unit)
    _say(out, file)


def _export_cloud(source: Path, out: Path, options: ExportOptions) -> None:
    from planview.engine.scene_cloud import write_cloud
    from planview.output.results import scene_of

    _refuse_existing(out, source, options.overwrite)
    console = PlainConsole(stderr=True, highlight=False, soft_wrap=True)
    with console.status("opening the recording, finding the floor, matching"):
        n_points = write_cloud(out, scene_of(source, open_options(options.calibration)))
    console.print(f"{out}: {n_points} points [m], origin on the floor below the camera, z up")


def _write(out: Path, file: TrajectoryFile, to: ExportName, unit: str) -> None:
    if to == "pedpy":
        write_petrack(out, file, unit)
    else:
        FORMATS[to].write(out, file)


def _refuse_existing(out: Path, source: Path, overwrite: bool) -> None:
    if out.exists() and out.resolve() == source.resolve():
        raise InputError(f"{out}: expected another file than the one that is read")
    if out.is_dir():
        raise InputError(f"{out}: expected a file to write, found a folder")
    if out.exists() and not overwrite:
        raise InputError(f"{out}: exists; choose another file or add --overwrite")


def _say(out: Path, file: TrajectoryFile) -> None:
    people = len(set(file.table.track_id.tolist()))
    rate = f", {file.fps:g} frames per second" if file.fps else ""
    console = PlainConsole(stderr=True, highlight=False, soft_wrap=True)
    console.print(f"{out}: {len(file.table)} rows of {people} people{rate}")
