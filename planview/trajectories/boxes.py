"""Boxes of people in images: rows of MOTChallenge, VisDrone, CVAT, PETS and of detectors, and what is found in them."""

from __future__ import annotations

import json
import math
import re
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import InputError
from calib.io import expecting, read_text, require_file
from calib.types import F64, Bool
from planview.trajectories.file import TrajectoryFile
from planview.trajectories.table import BOX_COLUMNS, IGNORED, ordinal, table_of

FRAMES_MAX = 10_000_000
COLUMNS = "frame (from 1),id,left,top,width,height"
FROM_ZERO = "frames count from 0, since there is a frame 0"
OUTSIDE_MAX = 0.1
"""Share of boxes whose centre may lie outside of the image: people at its border."""
CORNERS_MIN = 10
CORNERS_SPREAD = 0.5
"""Fewest boxes of a file of corners, and most that right less left may vary as a share of right."""
DISTRACTORS = (2, 7, 8, 12)
"""Classes of MOT16 and later that excuse a track (Milan et al. 2016, section 3.2): person on a vehicle, static person,
distractor, reflection."""
VISDRONE_PEOPLE = (1, 2)
"""Pedestrians, and people who do not walk (Zhu et al. 2018, VisDrone)."""
VISIBLE_OF_OCCLUSION = np.array([1.0, 0.75, 0.25])
"""Unoccluded fraction of VisDrone's levels: none, up to half and more than half hidden; the middle of each."""
NAMES = re.compile(r"\b(person|people|pedestrian|human|man|woman|walker)s?\b", re.IGNORECASE)

HEADERS = (
    ("frame", "frame_id", "frame_number", "frame_no", "frame_index"), ("id", "track_id", "trackid", "tid", "identity"),
    ("left", "bb_left", "bbox_left", "x", "bbox_x", "xmin"), ("top", "bb_top", "bbox_top", "y", "bbox_y", "ymin"),
    ("width", "w", "bb_width", "bbox_width", "bbox_w"), ("height", "h", "bb_height", "bbox_height", "bbox_h"),
    ("conf", "confidence", "score"), ("class", "class_id", "cls", "category_id"),
)  # fmt: skip
"""Names of the columns in a line before the rows, of which score and class may lack."""


def named_columns(line: str) -> list[int]:
    """Places of frame, id, box, score and class in a line of names; empty of any other line."""
    line = line.strip(" #%\r\n")
    separator = r"[,;\t]" if re.search(r"[,;\t]", line) else r"\s+"
    names = [name.strip(" \"'").lower() for name in re.split(separator, line)]
    places = [next((i for i, name in enumerate(names) if name in known), -1) for known in HEADERS]
    return [] if -1 in places[:6] else [place for place in places if place >= 0]


def motchallenge_rows(path: Path, *, of_detector: bool = False) -> tuple[F64, str]:
    """(N, 6 to 10) rows of frame, id, left, top, width, height [px] and more, separated by commas, blanks, or
    semicolons with decimal commas; NaN where a row is shorter than others, (0, 6) of an empty file; and what was left
    out, in a sentence. Before them may be a line of names in any order. Rows ``of_detector`` are boxes that were found:
    none is -1. Raises InputError: unreadable, a row of another length, no numbers, or other boxes."""
    rows = array("d")
    longest = 6
    places = list[int]()
    with (
        expecting(path, f"rows of {COLUMNS},...", OSError, UnicodeDecodeError),
        path.open(encoding="utf-8-sig") as file,
    ):
        for number, line in enumerate(file, 1):
            if not rows and not places and (places := named_columns(line)):
                continue
            if line.strip() and not line.startswith("#"):
                values = _row(path, number, line, of_detector, places)
                longest = max(longest, len(values))
                rows.extend(values + [math.nan] * (10 - len(values)))
    table, note = _finite(np.frombuffer(rows, dtype=np.float64).reshape(-1, 10)[:, :longest])
    _refuse_misread(table[:, 2:6], str(path))
    return table, note


