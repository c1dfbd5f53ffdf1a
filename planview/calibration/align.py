"""Several heads laid into one world: that of the first, with its clock."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from calib.errors import InputError, WorkError
from calib.pose import SE3
from calib.world import RigEntry
from planview.calibration.align_params import AlignParams
from planview.calibration.head_alignment import HeadAlignment, after, align_heads
from planview.calibration.head_paths import paths_of
from planview.calibration.head_record import HeadRecord


def align_records(records: Sequence[HeadRecord], params: AlignParams | None = None) -> list[HeadAlignment]:
    """Alignments of all heads but the first to the first.

    A head is laid over every head that has its place already, and takes the most certain result: not every head needs
    to see what the first one sees.

    Raises:
        WorkError: people do not tell where a head is; the head is named.
    """
    paths = [paths_of(record.tracks, record.effect) for record in records]
    placed: dict[int, HeadAlignment | None] = {0: None}
    waiting = list(range(1, len(records)))
    while waiting:
        reasons: dict[int, WorkError] = {}
        for k in waiting:
            found = []
            for j, before in placed.items():
                try:
                    nearer = align_heads(paths[j], paths[k], params)
                except WorkError as error:
                    reasons[k] = error
                    continue
                found.append(after(before, nearer) if before else nearer)
            if found:
                placed[k] = min(found, key=lambda a: a.position_std_m)
        if not set(waiting) & placed.keys():
            k = waiting[0]
            raise WorkError(f"{records[k].path}: {reasons[k]}") from reasons[k]
        waiting = [k for k in waiting if k not in placed]
    return [alignment for k in range(1, len(records)) if (alignment := placed[k]) is not None]


def rig_entries(records: Sequence[HeadRecord], alignments: Sequence[HeadAlignment], folder: Path) -> list[RigEntry]:
    """The heads as ``rigs.toml`` in a folder lists them.

    Raises:
        InputError: a head that is not inside the folder.
    """
    entries = [RigEntry(_inside(records[0].path, folder), records[0].effect.world_SE3_left)]
    for record, alignment in zip(records[1:], alignments, strict=True):
        common_SE3_own = SE3.from_rotvec([0.0, 0.0, alignment.heading_rad], [alignment.x_m, alignment.y_m, 0.0])
        pose = common_SE3_own @ record.effect.world_SE3_left
        entries.append(RigEntry(_inside(record.path, folder), pose, alignment.clock_s))
    return entries


def check_inside(heads: Sequence[Path], folder: Path) -> None:
    """Heads must lie in the folder of ``rigs.toml``, which becomes the recording.

    Raises:
        InputError: one does not.
    """
    for head in heads:
        _inside(head, folder)


def _inside(head: Path, folder: Path) -> str:
    relative = os.path.relpath(head.resolve(), folder.resolve())
    if relative.startswith("..") or relative == ".":
        raise InputError(f"--out: expected rigs.toml in a folder above all heads, found {folder} for {head}")
    return relative
