"""Errors and decisions of a run, with pictures of their snapshots."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

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

if TYPE_CHECKING:
    from planview.output.render import SceneFrames


DECISIONS_MAX = 80
"""Decisions listed per person; decisions.csv has them all."""


def read_decision_log(path: Path, people: set[int]) -> dict[int, list[tuple[str, ...]]]:
    """Frame, time [s], kind and reason of the decisions on some people, without matches; empty where there is no
    decisions.csv. Raises InputError: not a table of decisions."""
    if not path.is_file():
        return {}
    logs: dict[int, list[tuple[str, ...]]] = {}
    with reading_decisions(path) as rows:
        for row in rows:
            person = int(row["id"])
            if person in people and row["kind"] != "matched":
                decision = row["frame"], f"{float(row['timestamp_s']):.2f}", row["kind"], row["reason"]
                logs.setdefault(person, []).append(decision)
    return logs


ERRORS_MAX = 12
"""Pictures of errors at most, as of crossings: a page stays small enough for a phone."""
STRIP_S = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Frames of a strip, around the beginning of an error [s]."""
TILE_PX = 260
GAP_PX = 4
JPEG_QUALITY = 78
TRAIL_S = 4.0
SPREAD = 3
"""Pictures spread over the run besides the busiest frame."""


class _Request(NamedTuple):
    """A picture to be made of a frame; or of one at each of STRIP_S, cropped to a person."""

    title: str
    note: str
    frames: tuple[int, ...]
    error: SignificantError | None = None
    """Whose person the tiles show; None for the whole image."""


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

    overview = _overview(results)
    strips = _strips(results, errors)
    crossings = _crossings(results)
    try:
        pictures = iter(_paint(results, open_frames(results), [*overview, *strips, *crossings]))
    except (InputError, WorkError) as error:
        return ScenePictures([], [], [], f"No pictures of the scene: {error}.")
    groups = []
    for requests in (overview, strips, crossings):
        group = islice(pictures, len(requests))
        groups.append([shown for shown in group if shown is not None])
    return ScenePictures(groups[0], groups[1], groups[2])