def _finite(table: F64) -> tuple[F64, str]:
    """The rows whose frame, id and box are numbers, and how many are not, in a sentence."""
    finite = np.isfinite(table[:, :6]).all(axis=1)
    odd = int((~finite).sum())
    return table[finite], f"{odd} of {len(table)} rows hold inf or NaN and are left out" if odd else ""


def _row(path: Path, number: int, line: str, of_detector: bool, places: Sequence[int]) -> list[float]:
    plain = line.replace(",", ".").replace(";", " ") if ";" in line else line.replace(",", " ")
    try:
        cells = plain.replace('"', " ").split()
        values = [float(cells[place]) for place in places] if places else [float(cell) for cell in cells]
    except (ValueError, IndexError):
        values = []
    expected = f"6 to 10 numbers, {COLUMNS},..."
    good = 6 <= len(values) <= 10
    if good and of_detector and all(map(math.isfinite, values[:6])):
        good = values[0].is_integer() and 0 <= values[0] <= FRAMES_MAX
        if good and min(values[4:6]) <= 0:
            good = False
            expected = "boxes with a width and height above 0"
    if not good:
        raise InputError(f"{path}: expected {expected}, found in line {number} {line.strip()[:80]!r}")
    return values


def _refuse_misread(boxes: F64, source: str) -> None:
    """Refuse (N, 4) boxes that are not left, top, width, height [px]. Raises InputError: fractions of the image, or
    two corners: a width that always exceeds the left edge, and grows with it, is a right edge."""
    boxes = boxes[(boxes[:, 2:] > 0).all(axis=1)]  # unknown boxes are -1
    if len(boxes) and boxes[:, 2:].max() <= 1.0:
        raise InputError(
            f"{source}: expected boxes in pixels, found none larger than a pixel, up to {boxes[:, 2:].max():g}: "
            "fractions of the image"
        )
    corners = len(boxes) >= CORNERS_MIN and bool((boxes[:, 2:] > boxes[:, :2]).all())
    if corners and np.std(boxes[:, 2] - boxes[:, 0]) < CORNERS_SPREAD * np.std(boxes[:, 2]):
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
    - flag, class, truncation (0 or 1), occlusion (0 to 2): VisDrone.
    - score and class, with nothing or -1 after them; or class, or class and score: a detector of many classes.
    - confidence, X, Y (and Z): MOT15 and PETS, metres on the floor, unknown where all are -1; confidence 0 is left out
      of truth.

    People are the classes that ``labels.txt`` next to the file names (CVAT), else those of the format; a detector's are
    0 where it counts classes from 0, else 1. Raises InputError: truth of which no row counts, or no class of people.

    Returns:
        (M,) columns of ``table_of`` and "score", NaN where a value is unknown; and what was assumed or left out.
    """
    more = table[:, 6:]
    kind = _class_column(table)
    unknown = np.full(len(table), np.nan)
    score = more[:, 0] if more.shape[1] else unknown
    visible = np.ones(len(table))
    note = ""
    keep: Bool = np.ones(len(table), dtype=np.bool_)
    floor = np.column_stack([unknown, unknown])
    if kind is not None:
        keep, score, visible, note = _of_classes(table, kind, path, truth)
    elif truth and more.shape[1]:
        keep = np.asarray(score != 0)
        if len(table) and not keep.any():
            raise InputError(f"{path}: expected truth rows that count, found the confidence 0 in all of them")
    if kind is None and more.shape[1] >= 3:
        known = np.isfinite(more[:, 1:3]).all(axis=1) & ~(more[:, 1:] == -1).all(axis=1)
        floor = np.where(known[:, None], more[:, 1:3], np.nan)
    box = np.where((table[:, 4:6] > 0).all(axis=1, keepdims=True), table[:, 2:6], np.nan)
    columns = np.column_stack([table[:, :2], box, score, floor, visible])[keep]
    return dict(zip(("frame", "id", *BOX_COLUMNS, "score", "x_m", "y_m", "visible"), columns.T, strict=True)), note


def people_among(classes: Iterable[float]) -> tuple[int, ...]:
    """The class of people of a detector: 0 where its classes count from 0, else 1, as in COCO."""
    return (0,) if 0 in set(classes) else (1,)


def left_out(people: Iterable[float], others: Iterable[float], where: str) -> str:
    """A sentence on the classes of a file; empty where all rows show people."""
    if not (others := sorted(others)):
        return ""
    return f"class {listed_numbers(people)} in {where} is people; class {listed_numbers(others)} is left out"


def _of_classes(table: F64, kind: int, path: Path, truth: bool) -> tuple[Bool, F64, F64, str]:
    """Which rows count, their score and their unoccluded fraction, and what was left out."""
    more = table[:, 6:]
    classes = more[:, kind]
    visible = np.ones(len(table))
    benchmark = kind == 1 and more.shape[1] > 2 and bool((more[:, 2:] >= 0).all())
    named = _people_in_labels(path)
    usual = people_among(classes)
    if benchmark and more.shape[1] == 4:
        usual = VISDRONE_PEOPLE
        visible = VISIBLE_OF_OCCLUSION[more[:, 3].astype(np.int64)]
    elif benchmark:
        usual = (1,) if truth else usual
        visible = more[:, 2]
    people = named or usual
    person = np.isin(classes, people)
    if benchmark and truth:
        person &= more[:, 0] == 1
    of_mot = benchmark and truth and not named
    excuses = np.isin(classes, DISTRACTORS if of_mot and usual == (1,) else ())
    if not person.any():
        listed = listed_numbers(np.unique(classes))
        expected_classes = listed_numbers(people)
        expected = f"rows of people (class {expected_classes} in column {kind + 7}), found class {listed}"
        if truth and benchmark:
            flags = listed_numbers(np.unique(more[:, 0]))
            expected = (
                f"truth rows that count (flag 1, class {expected_classes}: person), found class {listed}, flags {flags}"
            )
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


def read_motchallenge(path: Path, *, truth: bool) -> TrajectoryFile:
    """Rows of people, frame (from 1; from 0 where there is a 0), id, left, top, width, height and what ``box_columns``
    knows. Raises InputError: a row of another length, values that are not numbers, or truth of which no row counts."""
    table, odd = motchallenge_rows(path)
    if truth and not len(table):
        raise InputError(f"{path}: expected rows of truth, found none")
    if len(table) > 1 and (table[:, 1] == -1).all():
        raise InputError(f"{path}: expected the id of a person in each row, found -1 in all: detections, not tracks")
    from_zero = len(table) > 0 and table[:, 0].min() == 0
    columns, note = box_columns(table, path, truth=truth)
    columns["frame"] = columns["frame"] - (not from_zero)
    notes = filter(None, (FROM_ZERO if from_zero else "", note, odd))
    return TrajectoryFile(table_of(columns, path), note="; ".join(notes))


def write_motchallenge(path: Path, file: TrajectoryFile) -> None:
    """Rows of frame (from 1), id, box, confidence (1 where unknown) and world X, Y, Z [m] with Z 0 on the floor; an
    unknown box or position is -1 throughout, heights and times have no column."""
    table = file.table
    box, floor = (
        np.where(np.isfinite(values).all(axis=1, keepdims=True), values, -1.0)
        for values in (table.box_px, np.column_stack([table.x_m, table.y_m, np.zeros(len(table))]))
    )
    sure = np.where(np.isfinite(table.confidence), table.confidence, 1.0)
    rows = np.column_stack([table.frame + 1, table.track_id, box, sure, floor])
    np.savetxt(path, rows, ["%d", "%d", *["%.1f"] * 4, "%.4g", *["%.4f"] * 3], delimiter=",")


MAX_BYTES = 1 << 29
ENDS_EARLY = 0.9
"""Share of a video's frames up to which detections should go."""
STEP_MAX = 10
"""Most frames that a detector moves on by at a time."""
PERSON_CLASS = 1
"""Category of people in COCO."""


