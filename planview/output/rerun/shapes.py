"""What trackers and stages show, as rerun's shapes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import rerun as rr

from calib.images import as_colour, encode_image
from calib.types import F32, I32, U8
from planview.engine.engine import FrameResult
from planview.maps.view import StereoView
from planview.tracking.base import Drawing
from planview.trajectories.state import TrackState

JPEG_QUALITY = 50
"""Of the camera's image: 0.6 of the size of quality 80, and people are as well to be recognised (our choice)."""
DISPARITY_QUALITY = 40
LABEL_M = 0.45
"""Ids stand so far beside people in plan views, where they hide no peak of the maps [m]."""
LABEL_APART_M = 0.3


def photo(image: U8) -> rr.EncodedImage:
    """A JPEG of the camera's image."""
    return rr.EncodedImage(contents=encode_image(image, quality=JPEG_QUALITY), media_type="image/jpeg")


def disparity_photo(disparity: F32, stereo: StereoView) -> rr.EncodedImage:
    """Near red, far blue, invalid black (as ``planview doctor`` shows it), at the size of foreground and maps."""
    reduced = disparity[:: stereo.reduction, :: stereo.reduction]
    first, span = stereo.disparities.first_px, stereo.disparities.count
    known = np.isfinite(reduced)
    levels = np.clip((np.nan_to_num(reduced) - first) * (255.0 / span), 0, 255).astype(np.uint8)
    picture = np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_TURBO), dtype=np.uint8)
    picture[~known] = 0
    contents = encode_image(picture, quality=DISPARITY_QUALITY)
    return rr.EncodedImage(contents=contents, media_type="image/jpeg")


def outlines(foreground: U8, size: tuple[int, int]) -> rr.LineStrips2D:
    """Outlines of the foreground in an image of (width, height) pixels; its mask takes fifty times their room."""
    found, _ = cv2.findContours((foreground > 0).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_TC89_L1)
    scale = size[0] / foreground.shape[1]
    strips = [np.vstack([c, c[:1]]).reshape(-1, 2).astype(np.float32) * scale for c in found if len(c) > 2]
    return rr.LineStrips2D(strips, colors=[255, 60, 60], radii=-1.0)


def strips_of(drawing: Drawing) -> rr.LineStrips3D | rr.LineStrips2D | rr.Points2D | rr.Points3D:
    """A tracker's drawing; labels in the image show under the pointer, those on the floor would hide the maps."""
    labels = list(drawing.labels) or None
    points = drawing.strips and all(len(strip) == 1 for strip in drawing.strips)
    if drawing.plane == "image":
        flat = [np.asarray(strip, dtype=np.float32) for strip in drawing.strips]
        if points:
            return rr.Points2D(np.concatenate(flat), labels=labels, show_labels=False)
        return rr.LineStrips2D(flat, labels=labels, show_labels=False)
    raised = [np.column_stack([strip, np.full(len(strip), 0.03)]) for strip in drawing.strips]
    if points:
        return rr.Points3D(np.concatenate(raised), radii=0.01)
    return rr.LineStrips3D(raised, colors=[0, 230, 120], radii=0.01)


def mosaic(tiles: Mapping[str, F32 | U8]) -> U8:
    """Small images side by side in the order of their names; one by one they would take ten times the room."""
    grey = [_grey(tiles[name]) for name in sorted(tiles)]
    height = max(tile.shape[0] for tile in grey)
    return np.hstack([np.pad(tile, ((0, height - tile.shape[0]), (0, 1))) for tile in grey])


def _grey(tile: F32 | U8) -> U8:
    """With the full range of grey."""
    if tile.dtype == np.uint8:
        return np.asarray(tile, dtype=np.uint8)
    return np.clip(tile / max(float(tile.max()), 1e-9) * 255, 0, 255).astype(np.uint8)[::-1]


def label_of(track: TrackState) -> str:
    """Id, height and state."""
    height = "" if math.isnan(track.height_m) else f" {track.height_m:.2f} m"
    return f"{track.track_id}{height}" + ("" if track.state == "confirmed" else f" ({track.state})")


def label_places(tracks: Sequence[TrackState]) -> list[tuple[float, float, float]]:
    """Beside each person, on the other side or further out where another label is [m]."""
    places: list[tuple[float, float, float]] = []
    for track in tracks:
        for reach in (1.0, 1.6, 2.2):
            around = ((track.x_m + i * reach * LABEL_M, track.y_m + j * reach * LABEL_M, 0.06) for i, j in _SIDES)
            free = (p for p in around if all(math.dist(p, other) > LABEL_APART_M for other in places))
            place = next(free, None)
            if place is not None:
                break
        places.append(place or (track.x_m + LABEL_M, track.y_m, 0.06))
    return places


_SIDES = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))


def point_colours(stereo: StereoView, result: FrameResult) -> U8 | None:
    """(N, 3) RGB of the maps' points, each from its head's image; None without an image."""
    maps, image = result.observation.maps, result.image
    if maps is None:
        return None
    pixels = maps.points.pixels
    if not result.heads:
        return None if image is None else _colours_at(image, pixels, stereo.shape[1], stereo.reduction)
    parts, start = [np.empty((0, 3), dtype=np.uint8)], 0
    for head in result.heads:
        mine = pixels[start : start + head.n_points]
        if (own := head.image) is not None and head.foreground is not None:
            width = head.foreground.shape[1]
            parts.append(_colours_at(own, mine, width, -(-own.shape[1] // width)))
        start += head.n_points
    return np.concatenate(parts)


def _colours_at(image: U8, pixels: I32, width: int, reduction: int) -> U8:
    rows, cols = np.divmod(pixels, width)
    return np.asarray(as_colour(image)[rows * reduction, cols * reduction, ::-1], dtype=np.uint8)
