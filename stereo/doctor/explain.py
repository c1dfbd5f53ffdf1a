"""Which hypothesis explains a recording that makes no sense, and what it gives.

A rule knows one fault. A hypothesis undoes one, and the result shows whether that was it: rows that agree, a floor with
people of a person's height above it, depth whose edges are the image's. Nothing is decided here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import NamedTuple, cast

import cv2
import numpy as np

from calib.images import as_grey
from calib.types import F32, U8, AnyArray
from stereo.depth import median_image, metres
from stereo.doctor import hypotheses, tries
from stereo.doctor.hypotheses import Hypothesis, StoredDepth
from stereo.doctor.tries import WIDTH, FloorView, taken, view_of
from stereo.floor import FloorSearch
from stereo.recording import DepthCamera, Frame, Pair, Recording, Shot
from stereo.rectify import RectifyParams
from stereo.rgbd import RgbdRectifier

SPREAD_FRAMES, FIRST_FRAMES = 6, 2
"""Frames looked at, spread over the recording, and those of a first look, which ends most hypotheses."""
ALIGNED = 0.1
"""Least share of the corners on their rows: healthy pairs have 0.35 or more, unrelated images below 0.02."""
BETTER = 1.2
"""A hypothesis makes corners, edges or floor fit better than they do as recorded by this factor: right ones do by 1.2
(a lens of another size) to 100, wrong ones by 0.9 at most."""
SURELY = 3.0
"""And another state of a pair explains its rows and floor by this factor better than what was recorded does."""
ROWS_WEIGHT = 10.0
"""Corners on their rows are worth this many times as much as points on a floor of the same share: a mirrored view of a
camera that candidates straight down has a floor, and on its rows are a tenth fewer corners, of some hundred."""
TURNED_ODDS = 100.0
"""Odds against a camera, or images, that are upside down where a plane alone says so: it may be a ceiling or a wall,
and people who stand on it decide."""
NO_FLOOR = -6.0
"""Plausibility of a view without a floor: a camera may show none, but rarely does."""
PLAUSIBLE = -6.0
"""Least plausibility of a floor that explains anything: a tenth of the depth 9 m below, or people of 1.3 m or 2.1 m."""
EDGES_MIN = 0.15
"""Sum of the correlations of edges and of what moves from which they are judged; what belongs together has 0.5 or more
(our choice)."""
SHIFT_PX_MAX = 12.0
"""Depth may lie this far from its image [px of 640]: registered depth of Kinects lies 8 px to one side, since it ends
where the light's shadow begins."""
RAW_UNITS = 65536.0
"""Values per metre by which whole numbers of 16 bits are read as metres without a loss."""


@dataclass(frozen=True)
class Explained:
    """The hypothesis that makes a recording fit, what it gives, and another one that explains it as well."""

    hypothesis: Hypothesis
    gives: str
    other: Explained | None = None

    def __str__(self) -> str:
        if self.other is None:
            return f"if {self.clause}: {self.hypothesis.remedy}"
        remedies = " or ".join(dict.fromkeys((self.hypothesis.remedy, self.other.hypothesis.remedy)))
        return f"either if {self.clause}, or if {self.other.clause}: {remedies}"

    @property
    def clause(self) -> str:
        """What is so, and what follows."""
        return f"{self.hypothesis.name}, {self.gives}"

    @property
    def names(self) -> str:
        """The hypothesis by name, or both."""
        return " or ".join(one.hypothesis.name for one in (self, self.other) if one)


class _Try(NamedTuple):
    """A hypothesis, how well it explains a recording as a logarithm, what it gives, and by which factor it must explain
    more than the recording as it is does."""

    hypothesis: Hypothesis
    score: float
    gives: str
    margin: float = BETTER


def _clearly(found: Iterable[_Try], own: float) -> Explained | None:
    """The hypothesis that explains a recording best and one that does so as well, within the factor ``BETTER``; None
    where the best does not explain as much more than the recording as it is, of the score ``own``, as it must."""
    ranked = sorted((one for one in found if one.score > -math.inf), key=lambda one: -one.score)
    if not ranked or ranked[0].score < own + math.log(ranked[0].margin):
        return None
    best, *alike = [
        Explained(one.hypothesis, one.gives) for one in ranked[:2] if one.score > ranked[0].score - math.log(BETTER)
    ]
    return replace(best, other=next(iter(alike), None))