@dataclass(frozen=True, eq=False)
class Detections:
    """Boxes per frame, and where they are from, for messages.

    Attributes:
        frames: per frame of the recording, from 0, (N, 5) float64: left, top, width, height [px], score; frames after
            the last have none.
        scored: scores are probabilities that a box shows a person; false where they are all alike or of another scale.
        note: what was assumed of the file, empty without an assumption.
        step: 1, or n where only every n-th frame has boxes: the detector did not look at the others.
    """

    frames: tuple[F64, ...]
    scored: bool
    source: str
    note: str = ""
    step: int = 1

    @staticmethod
    def of(frames: Sequence[ArrayLike], source: str = "detections", note: str = "") -> Detections:
        """From an array per frame, (N, 4) boxes or (N, 5) with a score. Raises InputError: another shape, a value that
        is not finite, or a box without an area."""
        boxes = []
        for index, frame in enumerate(frames):
            array = np.asarray(frame, dtype=np.float64)
            array = array.reshape(0, 5) if array.size == 0 else array
            if array.ndim != 2 or array.shape[1] not in (4, 5):
                raise InputError(f"{source}: expected (N, 4) or (N, 5) boxes in frame {index}, found {array.shape}")
            if not np.isfinite(array).all() or (array[:, 2:4] <= 0).any():
                raise InputError(f"{source}: expected finite boxes with an area in frame {index}, found others")
            boxes.append(np.column_stack([array, np.ones(len(array))]) if array.shape[1] == 4 else array)
        together = np.concatenate([*boxes, np.empty((0, 5))])
        _refuse_misread(together[:, :4], source)
        scored = len(together) > 0 and 0 <= together[:, 4].min() < together[:, 4].max() <= 1
        with_boxes = np.flatnonzero([len(array) for array in boxes])
        step = int(np.gcd.reduce(np.diff(with_boxes))) if len(with_boxes) > 2 else 1
        skipped = f"boxes are of every {ordinal(step)} frame: nothing is concluded from the others" if step > 1 else ""
        return Detections(tuple(boxes), bool(scored), source, "; ".join(filter(None, (note, skipped))), step)

    @property
    def summary(self) -> str:
        """Whose boxes these are, in a sentence."""
        boxes = f"{sum(map(len, self.frames)):,} boxes in {len(self.frames)} frames of {Path(self.source).name}"
        has_scores = len({score for array in self.frames for score in array[:, 4].tolist()}) > 1
        scores = "scores are not between 0 and 1, and are ignored" * has_scores
        scores = "scores count as probabilities" if self.scored else scores
        return "; ".join(filter(None, (boxes, scores, self.note)))

    def within(self, size: tuple[int, int]) -> Detections:
        """Self for images of (width, height) [px]. Raises InputError: boxes that are not of such images."""
        refuse_outside(np.concatenate([*self.frames, np.empty((0, 5))])[:, :4], size, self.source)
        return self

    def at(self, frame: int) -> F64:
        """(N, 5) boxes of a frame."""
        return self.frames[frame] if 0 <= frame < len(self.frames) else np.empty((0, 5))

    def looked(self, frame: int) -> bool:
        """Whether a frame without boxes shows that nobody was found in it."""
        return self.step == 1 or len(self.at(frame)) > 0

    def of_frames(self, frames: int) -> Detections:
        """Self for a video of ``frames`` frames, with a doubt where the last of them have no boxes: those of every n-th
        frame may be numbered 1, 2, 3. Raises InputError: boxes of later frames."""
        last = len(self.frames)
        if last > frames:
            raise InputError(f"{self.source}: expected boxes of a video of {frames} frames, found frame {last}")
        if last >= ENDS_EARLY * frames:
            return self
        step = round(frames / last)
        doubt = f"boxes end at frame {last} of {frames}"
        if 1 < step <= STEP_MAX and abs(last - frames / step) <= 1:
            doubt += f": are they of every {ordinal(step)} frame? Then number them as the video does"
        return replace(self, note="; ".join(filter(None, (self.note, doubt))))


