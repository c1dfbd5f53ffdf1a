"""``planview refine``: the tracks of a finished run refined in its folder, the online tracks kept beside."""

from __future__ import annotations

import io
from pathlib import Path
from typing import NamedTuple

from calib.errors import InputError
from planview.offline.changes import changes_csv
from planview.offline.joining import FragmentSimilarity
from planview.offline.params import RefineParams
from planview.offline.refine import Refined, refine
from planview.output.edit import refuse_edited
from planview.output.folder import finished_run
from planview.output.info import RunInfo, write_result, write_run_info
from planview.output.report.page import write_report
from planview.trajectories.table import read_tracks, write_table


class RefinedRun(NamedTuple):
    """What ``refine_run`` wrote: the tracks with their changes, and run.json."""

    refined: Refined
    info: RunInfo


def refine_run(
    folder: Path, params: RefineParams | None = None, similarity: FragmentSimilarity | None = None
) -> RefinedRun:
    """Write ``tracks.csv`` anew from ``tracks_online.csv``, and ``refinement.csv`` with the reason of every change.

    The first time the online tracks become ``tracks_online.csv``; every time is a refinement of these. ``run.json``
    says ``refined: true`` before tracks.csv changes, so that refined tracks never pass for online ones.

    Raises:
        InputError: no finished run in the folder, an edited one, a refined one without its online tracks, or tracks
            without floor positions.
        WorkError: a file cannot be written.
    """
    info = finished_run(folder) if folder.is_dir() else None
    if info is None:
        raise InputError(f"{folder}: expected the folder of a finished run, found none")
    refuse_edited(folder)
    tracks, online = folder / "tracks.csv", folder / "tracks_online.csv"
    if info.refined and not online.is_file():
        raise InputError(f"{online}: expected the online tracks of a refined run, found no file")
    source = online if info.refined else tracks
    found = read_tracks(source)
    try:
        refined = refine(found, params, similarity)
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    if source is tracks:
        write_result(online, tracks.read_text(encoding="utf-8"))
    info = info.model_copy(update={"refined": True})
    write_run_info(info, folder / "run.json")
    write_result(folder / "refinement.csv", changes_csv(refined.changes))
    text = io.StringIO()
    write_table(text, refined.tracks)
    write_result(tracks, text.getvalue())
    write_report(folder)
    return RefinedRun(refined, info)