def busiest_frame(results: RunFolder) -> int | None:
    """The frame in the middle of the longest stretch with the most people; None without people."""
    frames, counts = np.unique(results.tracks.frame[results.of_people], return_counts=True)
    if not len(frames):
        return None
    busiest = frames[counts == counts.max()]
    stretches = np.split(busiest, np.flatnonzero(np.diff(busiest) > 1) + 1)
    longest = max(stretches, key=len)
    return int(longest[len(longest) // 2])


def _overview(results: RunFolder) -> list[_Request]:
    """The busiest frame, and some spread over those with people."""
    busiest = busiest_frame(results)
    if busiest is None:
        return []
    requests = [_Request("Busiest frame", _when(results, busiest), (busiest,))]
    peopled = np.unique(results.tracks.frame[results.of_people])
    for part in range(1, SPREAD + 1):
        frame = int(peopled[len(peopled) * part // (SPREAD + 1)])
        requests.append(_Request("", _when(results, frame), (frame,)))
    return requests


def _strips(results: RunFolder, errors: Sequence[SignificantError]) -> list[_Request]:
    """Frames around the beginnings of errors."""
    last = max(0, results.n_frames - 1)
    requests = []
    for error in errors[:ERRORS_MAX]:
        frames = [error.frame + round(offset_s / results.clock.frame_s) for offset_s in STRIP_S]
        title = f"{error.kind.replace('_', ' ')}: {error.who}"
        note = f"{_when(results, error.frame)}: {error.note}"
        requests.append(_Request(title, note, tuple(min(max(frame, 0), last) for frame in frames), error))
    return requests


def _crossings(results: RunFolder) -> list[_Request]:
    """Frames of crossings, spread over all of them."""
    crossings = [event for event in results.events if event.kind == "crossing"]
    spread = np.linspace(0, len(crossings) - 1, min(len(crossings), ERRORS_MAX)).round().astype(int)
    requests = []
    for n in np.unique(spread):
        event = crossings[n]
        inward = results.rule_counts.get(event.rule, {}).get("inward")
        note = f"{_when(results, event.frame)}: track {event.track_id} {way_words(event.direction, inward)}"
        requests.append(_Request(event.rule, note, (event.frame,)))
    return requests


def _when(results: RunFolder, frame: int) -> str:
    return f"frame {frame}, {float(results.clock.at(np.array([frame]))[0]):.1f} s"


def _paint(results: RunFolder, frames: SceneFrames, requests: Sequence[_Request]) -> list[Picture | None]:
    """Read every frame once, in order; a picture whose frames cannot be read is None."""
    painter = ImagePainter(results.camera, results.rules, results.bounds())
    trail_frames = round(TRAIL_S / results.clock.frame_s)
    wanted = {frame for request in requests for frame in request.frames}
    tiles: dict[tuple[int, int], U8] = {}
    for frame, image in frames.at(sorted(wanted)):
        snapshot = snapshot_at(results.tracks, frame, trail_frames, results.truth)
        painted = painter(image, snapshot)
        for n, request in enumerate(requests):
            if frame not in request.frames:
                continue
            tiles[n, frame] = painted
            if request.error is not None:
                place = _place(snapshot, request.error, results.camera)
                tiles[n, frame] = _crop(painted, place, painted.shape[1] / image.shape[1])
    pictures = []
    for n, request in enumerate(requests):
        pictures.append(_picture(request, [tiles.get((n, frame)) for frame in request.frames]))
    return pictures


def _picture(request: _Request, tiles: Sequence[U8 | None]) -> Picture | None:
    """The whole image, or a strip of tiles, grey where a frame cannot be read; None where none can."""
    readable = [tile for tile in tiles if tile is not None]
    if not readable:
        return None
    if request.error is None:
        return picture(request.title, encode_image(readable[0], quality=JPEG_QUALITY), request.note, kind="jpeg")
    gap: U8 = np.full((TILE_PX, GAP_PX, 3), 128, dtype=np.uint8)
    row: list[U8] = []
    for tile, time_s in zip(tiles, STRIP_S, strict=True):
        shown = np.full((TILE_PX, TILE_PX, 3), 128, dtype=np.uint8) if tile is None else tile
        Labels(shown).put(f"{time_s:+.1f} s" if time_s else "0 s", (0, TILE_PX), (30, 30, 30))
        row += [shown, gap]
    strip = encode_image(np.hstack(row[:-1]), quality=JPEG_QUALITY)
    return picture(request.title, strip, request.note, is_strip=True, kind="jpeg")


def _place(snapshot: Snapshot, error: SignificantError, camera: FloorCamera | None) -> F64 | None:
    """Place in the image of the person of an error [px]: by the truth, else by the track."""
    people = [person for person in snapshot.truth if person.track_id == error.truth_id]
    people += [person for person in snapshot.people if person.track_id == error.track_id]
    for person in people:
        left, top, width, height = person.box_px
        if np.isfinite(left):
            return np.array([left + width / 2, top + height / 2])
        if camera is not None and np.isfinite(person.x_m):
            place = camera.project(np.array([person.x_m, person.y_m, 1.0]))
            if np.isfinite(place).all():
                return place
    return None


TILE_SHARE = 0.62
"""Side of a tile as a share of the shorter side of the image."""


def _crop(picture: U8, place: F64 | None, scale: float) -> U8:
    """A square tile around a place, as far as it is in the image; the middle of the image without a place."""
    height, width = picture.shape[:2]
    side = round(TILE_SHARE * min(height, width))
    middle = np.array([width / 2, height / 2]) if place is None else place * scale
    left, top = np.clip(middle - side / 2, 0, [width - side, height - side]).astype(int)
    part = picture[top : top + side, left : left + side]
    return np.asarray(cv2.resize(part, (TILE_PX, TILE_PX), interpolation=cv2.INTER_AREA), dtype=np.uint8)