def _by_floor(tried: Iterable[tuple[Hypothesis, FloorView]], own: FloorView) -> Explained | None:
    """The hypothesis of the most plausible view, where that is better than the view as recorded."""
    was = f" in place of {own.floor.height_m:.2f} m" if own.floor else ""
    explained = [
        _Try(hypothesis, view.plausible, f"{view}{was}", TURNED_ODDS if hypothesis.turns else BETTER)
        for hypothesis, view in tried
        if view.plausible >= PLAUSIBLE
    ]
    return _clearly(explained, max(own.plausible, NO_FLOOR))


def explain(recording: Recording[Pair | DepthCamera], search: FloorSearch | None = None) -> Explained | None:
    """The hypothesis that explains a recording whose rows, floor or people are not what they should be; None where none
    does."""
    if isinstance(recording.head, Pair):
        return explain_pair(cast(Recording[Pair], recording), search)
    return explain_depth(cast(Recording[DepthCamera], recording), search)


def explain_pair(recording: Recording[Pair], search: FloorSearch | None = None) -> Explained | None:
    """The hypothesis under which a recording of pairs fits and does not as it is; None where there is none."""
    search, rig = search or FloorSearch(), recording.head.rig
    shots = [frame.images for frame in recording.sample(SPREAD_FRAMES)]
    candidates = [
        tries.PairsUnder(hypothesis, rig, shots) for hypothesis in (hypotheses.AS_RECORDED, *hypotheses.PAIRS)
    ]
    first = [candidate.aligned(FIRST_FRAMES) for candidate in candidates]
    candidates = [
        candidate
        for candidate, share in zip(candidates, first, strict=True)
        if share >= 0.5 * max(first) or candidate is candidates[0]
    ]
    shares = np.array([candidate.aligned(len(shots)) for candidate in candidates])
    if shares.max() < ALIGNED:
        return None
    if shares[0] >= ALIGNED:  # what lies on its rows is rectified
        shares[[candidate.hypothesis.rows != "aligned" for candidate in candidates]] = 0.0
    likely = [int(k) for k in np.argsort(-shares, kind="stable") if shares[k] >= shares.max() / BETTER]
    views = {k: view_of(candidates[k].depths(), candidates[k].geometry, search) for k in likely}
    floors = any(view.floor for view in views.values())
    scores = {k: ROWS_WEIGHT * math.log(shares[k]) + (views[k].plausible if floors else 0.0) for k in likely}
    own, margin = scores.get(0, -math.inf), SURELY
    if 0 in views and views[0].floor is None and floors:  # rows are as good as recorded: the floor alone speaks
        own, margin = ROWS_WEIGHT * math.log(shares[0]) + NO_FLOOR, TURNED_ODDS
    rows = "matched corners are on their rows within {:.1f} px of 640 and {}"
    explained = [
        _Try(candidates[k].hypothesis, scores[k], rows.format(candidates[k].rows_px, views[k]), margin)
        for k in likely
        if k
    ]
    if (found := _clearly(explained, own)) or 0 not in views:
        return found
    depths, geometry = candidates[0].depths(), candidates[0].geometry
    return _by_floor(
        [(hypothesis, taken(hypothesis, depths, geometry, search)) for hypothesis in hypotheses.VIEWS], views[0]
    )


def explain_colours(frames: Sequence[Frame[Shot]]) -> Explained | None:
    """Whether one camera of a pair has red where the other has blue: rows of both show about the same colours."""
    if not frames or any(image.ndim != 3 for frame in frames for image in frame.images):
        return None
    rows = [[cv2.resize(image, (1, 24), interpolation=cv2.INTER_AREA) for image in frame.images] for frame in frames]
    left, right = np.array(rows, dtype=np.float64).swapaxes(0, 1)
    apart, opposed = (float(np.square(left - other).mean()) for other in (right, right[..., ::-1]))
    green, other = (side[..., 1].ravel() - side[..., 1].mean() for side in (left, right))
    # A grey level of colour is less than a camera's white balance; what is bright in one is dark in a negative.
    if apart <= max(BETTER**2 * opposed, 1.0) or green @ other <= 0:
        return None
    gives = (
        f"left and right rows differ in colour by {math.sqrt(opposed):.1f} levels in place of {math.sqrt(apart):.1f}"
    )
    return Explained(hypotheses.COLOURS, gives)


def explain_fields(frames: Sequence[Frame[Shot]]) -> Explained | None:
    """Whether images are woven of two fields: where something moves, every second row shows it elsewhere."""
    if not frames:
        return None
    images = [np.asarray(as_grey(frame.image)[:, ::4], dtype=np.float32) for frame in frames]  # (for speed)
    neighbours, two_apart, usual = 0.0, 0.0, median_image(images)
    for image in images:
        moved = np.abs(image - usual) > tries.CHANGE_LEVEL
        moving = moved[:-2] | moved[1:-1] | moved[2:]
        neighbours += float(np.abs(image[1:-1] - image[:-2])[moving].sum())
        two_apart += float(np.abs(image[2:] - image[:-2])[moving].sum())
    if neighbours <= BETTER * two_apart or neighbours < tries.CHANGE_LEVEL * WIDTH:
        return None
    return Explained(
        hypotheses.FIELDS, f"rows two apart are alike {neighbours / two_apart:.1f} times as well as neighbours"
    )