def load_detections(path: Path) -> Detections:
    """Rows of a MOTChallenge det.txt, or a list of COCO results in JSON.

    det.txt (motchallenge.net): frame, id (ignored), left, top, width, height and, where present, the score and more.
    COCO results (cocodataset.org, "format-results"): objects with image_id, category_id, bbox and score; people have
    the category 1 (0 where categories count from 0), and the image_id counts the frames. Frames count from 0 where
    there is a frame 0, else from 1. Raises InputError: neither, with the line or the entry, and what was found there.
    """
    require_file(path, "detections (MOTChallenge det.txt or COCO results)")
    with path.open("rb") as file:
        is_json = file.read(1000).removeprefix(b"\xef\xbb\xbf").lstrip()[:1] in (b"[", b"{")
    if is_json:
        table, *notes = _coco(path, read_text(path, "COCO results", MAX_BYTES))
    else:
        found, odd = motchallenge_rows(path, of_detector=True)
        columns, note = box_columns(found, path)
        table = np.column_stack([columns[name] for name in ("frame", *BOX_COLUMNS, "score")])
        notes = [note, odd]
        table[~np.isfinite(table[:, 5]), 5] = 1.0
    if not len(table):
        raise InputError(f"{path}: expected boxes of people, found none")
    first = min(int(table[:, 0].min()), 1)
    table[:, 0] -= first
    table = table[np.argsort(table[:, 0], kind="stable")]
    bounds = np.searchsorted(table[:, 0], np.arange(int(table[-1, 0]) + 2))
    frames = [table[a:b, 1:] for a, b in pairwise(bounds)]
    return Detections.of(frames, str(path), "; ".join(filter(None, ["" if first else FROM_ZERO, *notes])))


