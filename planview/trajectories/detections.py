"""Boxes that a detector found, per frame: MOTChallenge det.txt and COCO results."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import InputError
from calib.io import expecting, read_text, require_file
from calib.types import F64
from planview.trajectories.boxes import (
    FROM_ZERO,
    box_columns,
    finite_rows,
    left_out_note,
    motchallenge_rows,
    number_list,
    people_among,
    refuse_misread,
    refuse_outside,
)
from planview.trajectories.table import BOX_COLUMNS, ordinal

FRAMES_MAX = 10_000_000
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
        boxes = tuple(_scored_boxes(frame, f"frame {n}", source) for n, frame in enumerate(frames))
        table = _together(boxes)
        refuse_misread(table[:, :4], source)
        scores = table[:, 4]
        scored = len(scores) > 0 and bool(0 <= scores.min() < scores.max() <= 1)
        with_boxes = np.flatnonzero([len(array) for array in boxes])
        if len(with_boxes) > 2:
            step = int(np.gcd.reduce(np.diff(with_boxes)))
            if step > 1:
                every_nth = Detections(boxes, scored, source, note, step)
                return every_nth._noting(
                    f"boxes are of every {ordinal(step)} frame: nothing is concluded from the others"
                )
        return Detections(boxes, scored, source, note)

    def _noting(self, sentence: str) -> Detections:
        return replace(self, note="; ".join(filter(None, (self.note, sentence))))

    @property
    def summary(self) -> str:
        """Whose boxes these are, in a sentence."""
        scores = _together(self.frames)[:, 4]
        text = f"{len(scores):,} boxes in {len(self.frames)} frames of {Path(self.source).name}"
        if self.scored:
            text += "; scores count as probabilities"
        elif len(np.unique(scores)) > 1:
            text += "; scores are not between 0 and 1, and are ignored"
        return f"{text}; {self.note}" if self.note else text

    def within(self, size: tuple[int, int]) -> Detections:
        """Self for images of (width, height) [px]. Raises InputError: boxes that are not of such images."""
        refuse_outside(_together(self.frames)[:, :4], size, self.source)
        return self

    def at(self, frame: int) -> F64:
        """(N, 5) boxes of a frame."""
        return self.frames[frame] if 0 <= frame < len(self.frames) else np.empty((0, 5))

    def is_searched(self, frame: int) -> bool:
        """True if the detector searched a frame: one that skips frames leaves those without boxes."""
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
        return self._noting(doubt)


def _scored_boxes(frame: ArrayLike, name: str, source: str) -> F64:
    """(N, 5) boxes of a frame with their scores, 1 where they have none."""
    array = np.asarray(frame, dtype=np.float64)
    if array.size == 0:
        return np.empty((0, 5))
    if array.ndim != 2 or array.shape[1] not in (4, 5):
        raise InputError(f"{source}: expected (N, 4) or (N, 5) boxes in {name}, found {array.shape}")
    if not np.isfinite(array).all() or (array[:, 2:4] <= 0).any():
        raise InputError(f"{source}: expected finite boxes with an area in {name}, found others")
    if array.shape[1] == 4:
        return np.column_stack([array, np.ones(len(array))])
    return array


def _together(frames: Sequence[F64]) -> F64:
    """(M, 5) boxes of all frames."""
    return np.concatenate([*frames, np.empty((0, 5))])


def load_detections(path: Path) -> Detections:
    """Rows of a MOTChallenge det.txt, or a list of COCO results in JSON.

    det.txt (motchallenge.net): frame, id (ignored), left, top, width, height and, where present, the score and more.
    COCO results (cocodataset.org, "format-results"): objects with image_id, category_id, bbox and score; people have
    the category 1 (0 where categories count from 0), and the image_id counts the frames. Frames count from 0 where
    there is a frame 0, else from 1. Raises InputError: neither, with the line or the entry, and what was found there.
    """
    require_file(path, "detections (MOTChallenge det.txt or COCO results)")
    with path.open("rb") as file:
        start = file.read(1000).removeprefix(b"\xef\xbb\xbf").lstrip()
    if start.startswith((b"[", b"{")):
        table, notes = _read_coco(path)
    else:
        table, notes = _read_det(path)
    if not len(table):
        raise InputError(f"{path}: expected boxes of people, found none")
    frame = table[:, 0].astype(np.int64)
    if frame.min() == 0:
        notes.insert(0, FROM_ZERO)
    else:
        frame -= 1
    order = np.argsort(frame, kind="stable")
    ends = np.searchsorted(frame[order], np.arange(frame.max()), side="right")
    frames = np.split(table[order, 1:], ends)
    return Detections.of(frames, str(path), "; ".join(filter(None, notes)))


def _read_det(path: Path) -> tuple[F64, list[str]]:
    """(N, 6) frame, box and score of people, and what was assumed or left out."""
    rows, odd = motchallenge_rows(path)
    _refuse_no_boxes(rows[:, (0, *range(2, 6))], path)
    columns, note = box_columns(rows, path)
    table = np.column_stack([columns[name] for name in ("frame", *BOX_COLUMNS, "score")])
    table[~np.isfinite(table[:, 5]), 5] = 1.0
    return table, [note, odd]


def _read_coco(path: Path) -> tuple[F64, list[str]]:
    """(N, 6) frame, box and score of people, and what was assumed or left out."""
    with expecting(path, "COCO results in JSON", ValueError, RecursionError):
        entries = json.loads(read_text(path, "COCO results", MAX_BYTES))
    if not isinstance(entries, list):
        raise InputError(f"{path}: expected COCO results, a list of objects with image_id and bbox, found an object")
    rows = []
    for number, entry in enumerate(entries, 1):
        try:
            left, top, width, height = entry["bbox"]
            category = entry.get("category_id", PERSON_CLASS)
            cells = (entry["image_id"], left, top, width, height, entry.get("score", 1.0), category)
            rows.append([float(cell) for cell in cells])
        except (TypeError, KeyError, ValueError, AttributeError, OverflowError) as error:
            expected = '{"image_id": frame number, "bbox": [left, top, width, height], "score": ...}'
            shown = json.dumps(entry)[:80]
            raise InputError(f"{path}: expected {expected}, found in entry {number} {shown!r}") from error
    table, odd = finite_rows(np.array(rows, dtype=np.float64).reshape(-1, 7))
    _refuse_no_boxes(table, path)
    categories = np.unique(table[:, 6])
    people = people_among(categories)
    is_person = np.isin(table[:, 6], people)
    if len(table) and not is_person.any():
        raise InputError(f"{path}: expected boxes of category 1 (people), found category {number_list(categories)}")
    note = left_out_note(people, np.setdiff1d(categories, people), "category_id")
    if people == (0,) and not note:
        note = "class 0 in category_id is people"
    return table[is_person, :6], [note, odd]


def _refuse_no_boxes(table: F64, path: Path) -> None:
    """Refuse (N, 5 or more) rows that do not begin with a frame number and the box of a detector."""
    frame = table[:, 0]
    is_frame = (frame % 1 == 0) & (frame >= 0) & (frame <= FRAMES_MAX)
    for row in table[~is_frame][:1]:
        raise InputError(f"{path}: expected frames from 0 to {FRAMES_MAX}, found {_frame_and_box(row)}")
    is_flat = (table[:, 3:5] <= 0).any(axis=1)
    for row in table[is_flat][:1]:
        raise InputError(f"{path}: expected boxes with a width and height above 0, found in {_frame_and_box(row)}")


def _frame_and_box(row: F64) -> str:
    """Frame and box of a row, as the file has them, to search for."""
    frame, *box = (f"{value:.10g}" for value in row[:5])
    return f"frame {frame} {','.join(box)}"
