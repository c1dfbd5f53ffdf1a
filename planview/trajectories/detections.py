"""Boxes of people that a detector elsewhere found, frame by frame."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import InputError
from calib.io import read_text, require_file
from calib.types import F64
from planview.trajectories.motchallenge import FRAMES_MAX, motchallenge_rows, refuse_fractions, refuse_outside

MAX_BYTES = 1 << 29
PERSON = 1
"""Category of people in COCO."""


@dataclass(frozen=True, eq=False)
class Detections:
    """Boxes per frame, and where they are from, for messages.

    Attributes:
        frames: per frame of the recording, from 0, (N, 5) float64: left, top, width, height [px], score; frames after
            the last have none.
        scored: scores are probabilities that a box shows a person; false where they are all alike or of another scale.
    """

    frames: tuple[F64, ...]
    scored: bool
    source: str

    @staticmethod
    def of(frames: Sequence[ArrayLike], source: str = "detections") -> Detections:
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
            refuse_fractions(array[:, :4], source)
            boxes.append(np.column_stack([array, np.ones(len(array))]) if array.shape[1] == 4 else array)
        scores = np.concatenate([frame[:, 4] for frame in boxes] or [np.empty(0)])
        scored = len(scores) > 0 and 0 <= scores.min() < scores.max() <= 1
        return Detections(tuple(boxes), bool(scored), source)

    def within(self, size: tuple[int, int]) -> Detections:
        """Self for images of (width, height) [px]. Raises InputError: boxes that are not of such images."""
        refuse_outside(np.concatenate([*self.frames, np.empty((0, 5))])[:, :4], size, self.source)
        return self

    def at(self, frame: int) -> F64:
        """(N, 5) boxes of a frame."""
        return self.frames[frame] if 0 <= frame < len(self.frames) else np.empty((0, 5))


def load_detections(path: Path) -> Detections:
    """Rows of a MOTChallenge det.txt, or a list of COCO results in JSON.

    det.txt (motchallenge.net): frame (from 1), id (ignored), left, top, width, height and, where present, the score and
    more. COCO results (cocodataset.org, "format-results"): objects with image_id, category_id, bbox and score; people
    have the category 1, and the image_id counts the frames, from 0 where there is a 0, else from 1. Raises InputError:
    neither, with the line or the entry, and what was found there.
    """
    require_file(path, "detections (MOTChallenge det.txt or COCO results)")
    with path.open("rb") as file:
        is_json = file.read(1000).removeprefix(b"\xef\xbb\xbf").lstrip()[:1] in (b"[", b"{")
    if is_json:
        table = np.array(_coco(path, read_text(path, "COCO results", MAX_BYTES)))
    else:
        rows = motchallenge_rows(path, of_detector=True)
        score = rows[:, 6] if rows.shape[1] > 6 else np.ones(len(rows))
        table = np.column_stack([rows[:, 0] - 1, rows[:, 2:6], np.where(np.isfinite(score), score, 1.0)])
    if not len(table):
        raise InputError(f"{path}: expected boxes of people, found none")
    table = table[np.argsort(table[:, 0], kind="stable")]
    bounds = np.searchsorted(table[:, 0], np.arange(int(table[-1, 0]) + 2))
    frames = [table[a:b, 1:] for a, b in pairwise(bounds)]
    return Detections.of(frames, str(path))


def _coco(path: Path, text: str) -> list[list[float]]:
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
            frame, box = entry["image_id"], [float(value) for value in entry["bbox"]]
            category, score = entry.get("category_id", PERSON), float(entry.get("score", 1.0))
            whole = isinstance(frame, int) and 0 <= frame <= FRAMES_MAX
            if not whole or len(box) != 4 or not all(map(math.isfinite, [*box, score])):
                raise ValueError
            expected = "boxes with a width and height above 0" if min(box[2:]) <= 0 else ""
        except (TypeError, KeyError, ValueError, AttributeError, OverflowError):
            expected = '{"image_id": frame number, "bbox": [left, top, width, height], "score": ...}'
        if expected:
            found = json.dumps(entry)[:80]
            raise InputError(f"{path}: expected {expected}, found in entry {number} {found!r}")
        if category == PERSON:
            rows.append([float(frame), *box, score])
    first = min((row[0] for row in rows), default=0.0)
    if listed and not rows:
        others = sorted({str(entry["category_id"])[:20] for entry in listed})[:8]
        raise InputError(f"{path}: expected boxes of category {PERSON} (people), found category {', '.join(others)}")
    return [[row[0] - min(first, 1.0), *row[1:]] for row in rows]