def _coco(path: Path, text: str) -> tuple[F64, str, str]:
    """(N, 6) frame, box and score of people, and what was left out, in two sentences."""
    try:
        listed = json.loads(text)
    except (ValueError, RecursionError) as error:
        line = f"line {error.lineno}" if isinstance(error, json.JSONDecodeError) else "it"
        raise InputError(f"{path}: expected COCO results, found in {line} what is no JSON") from error
    if not isinstance(listed, list):
        raise InputError(f"{path}: expected COCO results, a list of objects with image_id and bbox, found an object")
    rows = []
    for number, entry in enumerate(listed, 1):
        try:
            frame = entry["image_id"]
            box = [float(value) for value in entry["bbox"]]
            category = float(entry.get("category_id", PERSON_CLASS))
            score = float(entry.get("score", 1.0))
            if not (isinstance(frame, int) and 0 <= frame <= FRAMES_MAX) or len(box) != 4:
                raise ValueError
            expected = "boxes with a width and height above 0" if min(box[2:]) <= 0 else ""
        except (TypeError, KeyError, ValueError, AttributeError, OverflowError):
            expected = '{"image_id": frame number, "bbox": [left, top, width, height], "score": ...}'
        if expected:
            found = json.dumps(entry)[:80]
            raise InputError(f"{path}: expected {expected}, found in entry {number} {found!r}")
        rows.append([float(frame), *box, score, category])
    table, odd = _finite(np.array(rows, dtype=np.float64).reshape(-1, 7))
    categories = np.unique(table[:, 6])
    people = people_among(categories)
    person = np.isin(table[:, 6], people)
    if len(table) and not person.any():
        raise InputError(f"{path}: expected boxes of category 1 (people), found category {listed_numbers(categories)}")
    assumed = "class 0 in category_id is people" if people == (0,) and len(table) else ""
    return table[person, :6], left_out(people, np.setdiff1d(categories, people), "category_id") or assumed, odd
