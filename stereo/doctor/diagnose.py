"""Search for the hypothesis that explains a recording which makes no sense, by what it gives: rows that agree, a floor
with people of a person's height above it, depth whose edges are the image's. Nothing is decided here."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Any, NamedTuple

import numpy as np

from calib.doubt import Finding, Hypothesis, Score, best, shortlist
from calib.types import F32, U8, AnyArray
from stereo.depth import metres
from stereo.doctor.hypotheses import (
    BASELINES,
    DEPTHS,
    MOUNTS,
    OFFSET_DEPTH,
    PAIRS,
    PLACES,
    RAW_PAIRS,
)
from stereo.doctor.overlay import EDGES_MIN, Overlay, offset_score, place_score
from stereo.doctor.pairs import (
    LEAST_ALIGNED,
    ROWS_WEIGHT,
    WIDTH,
    Pairs,
    rows_score,
)
from stereo.doctor.scenes import PLAUSIBLE, DepthScene, StoredDepth, floor_score, floor_view
from stereo.floor import FloorSearch
from stereo.recording import DepthCamera, Frame, Recording, Shot, StereoPair
from stereo.rectify import RectifyParams
from stereo.rgbd import RgbdRectifier, pixel_rays

SPREAD_FRAMES = 6
"""Frames looked at, spread over the recording."""
FIRST_FRAMES = 2
"""Frames of a first look, which ends most hypotheses."""
ENDED = 2.0
"""A hypothesis whose rows fit worse than the best one's by this factor in the first look is not looked at again."""
ROWS_ALIKE = 1.2
"""Difference in the fit of rows below which hypotheses are compared by their floor."""
SURELY = 3.0
"""Another state of a pair explains its rows and floor by this factor better than what was recorded does."""
HIDDEN_FLOOR = -2.5
"""Plausibility of a pair's view without a floor, where rows count for more than the floor does."""


def diagnose(recording: Recording[StereoPair | DepthCamera], search: FloorSearch | None = None) -> Finding | None:
    """The hypothesis that explains a recording whose rows, floor or people are not what they should be; None where none
    does."""
    return DIAGNOSES[type(recording.sensor)](recording, search or FloorSearch())


def diagnose_pair(recording: Recording[StereoPair], search: FloorSearch) -> Finding | None:
    """The hypothesis under which the rows of pairs fit, or else their floor, and do not as recorded."""
    shots = [(frame.images[0], frame.images[1]) for frame in recording.sample(SPREAD_FRAMES)]
    pairs = Pairs(recording.sensor.rig, shots)
    is_aligned = pairs.aligned_share >= LEAST_ALIGNED
    tried = PAIRS if is_aligned else (*PAIRS, *RAW_PAIRS)
    likely = shortlist(pairs.first(FIRST_FRAMES), tried, rows_score, ENDED**ROWS_WEIGHT)
    likely = shortlist(pairs, likely, rows_score, ROWS_ALIKE**ROWS_WEIGHT)

    def score(changed: Pairs) -> Score:
        rows = rows_score(changed)
        if rows.value == -math.inf:
            return rows
        view = floor_view(changed.scene, search)
        floor = view.plausible if view.floor else HIDDEN_FLOOR
        return Score(rows.value + floor, f"{rows.measured} and {view}")

    finding = best(pairs, likely, score, margin=SURELY)
    if finding or not is_aligned:
        return finding
    return _by_floor(pairs.scene, (*BASELINES, *MOUNTS), search)


def diagnose_depth(recording: Recording[DepthCamera], search: FloorSearch) -> Finding | None:
    """The hypothesis under which depth shows a floor, or a better one than as recorded."""
    return _by_floor(stored_scene(recording), (*DEPTHS, *MOUNTS), search)


DIAGNOSES: dict[type, Callable[[Any, FloorSearch], Finding | None]] = {
    StereoPair: diagnose_pair,
    DepthCamera: diagnose_depth,
}
"""By what recorded it, what explains a recording."""


def _by_floor(scene: DepthScene, hypotheses: Sequence[Hypothesis[DepthScene]], search: FloorSearch) -> Finding | None:
    """The hypothesis whose floor is more plausible than that of the view as recorded."""
    before = floor_view(scene, search)

    def score(changed: DepthScene) -> Score:
        return floor_score(before if changed is scene else floor_view(changed, search), before)

    return best(scene, hypotheses, score, least=PLAUSIBLE)


class PlaceOfDepth(NamedTuple):
    """Shift at which depth lies best on its image, across and down [px of 640], NaN where there are too few edges to
    tell; and the explanation of a wrong place."""

    shift_px: tuple[float, float] = (math.nan, math.nan)
    finding: Finding | None = None

    def __str__(self) -> str:
        across_px, down_px = self.shift_px
        if math.isnan(across_px):
            return "too few edges to compare"
        return f"edges and people fit best {across_px:+.0f} px to the right, {down_px:+.0f} down, of 640"


def place_of_depth(frames: Sequence[Frame[Shot]]) -> PlaceOfDepth:
    """Find where depth lies in at least four frames spread over a recording."""
    if len(frames) < 4:
        return PlaceOfDepth()
    overlay = Overlay.of(frames)
    finding = best(overlay, PLACES, place_score, alike=1.0, least=math.log(EDGES_MIN))
    if finding is None and overlay.correlation.max() < EDGES_MIN:
        return PlaceOfDepth()
    across, down = overlay.best_shift
    place = PlaceOfDepth((across * 640.0 / WIDTH, down * 640.0 / WIDTH), finding)
    if finding is None and best(overlay, [OFFSET_DEPTH], offset_score):
        return place._replace(finding=Finding(OFFSET_DEPTH, str(place)))
    return place


def stored_scene(recording: Recording[DepthCamera]) -> DepthScene:
    """Depth of frames spread over a recording, as it is read and as it is stored."""
    sensor = recording.sensor
    camera = sensor.depth_camera or sensor.camera
    rectifier = RgbdRectifier(sensor.camera, sensor.technology, RectifyParams(working_px=WIDTH))
    ray = np.linalg.norm(pixel_rays(camera), axis=2).astype(np.float32)
    images, values = _stored_frames(recording)

    def rectify(image: U8, depth_m: F32) -> F32:
        return rectifier(image, sensor.registration(depth_m))[1]

    is_whole = all(np.issubdtype(depth.dtype, np.integer) for depth in values)
    units_per_m = sensor.depth_units.units_per_m if is_whole else 1.0
    stored = StoredDepth(images, values, units_per_m, ray, rectify)
    return DepthScene((), rectifier.geometry, stored).read(lambda values, stored: metres(values, stored.units_per_m))


def _stored_frames(recording: Recording[DepthCamera]) -> tuple[list[U8], list[AnyArray]]:
    """Images and depth of frames spread over a recording: as stored, or metres where the sensor measures these."""
    count = min(SPREAD_FRAMES, recording.n_frames)
    spread = np.unique(np.linspace(0, recording.n_frames - 1, count).round())
    images: list[U8] = []
    depths: list[AnyArray] = []
    with recording.sensor.depth_units.raw(), closing(recording.decode([*map(int, spread)])) as decoded:
        for image, depth in decoded:
            if image.image is not None and depth.image is not None:
                images.append(image.image)
                depths.append(depth.image)
    return images, depths
