"""Boxes of people in images: rows of MOTChallenge, CVAT, PETS and of detectors."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.errors import InputError
from calib.io import expecting, read_text
from calib.types import F64, AnyArray, Bool
from planview.trajectories.file import TrajectoryFile
from planview.trajectories.table import BOX_COLUMNS, IGNORED, table_of

EXPECTED = "frame (from 1),id,left,top,width,height,..."
CELLS_MAX = 10
FROM_ZERO = "frames count from 0, since there is a frame 0"
OUTSIDE_MAX = 0.1
"""Share of boxes whose centre may lie outside of the image: people at its border."""
CORNERS_MIN = 10
CORNERS_SPREAD = 0.5
"""Fewest boxes of a file of corners, and most that right less left may vary as a share of right."""
DISTRACTORS = (2, 7, 8, 12)
"""Classes of MOT16 and later that excuse a track (Milan et al. 2016, section 3.2): person on a vehicle, static person,
distractor, reflection."""
NAMES = re.compile(r"\b(person|people|pedestrian|human|man|woman|walker)s?\b", re.IGNORECASE)

_HEADERS = (
    "frame(_?(id|number|no|index))?", "id|track_?id|identity", "(bb(ox)?_)?(left|x)|xmin", "(bb(ox)?_)?(top|y)|ymin",
    "(bb(ox)?_)?w(idth)?", "(bb(ox)?_)?h(eight)?", "conf(idence)?|score", "cls|class(_id)?|category_id",
)  # fmt: skip
"""Names of the columns in a line before the rows, of which score and class may lack."""


def named_columns(line: str) -> list[int]:
    """Places of frame, id, box, score and class in a line of names; empty of any other line."""
    line = line.strip(" #%\r\n")
    separator = r"[,;\t]" if re.search(r"[,;\t]", line) else r"\s+"
    names = [name.strip(" \"'").lower() for name in re.split(separator, line)]
    places = []
    for number, pattern in enumerate(_HEADERS):
        matches = [place for place, name in enumerate(names) if re.fullmatch(pattern, name)]
        if matches:
            places.append(matches[0])
        elif number < 6:
            return []
    return places


def motchallenge_rows(path: Path) -> tuple[F64, str]:
    """(N, 6 to 10) rows of frame, id, left, top, width, height [px] and more, separated by commas, blanks, or
    semicolons with decimal commas; NaN where a row is shorter than others, (0, 6) of an empty file; and what was left
    out, in a sentence. Before them may be a line of names in any order. Raises InputError: unreadable, a row of another
    length, no numbers, or other boxes."""
    rows = array("d")
    longest = 6
    places = list[int]()
    with expecting(path, f"rows of {EXPECTED}", OSError, UnicodeDecodeError), path.open(encoding="utf-8-sig") as file:
        for number, line in enumerate(file, 1):
            if not line.strip() or line.startswith("#"):
                continue
            if not rows and not places:
                places = named_columns(line)
                if places:
                    continue
            values = _numbers(line, places)
            if not 6 <= len(values) <= CELLS_MAX:
                shown = line.strip()[:80]
                raise InputError(f"{path}: expected 6 to 10 numbers, {EXPECTED}, found in line {number} {shown!r}")
            longest = max(longest, len(values))
            rows.extend(values)
            rows.extend([math.nan] * (CELLS_MAX - len(values)))
    table, note = finite_rows(np.frombuffer(rows, dtype=np.float64).reshape(-1, CELLS_MAX)[:, :longest])
    refuse_misread(table[:, 2:6], str(path))
    return table, note


def _numbers(line: str, places: Sequence[int]) -> list[float]:
    """The numbers of a row, at some places or all; none where one is not a number."""
    if ";" in line:
        line = line.replace(",", ".")
    cells = re.sub('[,;"]', " ", line).split()
    try:
        return [float(cells[place]) for place in places or range(len(cells))]
    except (ValueError, IndexError):
        return []


def finite_rows(table: F64) -> tuple[F64, str]:
    """The rows whose frame, id and box are numbers, and how many are not, in a sentence."""
    is_finite = np.isfinite(table[:, :6]).all(axis=1)
    odd = int((~is_finite).sum())
    note = f"{odd} of {len(table)} rows hold inf or NaN and are left out" if odd else ""
    return table[is_finite], note


def refuse_misread(boxes: F64, source: str) -> None:
    """Refuse (N, 4) boxes that are not left, top, width, height [px]. Raises InputError: fractions of the image, or
    two corners: a width that always exceeds the left edge, and grows with it, is a right edge."""
    boxes = boxes[(boxes[:, 2:] > 0).all(axis=1)]  # unknown boxes are -1
    if not len(boxes):
        return
    largest = boxes[:, 2:].max()
    if largest <= 1.0:
        raise InputError(
            f"{source}: expected boxes in pixels, found none larger than a pixel, up to {largest:g}: "
            "fractions of the image"
        )
    right = boxes[:, 2]
    are_beyond = len(boxes) >= CORNERS_MIN and bool((boxes[:, 2:] > boxes[:, :2]).all())
    if are_beyond and np.std(right - boxes[:, 0]) < CORNERS_SPREAD * np.std(right):
        raise InputError(
            f"{source}: expected left, top, width, height of boxes, found left, top, right, bottom: every width is "
            "larger than its left edge and grows with it"
        )


def refuse_outside(boxes: F64, size: tuple[int, int], source: str) -> None:
    """Refuse (N, 4) boxes that are not of images of (width, height) [px]. Raises InputError: too many lie outside."""
    boxes = boxes[(boxes[:, 2:] > 0).all(axis=1)]  # unknown ones are NaN or -1
    centres = boxes[:, :2] + boxes[:, 2:] / 2
    outside = int(((centres < 0) | (centres > size)).any(axis=1).sum())
    if outside > OUTSIDE_MAX * len(boxes):
        right, bottom = (boxes[:, :2] + boxes[:, 2:]).max(axis=0)
        raise InputError(
            f"{source}: expected boxes inside images of {size[0]}x{size[1]}, found {outside} of {len(boxes)} outside, "
            f"up to ({right:.0f}, {bottom:.0f})"
        )


def box_columns(table: F64, path: Path, *, truth: bool = False) -> tuple[dict[str, F64], str]:
    """The people among (N, 6 to 10) rows of frame, id, left, top, width, height and what follows.

    - flag (0 or 1), class, visibility (0 to 1): MOT16 and later, CVAT. Flag 0 is left out of truth.
    - score and class, with nothing or -1 after them; or class, or class and score: a detector of many classes.
    - confidence, X, Y (and Z): MOT15 and PETS, metres on the floor, unknown where all are -1; confidence 0 is left out
      of truth.

    People are the classes that ``labels.txt`` next to the file names (CVAT), else those of the format; a detector's are
    0 where it counts classes from 0, else 1. Raises InputError: truth of which no row counts, or no class of people.

    Returns:
        (M,) columns of ``table_of`` and "score", NaN where a value is unknown; and what was assumed or left out.
    """
    rest = _read_rest(table, path)
    note = ""
    visible = rest.visible
    if rest.classes is not None:
        keep, visible, note = _people_of_classes(rest, rest.classes, path, truth)
    elif truth:
        keep = np.asarray(rest.score != 0)
        if len(table) and not keep.any():
            raise InputError(f"{path}: expected truth rows that count, found the confidence 0 in all of them")
    else:
        keep = np.ones(len(table), dtype=np.bool_)
    has_box = (table[:, 4:6] > 0).all(axis=1, keepdims=True)
    box = np.where(has_box, table[:, 2:6], np.nan)
    columns = np.column_stack([table[:, :2], box, rest.score, rest.floor_m, visible])[keep]
    names = ("frame", "id", *BOX_COLUMNS, "score", "x_m", "y_m", "visible")
    return dict(zip(names, columns.T, strict=True)), note


class _Rest(NamedTuple):
    """The cells behind the boxes of N rows; NaN where there are none.

    Attributes:
        is_flagged: the score is the flag of MOT16 and later.
        where: the column of the classes.
    """

    score: F64
    visible: F64
    floor_m: F64
    classes: F64 | None = None
    where: str = "column 8"
    is_flagged: bool = False


def _read_rest(table: F64, path: Path) -> _Rest:
    """The columns from the seventh on, detected from their values."""
    more = table[:, 6:]
    width = more.shape[1]
    unknown = np.full(len(table), np.nan)
    rest = _Rest(unknown, np.ones(len(table)), np.column_stack([unknown, unknown]))
    if not more.size:
        return rest
    first = more[:, 0]
    if width > 1 and _are_classes(more[:, 1]):
        classes = more[:, 1]
        last = more[:, 2:]
        rest_of_classes = rest._replace(score=first, classes=classes)
        if (np.isnan(last) | (last == -1)).all():
            return rest_of_classes
        has_flags = classes.min() >= 0 and np.isin(first, (0, 1)).all()
        if width == 3 and has_flags and _are_fractions(last):
            return rest_of_classes._replace(visible=last[:, 0], is_flagged=True)
        if width == 4 and has_flags and classes.any() and _are_classes(last):
            raise InputError(f"{path}: expected metres in columns 8 to 10, found classes and occlusion, as of VisDrone")
    if width == 1 or (width == 2 and _are_fractions(more[:, 1])):
        # Unlike scores in percent, classes are one for all rows of an id, with people among them.
        pairs = np.unique(table[table[:, 1] > 0][:, (1, 6)], axis=0)
        are_of_ids = len(pairs) == len(np.unique(pairs[:, 0]))
        if are_of_ids and _are_classes(first) and first.max() > 1 and np.isin(first, (0, 1)).any():
            score = more[:, 1] if width == 2 else unknown
            return rest._replace(score=score, classes=first, where="column 7")
    if width < 3:
        return rest._replace(score=first)
    is_known = np.isfinite(more[:, 1:3]).all(axis=1) & ~(more[:, 1:] == -1).all(axis=1)
    return rest._replace(score=first, floor_m=np.where(is_known[:, None], more[:, 1:3], np.nan))


def _are_classes(column: F64) -> bool:
    """True if all are whole numbers from -1, for unknown, and not all of them are unknown."""
    return bool((column % 1 == 0).all() and column.min() >= -1 and column.max() >= 0)


def _are_fractions(columns: F64) -> bool:
    return bool(((columns >= 0) & (columns <= 1)).all())


def people_among(classes: Iterable[float]) -> tuple[int, ...]:
    """The class of people of a detector: 0 where its classes count from 0, else 1, as in COCO."""
    return (0,) if 0 in set(classes) else (1,)


def left_out_note(people: Iterable[float], others: AnyArray, where: str) -> str:
    """A sentence on the classes of a file; empty where all rows show people."""
    if not len(others):
        return ""
    return f"class {number_list(people)} in {where} is people; class {number_list(others)} is left out"


def _people_of_classes(rest: _Rest, classes: F64, path: Path, truth: bool) -> tuple[Bool, F64, str]:
    """(N,) mask of the rows that count, their unoccluded fraction, and a sentence on the others."""
    named = _people_in_labels(path)
    is_truth = truth and rest.is_flagged
    people = named or ((1,) if is_truth else people_among(classes))
    is_person = np.isin(classes, people)
    if is_truth:
        is_person &= rest.score == 1
    if not is_person.any():
        listed = number_list(np.unique(classes))
        expected = f"rows of people (class {number_list(people)} in {rest.where})"
        if is_truth:
            expected = f"truth rows that count (flag 1, class {number_list(people)}: person)"
            listed += f", flags {number_list(np.unique(rest.score))}"
        raise InputError(f"{path}: expected {expected}, found class {listed}")
    if is_truth and not named:
        excuses = np.isin(classes, DISTRACTORS)
        return is_person | excuses, np.where(excuses, IGNORED, rest.visible), ""
    return is_person, rest.visible, left_out_note(people, np.setdiff1d(classes, people), rest.where)


def _people_in_labels(path: Path) -> tuple[int, ...]:
    """Classes of people, from 1, that ``labels.txt`` next to the file names a line each; empty without it."""
    file = path.parent / "labels.txt"
    if not file.is_file():
        return ()
    names = enumerate(read_text(file, "names of classes").splitlines(), 1)
    return tuple(number for number, name in names if NAMES.search(name))


def number_list(values: Iterable[float]) -> str:
    shown = [f"{value:g}" for value in values]
    return ", ".join(shown[:8]) + (f" and {len(shown) - 8} more" if len(shown) > 8 else "")


def read_motchallenge(path: Path, *, truth: bool) -> TrajectoryFile:
    """Rows of people, frame (from 1; from 0 where there is a 0), id, left, top, width, height and what ``box_columns``
    reads. Raises InputError: a row of another length, values that are not numbers, or truth of which no row counts."""
    table, odd = motchallenge_rows(path)
    if truth and not len(table):
        raise InputError(f"{path}: expected rows of truth, found none")
    if len(table) > 1 and (table[:, 1] == -1).all():
        raise InputError(f"{path}: expected the id of a person in each row, found -1 in all: detections, not tracks")
    columns, note = box_columns(table, path, truth=truth)
    notes = [note, odd]
    if len(table) and table[:, 0].min() == 0:
        notes.insert(0, FROM_ZERO)
    else:
        columns["frame"] = columns["frame"] - 1
    return TrajectoryFile(table_of(columns, path), note="; ".join(filter(None, notes)))


def write_motchallenge(path: Path, file: TrajectoryFile) -> None:
    """Rows of frame (from 1), id, box, confidence (1 where unknown) and world X, Y, Z [m] with Z 0 on the floor; an
    unknown box or position is -1 throughout, heights and times have no column."""
    table = file.table
    floor_m = np.column_stack([table.x_m, table.y_m, np.zeros(len(table))])
    confidence = np.where(np.isfinite(table.confidence), table.confidence, 1.0)
    parts = (table.frame + 1, table.track_id, _or_minus_one(table.box_px), confidence, _or_minus_one(floor_m))
    np.savetxt(path, np.column_stack(parts), ["%d", "%d", *["%.1f"] * 4, "%.4g", *["%.4f"] * 3], delimiter=",")


def _or_minus_one(values: F64) -> F64:
    """(N, M) values, and -1 in the rows of which one is unknown."""
    return np.where(np.isfinite(values).all(axis=1, keepdims=True), values, -1.0)
