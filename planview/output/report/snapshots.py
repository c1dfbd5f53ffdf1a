"""Errors and decisions of a run, with pictures of their snapshots."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np

from calib.errors import InputError, WorkError
from calib.floor_camera import FloorCamera
from calib.images import encode_image
from calib.types import F64, U8
from planview.counting.events import way_words
from planview.drawing.image import ImagePainter
from planview.drawing.people import Snapshot, snapshot_at
from planview.drawing.style import Labels
from planview.evaluation.significant import SignificantError
from planview.output.report.plots import Picture, picture
from planview.output.run_folder import RunFolder
from planview.output.tables import reading_decisions
from planview.tracking.base import ScoreTerms

if TYPE_CHECKING:
    from planview.output.render import SceneFrames


TERMS = ScoreTerms._fields
EVENTS_MAX = 80
"""Decisions listed per person; decisions.csv has them all."""


def read_decision_log(path: Path, people: set[int]) -> dict[int, dict[str, Any]]:
    """The decisions of some people, as the page shows them; empty where there is no decisions.csv.

    Of each person ``events`` (frame, time [s], kind and reason of all but matches), ``more`` of them that are left out,
    and ``scores``, the matches in one sentence. Raises InputError: not a table of decisions."""
    if not path.is_file():
        return {}
    decided: dict[int, tuple[list[tuple[str, ...]], list[list[float]]]] = {}
    with reading_decisions(path) as rows:
        for row in rows:
            if (person := int(row["id"])) in people:
                events, scores = decided.setdefault(person, ([], []))
                if row["kind"] == "matched":
                    scores.append([float(row.get(name) or "nan") for name in ("frame", "value", *TERMS)])
                else:
                    events.append((row["frame"], f"{float(row['timestamp_s']):.2f}", row["kind"], row["reason"]))
    logs: dict[int, dict[str, Any]] = {}
    for person, (events, scores) in decided.items():
        shown = [*events[: EVENTS_MAX - 10], *events[-10:]] if len(events) > EVENTS_MAX else events
        words = _sentence(np.array(scores, dtype=np.float64).reshape(-1, 2 + len(TERMS)))
        logs[person] = {"events": shown, "more": len(events) - len(shown), "scores": words}
    return logs


def _sentence(matched: F64) -> str:
    matches = matched[np.isfinite(matched[:, 1])]
    if not len(matches):
        return f"matched in {len(matched)} frames" if len(matched) else ""
    worst = matches[np.argmax(matches[:, 1])]
    text = (
        f"matched in {len(matches)} frames, {matches[0, 0]:.0f} to {matches[-1, 0]:.0f}; median score "
        f"{np.median(matches[:, 1]):.2f}, worst {worst[1]:.2f} in frame {worst[0]:.0f}"
    )
    if np.isfinite(worst[2:]).all():
        text += " (" + ", ".join(f"{name} {value:.2f}" for name, value in zip(TERMS, worst[2:], strict=True)) + ")"
    return text


ERRORS_MAX = 12
"""Pictures of errors at most, as of crossings: a page stays small enough for a phone."""
STRIP_S = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Frames of a strip, around the beginning of an error [s]."""
TILE_PX, QUALITY = 260, 78
SPREAD = 3
"""Pictures spread over the run besides the busiest frame."""


class _Request(NamedTuple):
    """A picture to be made of a frame; or of one at each of STRIP_S, cropped to a person."""

    title: str
    note: str
    frames: tuple[int, ...]
    focus: tuple[int | None, int | None] | None = None  # ids of truth and track; None: the whole image


class ScenePictures(NamedTuple):
    """The pictures, or why there are none."""

    overview: list[Picture]
    errors: list[Picture]
    crossings: list[Picture]
    why_none: str = ""


def scene_pictures(results: RunFolder, errors: Sequence[SignificantError]) -> ScenePictures:
    """Pictures from the recording, opened again; a recording that is not there any more gives none."""
    if not len(results.tracks) or not results.has_run:
        return ScenePictures([], [], [])
    from planview.output.render import open_frames

    groups = _overview(results), _strips(results, errors), _crossings(results)
    try:
        made = iter(_paint(results, open_frames(results), [request for group in groups for request in group]))
    except (InputError, WorkError) as error:
        return ScenePictures([], [], [], f"No pictures of the scene: {error}.")
    overview, strips, crossings = ([p for p in islice(made, len(group)) if p is not None] for group in groups)
    return ScenePictures(overview, strips, crossings)