def explain_depth(recording: Recording[DepthCamera], search: FloorSearch | None = None) -> Explained | None:
    """The hypothesis under which depth shows a floor, or a better one than as it is; None where there is none."""
    search, head, frames = search or FloorSearch(), recording.head, _stored_frames(recording)
    camera, rectify = head.depth_camera or head.camera, RectifyParams(working_px=WIDTH)
    rectifier = RgbdRectifier(head.camera, head.sensor, rectify)
    rows, columns = np.indices(camera.size[::-1])
    rays = camera.unproject(np.column_stack([columns.ravel(), rows.ravel()]))
    units = head.depth_units.units_per_m if head.depth_units else 1.0
    usual = [float(np.median(values[values > 0])) for _, values in frames if (values > 0).any()]
    ray = np.linalg.norm(rays, axis=1).reshape(rows.shape).astype(np.float32)
    stored = StoredDepth(units, ray, float(np.median(usual)) if usual else math.nan)

    def depths(read: Callable[[AnyArray, StoredDepth], F32]) -> list[F32]:
        metric = ((image, head.registration(np.asarray(read(values, stored), np.float32))) for image, values in frames)
        return [rectifier(image, depth)[1] for image, depth in metric]

    geometry, as_recorded = rectifier.geometry, depths(lambda values, stored: metres(values, stored.units_per_m))
    own = view_of(as_recorded, geometry, search)
    tried = [(h, view_of(depths(h.depth), geometry, search)) for h in hypotheses.DEPTHS if h.depth]
    turned = [(h, taken(h, as_recorded, geometry, search)) for h in hypotheses.VIEWS if h.turns]
    return _by_floor([*tried, *turned], own)


def _stored_frames(recording: Recording[DepthCamera]) -> list[tuple[U8, AnyArray]]:
    """Images and depth as stored, of frames spread over a recording: whole numbers, or metres where they are."""
    units, count = recording.head.depth_units, min(SPREAD_FRAMES, recording.n_frames)
    spread = np.unique(np.linspace(0, recording.n_frames - 1, count).round())
    assumed = units.units_per_m if units else 1.0
    try:
        if units:
            units.units_per_m = RAW_UNITS
        with closing(recording.decode([int(index) for index in spread])) as decoded:
            found = [(a.image, b.image) for a, b in decoded if a.image is not None and b.image is not None]
    finally:
        if units:
            units.units_per_m = assumed
    if not units or any(np.nanmax(depth, initial=0.0) >= 1.0 for _, depth in found):
        return found
    return [(image, np.nan_to_num(depth * RAW_UNITS).round().astype(np.uint16)) for image, depth in found]


class PlaceOfDepth(NamedTuple):
    """Where depth lies best on its image, across and down [px of 640], NaN where there are too few edges to tell; and
    what explains that it is not where it should be."""

    shift_px: tuple[float, float] = (math.nan, math.nan)
    found: Explained | None = None


def place_of_depth(frames: Sequence[Frame[Shot]]) -> PlaceOfDepth:
    """Of at least four frames spread over a recording, whose images have depth."""
    scores = tries.edge_scores(frames) if len(frames) >= 4 else np.zeros((1, 1, 1))
    if scores.max() < EDGES_MIN:
        return PlaceOfDepth()
    peaks = scores.reshape(len(scores), -1).max(axis=1)
    at = np.unravel_index(int(np.argmax(scores[0])), scores[0].shape)
    down, across = ((int(place) - reach) * 640.0 / WIDTH for place, reach in zip(at, tries.REACH_PX, strict=True))
    found, best = None, int(np.argmax(peaks))
    where = f"edges and people fit best {across:+.0f} px to the right, {down:+.0f} down, of 640"
    if peaks[best] > BETTER * max(peaks[0], 0.5 * EDGES_MIN):
        found = Explained(hypotheses.PLACES[best - 1], f"edges fit by {peaks[best]:.2f} in place of {peaks[0]:.2f}")
    elif max(abs(across), abs(down)) > SHIFT_PX_MAX and peaks[0] > BETTER * scores[0][tries.REACH_PX]:
        found = Explained(hypotheses.OFFSET_DEPTH, where)
    return PlaceOfDepth((across, down), found)
