"""What differs between a run and the same frames tracked again."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np

from calib.types import U8
from planview.evaluation.metrics import clear_scores
from planview.evaluation.sequence import build_sequence, floor_similarity
from planview.output.debug.again import TrackedAgain
from planview.output.scene.compose import SceneComposer
from planview.output.scene.frames import SceneFrames
from planview.output.scene.results import RunResults
from planview.trajectories.table import Trajectories

GATE_M = 0.5
"""People of both within this are the same person [m]."""
MOVED_M = 0.02
"""Positions that differ by less count as the same [m]."""
DECISIONS_MAX = 20
TITLE_PX = 30


def difference_text(results: RunResults, again: TrackedAgain, frame: int) -> list[str]:
    """Lines: when tracks begin to differ, people at the frame in both, and decisions that only one of them made."""
    before = _between(results.tracks, again.first, frame)
    after = _between(again.results.tracks, again.first, frame)
    lines = [_beginning(before, after)]
    lines += _people(before.where(before.frame == frame), after.where(after.frame == frame))
    lines += _decisions(results.folder / "decisions.csv", again, frame)
    return lines


def difference_picture(
    results: RunResults, again: TrackedAgain, frames: SceneFrames | None, frame: int, title: str
) -> U8:
    """(H, W, 3) uint8 BGR: the frame as it was tracked on top, as it is tracked now below."""
    image = next((image for _, image in frames.at([frame])), None) if frames is not None else None
    shown = [SceneComposer(each, frames, bounds=results.bounds())(frame, image) for each in (results, again.results)]
    width = max(picture.shape[1] for picture in shown)
    rows = []
    for picture, text in zip(shown, ("as it was run", title), strict=True):
        strip: U8 = np.full((TITLE_PX, width, 3), 235, dtype=np.uint8)
        cv2.putText(strip, text, (8, TITLE_PX - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (40, 40, 40), 1, cv2.LINE_AA)
        padded = cv2.copyMakeBorder(picture, 0, 0, 0, width - picture.shape[1], cv2.BORDER_CONSTANT, value=(255,) * 3)
        rows += [strip, np.asarray(padded, dtype=np.uint8)]
    return np.vstack(rows)


def _between(tracks: Trajectories, first: int, last: int) -> Trajectories:
    return tracks.where((tracks.frame >= first) & (tracks.frame <= last) & (tracks.state != "tentative"))


def _beginning(before: Trajectories, after: Trajectories) -> str:
    """The first frame whose people differ in number, id, state or place."""
    keys = [_rows(table) for table in (before, after)]
    differing = sorted({frame for frame, *_ in keys[0] ^ keys[1]})
    return f"tracks differ from frame {differing[0]} on" if differing else "tracks are the same up to this frame"


def _rows(table: Trajectories) -> set[tuple[int, int, str, int, int]]:
    x, y = (
        np.round(np.nan_to_num(values, nan=-1e6) / MOVED_M).astype(int).tolist() for values in (table.x_m, table.y_m)
    )
    return set(zip(table.frame.tolist(), table.track_id.tolist(), table.state.tolist(), x, y, strict=True))


def _people(before: Trajectories, after: Trajectories) -> list[str]:
    """A line per person at the frame; the same person in both by place, since ids may differ."""
    known = [table.where(np.isfinite(table.x_m)) for table in (before, after)]
    matches = clear_scores(build_sequence(known[0], known[1], floor_similarity(GATE_M))).matches.tolist()
    lines = []
    for a, b in matches:
        apart = float(np.hypot(known[0].x_m[a] - known[1].x_m[b], known[0].y_m[a] - known[1].y_m[b]))
        old, new = _described(known[0], a), _described(known[1], b)
        lines.append(f"{old} -> {new}, {100 * apart:.0f} cm apart")
    for table, taken, which in (
        (known[0], {a for a, _ in matches}, "only before"),
        (known[1], {b for _, b in matches}, "only now"),
    ):
        lines += [f"{which}: {_described(table, row)}" for row in range(len(table)) if row not in taken]
    return lines


def _described(table: Trajectories, row: int) -> str:
    return f"{table.track_id[row]} ({table.state[row]}, {table.x_m[row]:.2f}, {table.y_m[row]:.2f} m)"


def _decisions(path: Path, again: TrackedAgain, last: int) -> list[str]:
    """Decisions that only one of the runs made, the latest ones; none where the run kept no decisions."""
    if not path.is_file():
        return ["no decisions.csv to compare decisions with (planview run --debug writes it)"]
    with path.open(newline="", encoding="utf-8") as file:
        rows = [
            (int(row["frame"]), f"{row['id']} {row['kind']}: {row['reason']}")
            for row in csv.DictReader(file)
            if row["kind"] != "matched" and again.first <= int(row["frame"]) <= last
        ]
    now = [(frame, f"{d.track_id} {d.kind}: {d.reason}") for frame, d in again.decisions]
    only = [(frame, f"only before, frame {frame}: {text}") for frame, text in rows if (frame, text) not in set(now)]
    only += [(frame, f"only now, frame {frame}: {text}") for frame, text in now if (frame, text) not in set(rows)]
    only.sort(key=lambda item: item[0])
    more = len(only) - DECISIONS_MAX
    return ([f"{more} earlier decisions that differ are left out"] if more > 0 else []) + [
        t for _, t in only[-DECISIONS_MAX:]
    ]