def busiest_frame(results: RunFolder) -> int | None:
    """The frame in the middle of the longest stretch with the most people; None without people."""
    found, counts = np.unique(results.tracks.frame[results.of_people], return_counts=True)
    if not len(found):
        return None
    most = found[counts == counts.max()]
    longest = max(np.split(most, np.flatnonzero(np.diff(most) > 1) + 1), key=len)
    return int(longest[len(longest) // 2])


def _overview(results: RunFolder) -> list[_Request]:
    busiest = busiest_frame(results)
    if busiest is None:
        return []
    peopled = np.unique(results.tracks.frame[results.of_people])
    spread = [int(peopled[len(peopled) * part // (SPREAD + 1)]) for part in range(1, SPREAD + 1)]
    titles = [("Busiest frame", busiest), *(("", frame) for frame in spread)]
    return [_Request(title, _when(results, frame), (frame,)) for title, frame in titles]


def _strips(results: RunFolder, errors: Sequence[SignificantError]) -> list[_Request]:
    requests, last = [], max(0, results.n_frames - 1)
    for error in errors[:ERRORS_MAX]:
        frames = tuple(min(max(error.frame + round(s / results.clock.frame_s), 0), last) for s in STRIP_S)
        title, note = f"{error.kind.replace('_', ' ')}: {error.who}", f"{_when(results, error.frame)}: {error.note}"
        requests.append(_Request(title, note, frames, (error.truth_id, error.track_id)))
    return requests


def _crossings(results: RunFolder) -> list[_Request]:
    events = [event for event in results.events if event.kind == "crossing"]
    spread = np.unique(np.linspace(0, len(events) - 1, min(len(events), ERRORS_MAX)).round().astype(int))
    requests = []
    for event in (events[i] for i in spread):
        way = way_words(event.direction, results.rule_counts.get(event.rule, {}).get("inward"))
        note = f"{_when(results, event.frame)}: track {event.track_id} {way}"
        requests.append(_Request(event.rule, note, (event.frame,)))
    return requests


def _when(results: RunFolder, frame: int) -> str:
    return f"frame {frame}, {float(results.clock.at(np.array([frame]))[0]):.1f} s"


def _paint(results: RunFolder, frames: SceneFrames, requests: Sequence[_Request]) -> list[Picture | None]:
    """Read every frame once, in order; a picture whose frames cannot be read is None."""
    painter = ImagePainter(results.camera, results.rules, results.bounds())
    tiles: dict[tuple[int, int], U8] = {}
    # Trails of 4 s.
    trail = round(4.0 / results.clock.frame_s)
    for frame, image in frames.at(sorted({frame for request in requests for frame in request.frames})):
        snapshot = snapshot_at(results.tracks, frame, trail, results.truth)
        painted = painter(image, snapshot)
        for n, request in enumerate(requests):
            if frame in request.frames:
                place = _place(snapshot, request.focus, results.camera) if request.focus else None
                scale = painted.shape[1] / image.shape[1]
                tiles[n, frame] = painted if request.focus is None else _crop(painted, place, scale)
    return [
        _picture(request, [tiles.get((n, frame)) for frame in request.frames]) for n, request in enumerate(requests)
    ]


def _picture(request: _Request, tiles: Sequence[U8 | None]) -> Picture | None:
    known = [tile for tile in tiles if tile is not None]
    if not known:
        return None
    if request.focus is None:
        return picture(request.title, encode_image(known[0], quality=QUALITY), request.note, kind="jpeg")
    row = []
    for tile, time_s in zip(tiles, STRIP_S, strict=True):
        shown = np.full((TILE_PX, TILE_PX, 3), 128, dtype=np.uint8) if tile is None else tile
        Labels(shown).put(f"{time_s:+.1f} s" if time_s else "0 s", (0, TILE_PX), (30, 30, 30))
        row += [shown, np.full((TILE_PX, 4, 3), 128, dtype=np.uint8)]
    strip = encode_image(np.hstack(row[:-1]), quality=QUALITY)
    return picture(request.title, strip, request.note, is_strip=True, kind="jpeg")


def _place(snapshot: Snapshot, focus: tuple[int | None, int | None], camera: FloorCamera | None) -> F64 | None:
    """Where the person concerned is in the image [px]: by the truth, else by the track."""
    for people, focused in ((snapshot.truth, focus[0]), (snapshot.people, focus[1])):
        for person in (p for p in people if p.track_id == focused):
            left, top, width, height = person.box_px
            if np.isfinite(left):
                return np.array([left + width / 2, top + height / 2])
            if camera is not None and np.isfinite(person.x_m):
                place = camera.project(np.array([person.x_m, person.y_m, 1.0]))
                if np.isfinite(place).all():
                    return place
    return None


def _crop(picture: U8, place: F64 | None, scale: float) -> U8:
    """A square tile around a place, as far as it is in the image; the middle of the image without a place."""
    height, width = picture.shape[:2]
    # Side of a tile as a share of the image's height.
    side = round(0.62 * min(height, width))
    x, y = (width / 2, height / 2) if place is None else place * scale
    left, top = int(np.clip(x - side / 2, 0, width - side)), int(np.clip(y - side / 2, 0, height - side))
    part = picture[top : top + side, left : left + side]
    return np.asarray(cv2.resize(part, (TILE_PX, TILE_PX), interpolation=cv2.INTER_AREA), dtype=np.uint8)
