"""A picture of a significant error: plan view and image at the moment when it begins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from calib.errors import InputError
from calib.types import F64, I32, U8
from planview.drawing.style import as_bgr, person_rgb
from planview.engine.boxes import BodyBoxes
from planview.engine.maps_pipeline import recorded_config
from planview.evaluation.significant import SignificantError
from planview.maps.recording import MapsRecording
from planview.output.folder import read_run_info
from planview.trajectories.table import Trajectories, row_state
from stereo.readers import open_any
from stereo.rectify import Rectifier, RectifyParams

Colour = tuple[int, int, int]
FloorToPixels = Callable[[F64], I32]
SIDE_PX = 320
"""Side of plan view and image crop [px]."""
BEFORE_S, AFTER_S = 2.0, 3.0
"""The plan view shows so much before and after the beginning of the error [s]."""
CROP_SHARE = 0.75
"""Side of the image crop as a share of the image's height."""
_GREY, _BLACK, _VIEW = (150, 150, 150), (0, 0, 0), (225, 240, 225)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, eq=False)
class FailedRun:
    """A scored run: folder of the recording, folder of the run (run.json, maps.h5), its tracks and the truth."""

    recording: Path
    folder: Path
    tracks: Trajectories
    truth: Trajectories


def failure_picture(run: FailedRun, error: SignificantError, fps: float) -> U8:
    """(H, W, 3) BGR: truth (grey, black for the person concerned) and tracks (coloured) on the floor and in the image.

    Raises:
        InputError: a file of the run or the recording is missing or damaged.
    """
    return np.hstack([_plan(run, error, fps), _image(run, error)])


def _plan(run: FailedRun, error: SignificantError, fps: float) -> U8:
    first, last = error.frame - BEFORE_S * fps, error.frame + AFTER_S * fps
    truth, tracks = (t.where((t.frame >= first) & (t.frame <= last)) for t in (run.truth, run.tracks))
    tracks = tracks.where(np.isfinite(tracks.x_m + tracks.y_m))
    to_px = _floor_to_px(np.column_stack([truth.x_m, truth.y_m]))
    canvas = np.full((SIDE_PX, SIDE_PX, 3), 255, np.uint8)
    rig = read_run_info(run.folder / "run.json").rig
    if rig is not None and rig.view_m:
        cv2.fillPoly(canvas, [to_px(np.array(rig.view_m, np.float64))], _VIEW)
    for person in np.unique(truth.track_id):
        mine = person == error.truth_id
        _path(
            canvas, truth.where(truth.track_id == person), to_px, error.frame, _BLACK if mine else _GREY, f"P{person}"
        )
    for track in np.unique(tracks.track_id):
        _path(
            canvas,
            tracks.where(tracks.track_id == track),
            to_px,
            error.frame,
            as_bgr(person_rgb(int(track))),
            str(track),
        )
    cv2.putText(canvas, f"frame {error.frame}", (6, SIDE_PX - 8), _FONT, 0.4, _BLACK, 1, cv2.LINE_AA)
    return canvas


def _floor_to_px(xy: F64) -> FloorToPixels:
    """A function from (N, 2) floor positions [m] to (N, 2) int32 pixels; all of ``xy`` are inside, y points up."""
    low, high = (xy.min(axis=0), xy.max(axis=0)) if len(xy) else (np.zeros(2), np.ones(2))
    scale = SIDE_PX / (float((high - low).max()) + 1.6)
    middle = (low + high) / 2

    def to_px(points: F64) -> I32:
        return np.round(SIDE_PX / 2 + (points - middle) * scale * (1, -1)).astype(np.int32)

    return to_px


def _path(canvas: U8, rows: Trajectories, to_px: FloorToPixels, frame: int, colour: Colour, name: str) -> None:
    """The way of one person or track, a dot where it is at the frame; predictions are thin."""
    points = to_px(np.column_stack([rows.x_m, rows.y_m]))
    for k in range(1, len(points)):
        thick = 1 if rows.state[k] == "lost" else 2
        cv2.line(canvas, points[k - 1].tolist(), points[k].tolist(), colour, thick, cv2.LINE_AA)
    at = int(np.argmin(np.abs(rows.frame - frame)))
    cv2.circle(canvas, points[at].tolist(), 5, colour, -1, cv2.LINE_AA)
    place = (points[at] + (6, -6)).tolist()
    cv2.putText(canvas, name, place, _FONT, 0.45, colour, 1, cv2.LINE_AA)


def _image(run: FailedRun, error: SignificantError) -> U8:
    maps = MapsRecording(run.folder / "maps.h5")
    image = _rectified(run.recording, recorded_config(maps).rectify, error.frame)
    boxes = BodyBoxes(maps.view.geometry, maps.view.floor.world_SE3_left)
    where: list[tuple[float, float]] = []
    for table, is_truth in ((run.truth, True), (run.tracks, False)):
        rows = table.where(table.frame == error.frame)
        for row in range(len(rows)):
            state = boxes(row_state(rows, row))
            wanted = error.truth_id if is_truth else error.track_id
            colour = (255, 255, 255) if is_truth else as_bgr(person_rgb(state.track_id))
            if np.isfinite(state.box_px).all():
                _box(image, state.box_px, colour, f"P{state.track_id}" if is_truth else str(state.track_id), is_truth)
                where += [(state.box_px[0] + state.box_px[2] / 2, state.box_px[1])] if state.track_id == wanted else []
    return _crop(image, where[0] if where else (image.shape[1] / 2, image.shape[0] / 4))


def _rectified(recording: Path, params: RectifyParams, frame: int) -> U8:
    files = [sorted((recording / side).glob("*")) for side in ("left", "right")]
    if any(frame >= len(of_side) for of_side in files):
        raise InputError(f"{recording}: expected an image for frame {frame}, found {len(files[0])} images")
    left, right = (cv2.imread(str(of_side[frame])) for of_side in files)
    rig = getattr(open_any(recording), "rig", None)
    if left is None or right is None or rig is None:
        raise InputError(f"{files[0][frame]}: expected a pair of images and a rig, found them damaged")
    return Rectifier(rig, params)(np.asarray(left, np.uint8), np.asarray(right, np.uint8)).left.copy()


def _box(image: U8, box_px: tuple[float, ...], colour: Colour, name: str, is_truth: bool) -> None:
    left, top, width, height = (round(v) for v in box_px)
    cv2.rectangle(image, (left, top), (left + width, top + height), colour, 1)
    place = (left + 2, top + height - 3) if is_truth else (left + 2, top + 11)
    cv2.putText(image, name, place, _FONT, 0.4, colour, 1, cv2.LINE_AA)


def _crop(image: U8, head_px: tuple[float, float]) -> U8:
    """A square around a head's pixel, as far as it is in the image."""
    height, width = image.shape[:2]
    side = round(CROP_SHARE * height)
    left = int(np.clip(head_px[0] - side / 2, 0, width - side))
    top = int(np.clip(head_px[1] - side / 4, 0, height - side))
    part = image[top : top + side, left : left + side]
    shown = cv2.cvtColor(part, cv2.COLOR_GRAY2BGR) if part.ndim == 2 else part
    return np.asarray(cv2.resize(shown, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
