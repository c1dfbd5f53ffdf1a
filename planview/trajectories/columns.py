"""What the columns of rows of boxes mean: MOTChallenge, VisDrone, CVAT, PETS, and detectors of many classes."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.io import read_text
from calib.types import F64, Bool
from planview.trajectories.table import IGNORED

DISTRACTORS = (2, 7, 8, 12)
"""Classes of MOT16 and later that excuse a track (Milan et al. 2016, section 3.2): person on a vehicle, static person,
distractor, reflection."""
VISDRONE_PEOPLE = (1, 2)
"""Pedestrians, and people who do not walk (Zhu et al. 2018, VisDrone)."""
VISIBLE_OF_OCCLUSION = np.array([1.0, 0.75, 0.25])
"""Unoccluded fraction of VisDrone's levels: none, up to half and more than half hidden; the middle of each."""
NAMES = re.compile(r"\b(person|people|pedestrian|human|man|woman|walker)s?\b", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class BoxColumns:
    """Rows of people, as columns of equal length (N,).

    Attributes:
        frame, track_id, box_px: as in the file; the box (N, 4) left, top, width, height [px], NaN where it is unknown.
        score: NaN where there is none.
        floor_m: (N, 2) place [m], NaN where it is unknown.
        visible: unoccluded fraction, or IGNORED.
        note: what was assumed or left out, in a sentence; empty when nothing was.
    """

    frame: F64
    track_id: F64
    box_px: F64
    score: F64
    floor_m: F64
    visible: F64
    note: str


def box_columns(table: F64, path: Path, *, truth: bool = False) -> BoxColumns:
    """The people among (N, 6 to 10) rows of frame, id, left, top, width, height and what follows.

    - flag (0 or 1), class, visibility (0 to 1): MOT16 and later, CVAT. Flag 0 is left out of truth.
    - flag, class, truncation (0 or 1), occlusion (0 to 2): VisDrone.
    - score and class, with nothing or -1 after them; or class, or class and score: a detector of many classes.
    - confidence, X, Y (and Z): MOT15 and PETS, metres on the floor, unknown where all are -1; confidence 0 is left out
      of truth.

    People are the classes that ``labels.txt`` next to the file names (CVAT), else those of the format; a detector's are
    0 where it counts classes from 0, else 1. Raises InputError: truth of which no row counts, or no class of people.
    """
    more, kind = table[:, 6:], _class_column(table)
    score, unknown = more[:, 0] if more.shape[1] else np.full(len(table), np.nan), np.full((len(table), 2), np.nan)
    if kind is not None:
        keep, score, visible, note = _of_classes(table, kind, path, truth)
        return _kept(table, keep, score, unknown, visible, note)
    counted: Bool = np.asarray(score != 0) if truth and more.shape[1] else np.ones(len(table), dtype=np.bool_)
    if len(table) and not counted.any():
        raise InputError(f"{path}: expected truth rows that count, found the confidence 0 in all of them")
    floor = unknown
    if more.shape[1] >= 3:
        known = np.isfinite(more[:, 1:3]).all(axis=1) & ~(more[:, 1:] == -1).all(axis=1)
        floor = np.where(known[:, None], more[:, 1:3], np.nan)
    return _kept(table, counted, score, floor, np.ones(len(table)), "")


def people_among(classes: Iterable[float]) -> tuple[int, ...]:
    """The class of people of a detector: 0 where its classes count from 0, else 1, as in COCO."""
    return (0,) if 0 in set(classes) else (1,)


def left_out(people: Iterable[float], others: Iterable[float], where: str) -> str:
    """A sentence on the classes of a file; empty where all rows show people."""
    others = sorted(others)
    return (
        f"class {listed_numbers(people)} in {where} is people; class {listed_numbers(others)} is left out"
        if others
        else ""
    )


def _kept(table: F64, keep: Bool, score: F64, floor: F64, visible: F64, note: str) -> BoxColumns:
    box = np.where((table[:, 4:6] > 0).all(axis=1, keepdims=True), table[:, 2:6], np.nan)
    return BoxColumns(table[keep, 0], table[keep, 1], box[keep], score[keep], floor[keep], visible[keep], note)


def _of_classes(table: F64, kind: int, path: Path, truth: bool) -> tuple[Bool, F64, F64, str]:
    """Which rows count, their score and their unoccluded fraction, and what was left out."""
    more = table[:, 6:]
    classes, visible = more[:, kind], np.ones(len(table))
    benchmark = kind == 1 and more.shape[1] > 2 and bool((more[:, 2:] >= 0).all())
    named, usual = _people_in_labels(path), people_among(classes)
    if benchmark and more.shape[1] == 4:
        usual, visible = VISDRONE_PEOPLE, VISIBLE_OF_OCCLUSION[more[:, 3].astype(np.int64)]
    elif benchmark:
        usual, visible = (1,) if truth else usual, more[:, 2]
    people = named or usual
    person = np.isin(classes, people)
    if benchmark and truth:
        person &= more[:, 0] == 1
    of_mot = benchmark and truth and not named
    excuses = np.isin(classes, DISTRACTORS if of_mot and usual == (1,) else ())
    if not person.any():
        listed, wanted = listed_numbers(np.unique(classes)), listed_numbers(people)
        expected = f"rows of people (class {wanted} in column {kind + 7}), found class {listed}"
        if truth and benchmark:
            flags = listed_numbers(np.unique(more[:, 0]))
            expected = f"truth rows that count (flag 1, class {wanted}: person), found class {listed}, flags {flags}"
        raise InputError(f"{path}: expected {expected}")
    note = "" if of_mot else left_out(people, np.setdiff1d(classes, people), f"column {kind + 7}")
    score = more[:, 1 - kind] if more.shape[1] > 1 else np.full(len(table), np.nan)
    return person | excuses, score, np.where(excuses, IGNORED, visible), note


def _class_column(table: F64) -> int | None:
    """Which column behind the box holds a class; None where none does."""
    more = table[:, 6:]
    n = more.shape[1]
    if not len(table) or not n:
        return None
    whole = [bool((np.floor(column) == column).all() and column.min() >= -1) for column in more.T]
    if n >= 2 and whole[1] and more[:, 1].max() >= 0:
        rest = more[:, 2:]
        flag = bool(np.isin(more[:, 0], (0, 1)).all()) and more[:, 1].min() >= 0
        visibility = flag and n == 3 and bool(((rest >= 0) & (rest <= 1)).all())
        levels = flag and n == 4 and all(whole) and bool(((rest >= 0) & (rest <= (1, 2))).all())
        levels = levels and more[:, 1].max() > 0  # else somebody who stays at the origin of the floor
        if visibility or levels or bool(((rest == -1) | np.isnan(rest)).all()):
            return 1
    # A class first: more than a flag, people among them, and one for all rows of an id, unlike scores in percent.
    scored = n == 2 and not whole[1] and bool(((more[:, 1] >= 0) & (more[:, 1] <= 1)).all())
    if (n == 1 or scored) and whole[0] and more[:, 0].max() > 1 and np.isin(more[:, 0], (0, 1)).any():
        of_id = np.unique(table[table[:, 1] > 0][:, (1, 6)], axis=0)
        return 0 if len(of_id) == len(np.unique(of_id[:, 0])) else None
    return None


def _people_in_labels(path: Path) -> tuple[int, ...]:
    """Classes of people, from 1, that ``labels.txt`` next to the file names a line each; empty without it."""
    file = path.parent / "labels.txt"
    if not file.is_file():
        return ()
    names = enumerate(read_text(file, "names of classes").splitlines(), 1)
    return tuple(number for number, name in names if NAMES.search(name))


def listed_numbers(values: Iterable[float]) -> str:
    shown = [f"{value:g}" for value in values]
    return ", ".join(shown[:8]) + (f" and {len(shown) - 8} more" if len(shown) > 8 else "")
