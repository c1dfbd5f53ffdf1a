"""Boxes of people that a detector elsewhere found, frame by frame."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import InputError
from calib.io import read_text
from calib.types import F64

MAX_BYTES = 1 << 29
FRAMES_MAX = 10_000_000
OUTSIDE_MAX = 0.1
"""Share of boxes whose centre may lie outside of the image: people at its border (our choice)."""
PERSON = 1
"""Category of people in COCO."""


@dataclass(frozen=True, eq=False)
class Detections:
    """Boxes per frame.

    Attributes:
        frames: per frame of the recording, from 0, (N, 5) float64: left, top, width, height [px], score; frames after
            the last have none.
        scored: scores are probabilities that a box shows a person; false where they are all alike or of another scale,
            and say nothing.
        source: where they are from, for messages.
    """

    frames: tuple[F64, ...]
    scored: bool
    source: str

    @staticmethod
    def of(frames: Sequence[ArrayLike], source: str = "detections") -> Detections:
        """From an array per frame, (N, 4) boxes or (N, 5) with a score.

        Raises:
            InputError: another shape, a value that is not finite, or a box without an area.
        """
        boxes = []
        for index, frame in enumerate(frames):
            array = np.asarray(frame, dtype=np.float64)
            array = array.reshape(0, 5) if array.size == 0 else array
            if array.ndim != 2 or array.shape[1] not in (4, 5):
                raise InputError(f"{source}: expected (N, 4) or (N, 5) boxes in frame {index}, found {array.shape}")
            if not np.isfinite(array).all() or (array[:, 2:4] <= 0).any():
                raise InputError(f"{source}: expected finite boxes with an area in frame {index}, found others")
            refuse_fractions(array, source)
            boxes.append(np.column_stack([array, np.ones(len(array))]) if array.shape[1] == 4 else array)
        scores = np.concatenate([frame[:, 4] for frame in boxes] or [np.empty(0)])
        scored = len(scores) > 0 and 0 <= scores.min() < scores.max() <= 1
        return Detections(tuple(boxes), bool(scored), source)

    def within(self, size: tuple[int, int]) -> Detections:
        """Self for images of (width, height) [px]. Raises InputError: boxes that are not of such images."""
        boxes = np.concatenate([*self.frames, np.empty((0, 5))])
        centres = boxes[:, :2] + boxes[:, 2:4] / 2
        outside = ((centres < 0) | (centres > size)).any(axis=1)
        if outside.sum() > OUTSIDE_MAX * len(boxes):
            right, bottom = (boxes[:, :2] + boxes[:, 2:4]).max(axis=0)
            raise InputError(
                f"{self.source}: expected boxes inside images of {size[0]}x{size[1]}, found {outside.sum()} of "
                f"{len(boxes)} outside, up to ({right:.0f}, {bottom:.0f})"
            )
        return self

    def at(self, frame: int) -> F64:
        """(N, 5) boxes of a frame."""
        return self.frames[frame] if 0 <= frame < len(self.frames) else np.empty((0, 5))


def refuse_fractions(boxes: F64, source: str) -> None:
    """Refuse (N, 4 or more) boxes of which none is larger than a pixel. Raises InputError: fractions of the image."""
    sizes = boxes[(boxes[:, 2:4] > 0).all(axis=1), 2:4]  # unknown boxes are -1
    if len(sizes) and (sizes <= 1.0).all():
        raise InputError(
            f"{source}: expected boxes in pixels, found none larger than a pixel, up to {sizes.max():g}: "
            "fractions of the image"
        )


def load_detections(path: Path) -> Detections:
    """Rows of a MOTChallenge det.txt, or a list of COCO results in JSON.

    det.txt (motchallenge.net): frame (from 1), id (ignored), left, top, width, height and, where present, the score and
    more. COCO results (cocodataset.org, "format-results"): objects with image_id, category_id, bbox and score; people
    have the category 1, and the image_id counts the frames, from 0 where there is a 0, else from 1.

    Raises:
        InputError: neither, with the line or the entry, and what was found there.
    """
    text = read_text(path, "detections (MOTChallenge det.txt or COCO results)", MAX_BYTES).lstrip("\ufeff")
    rows = _coco(path, text) if text.lstrip()[:1] in ("[", "{") else _motchallenge(path, text)
    if not rows:
        raise InputError(f"{path}: expected boxes of people, found none")
    table = np.array(rows)
    table = table[np.argsort(table[:, 0], kind="stable")]
    bounds = np.searchsorted(table[:, 0], np.arange(int(table[-1, 0]) + 2))
    frames = [table[a:b, 1:] for a, b in pairwise(bounds)]
    return Detections.of(frames, str(path))


def _motchallenge(path: Path, text: str) -> list[list[float]]:
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            values = [float(value) for value in line.replace(",", " ").split()]
        except ValueError:
            values = []
        good = 6 <= len(values) <= 10 and all(map(math.isfinite, values))
        if not (good and values[0].is_integer() and 1 <= values[0] <= FRAMES_MAX and min(values[4:6]) > 0):
            empty = len(values) >= 6 and min(values[4:6]) <= 0
            expected = (
                "boxes with a width and height above 0" if empty else "frame (from 1),id,left,top,width,height,score"
            )
            _refuse(path, f"line {number}", expected, line)
        rows.append([values[0] - 1, *values[2:6], values[6] if len(values) > 6 else 1.0])
    return rows


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
            if not whole or len(box) != 4 or not all(map(math.isfinite, [*box, score])) or min(box[2:]) <= 0:
                raise ValueError
        except (TypeError, KeyError, ValueError, AttributeError, OverflowError):
            what = '{"image_id": frame number, "bbox": [left, top, width, height], "score": ...}'
            _refuse(path, f"entry {number}", what, json.dumps(entry))
        if category == PERSON:
            rows.append([float(frame), *box, score])
    first = min((row[0] for row in rows), default=0.0)
    if listed and not rows:
        found = sorted({str(entry["category_id"])[:20] for entry in listed})[:8]
        raise InputError(f"{path}: expected boxes of category {PERSON} (people), found category {', '.join(found)}")
    return [[row[0] - min(first, 1.0), *row[1:]] for row in rows]


def _refuse(path: Path, where: str, expected: str, found: str) -> NoReturn:
    raise InputError(f"{path}: expected {expected}, found in {where} {found.strip()[:80]!r}")
