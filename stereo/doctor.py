"""What would explain a recording that makes no sense: a few frames are looked at again under a table of hypotheses.

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

from calib.camera import Camera
from calib.errors import WorkError
from calib.images import as_grey
from calib.pose import SE3
from calib.rig import Floor, StereoRig
from calib.types import F32, F64, U8, AnyArray
from stereo.depth import DEPTH_UNITS, RectifiedGeometry, back_project, median_image, metres
from stereo.floor import FITTED_STEP_PX, MIN_BODY, FloorSearch, floor_in, moved_patches
from stereo.matcher import DisparityRange, SgbmMatcher
from stereo.readers.state import rectified_rig
from stereo.recording import DepthCamera, Frame, Pair, Recording, Shot
from stereo.rectify import Rectified, Rectifier, RectifyParams
from stereo.rgbd import RgbdRectifier
from stereo.rig_correction import match_corners

WIDTH = 320
"""Frames are looked at this wide [px] (for speed)."""
SPREAD_FRAMES, FIRST_FRAMES = 6, 2
"""Frames looked at, spread over the recording, and those of a first look, which ends most hypotheses."""
BETTER = 1.2
"""A hypothesis makes corners, edges or floor fit better than they do as recorded by this factor: right ones do by 1.2
(a lens of another size) to 100, wrong ones by 0.9 at most."""
CORNERS, ROW_PX, ALIGNED = 80, 1.0, 0.1
"""Corners tried in a frame, the row offset from which on one does not count [px of WIDTH], and the least share on their
rows: healthy pairs have 0.35 or more, unrelated images below 0.02."""
VIEW_M = 0.4, 20.0
"""Median depth of views with people in them [m]; other readings of depth need no search for a floor."""
CAMERA_M, CAMERA_SPREAD = 2.5, 0.5
"""Median height of cameras above floors [m], and the deviation of its logarithm (see ``calib.floor.plane``)."""
PERSON_M, PERSON_STD_M, PERSON_STDS_MAX = 1.7, 0.15, 5.0
"""Height of the taller of what moves, mostly adults, its deviation with that of the measurement [m], and the deviations
above which it is no longer evidence against a floor: what moves may be a door."""
PLAUSIBLE = -6.0
"""Least plausibility of a floor that explains anything: a tenth of the depth 9 m below, or people of 1.3 m or 2.1 m."""
EDGES_MIN = 0.15
"""Sum of the correlations of edges and of what moves from which they are judged; what belongs together has 0.5 or more
(our choice)."""
REACH_PX = (16, 32)
"""Shifts of depth on its image searched down and across, each way [px of WIDTH]: a tenth of the image (our choice)."""
SHIFT_PX_MAX = 12.0
"""Depth may lie this far from its image [px of 640]: registered depth of Kinects lies 8 px to one side, since it ends
where the light's shadow begins."""
CHANGE_LEVEL = 20.0
"""Grey levels by which what moves differs from the usual picture (our choice)."""
RAW_UNITS = 65536.0
"""Values per metre by which whole numbers of 16 bits are read as metres without a loss."""


class StoredDepth(NamedTuple):
    """How depth is stored: values per metre, (H, W) length of each pixel's ray at unit depth, and the usual value."""

    units_per_m: float
    ray: F32
    usual: float


def _as_it_is(image: AnyArray) -> AnyArray:
    return image


@dataclass(frozen=True)
class Hypothesis:
    """One way in which a recording may not be what it seems.

    Attributes:
        name: what is so, a clause.
        remedy: what to do then, a clause.
        exchanged: whether left and right are to be exchanged.
        left, right: make the image of a side, once they are exchanged, what it should be.
        rig: makes the calibration of a pair what it should be.
        depth: makes (H, W) metres along the axis of (H, W) stored values.
        placed: lays depth, or a map of it, onto the image.
        baseline: factor to the baseline.
        turns: quarter turns of the view, counterclockwise, after which the camera stands upright.
    """

    name: str
    remedy: str
    exchanged: bool = False
    left: Callable[[U8], U8] = _as_it_is
    right: Callable[[U8], U8] = _as_it_is
    rig: Callable[[StereoRig], StereoRig] | None = None
    depth: Callable[[AnyArray, StoredDepth], F32] | None = None
    placed: Callable[[F32], F32] = _as_it_is
    baseline: float = 1.0
    turns: int = 0

    def images(self, left: U8, right: U8) -> tuple[U8, U8]:
        """A recorded pair as it should be."""
        first, second = (right, left) if self.exchanged else (left, right)
        return np.ascontiguousarray(self.left(first)), np.ascontiguousarray(self.right(second))


def _woven(image: U8) -> U8:
    """The rows of the upper and the lower half in turn."""
    half = len(image) // 2
    return np.stack([image[:half], image[half : 2 * half]], axis=1).reshape(2 * half, *image.shape[1:])


def _of_images(scale: float) -> Callable[[StereoRig], StereoRig]:
    """The calibration of images ``scale`` times as large, fitted to these."""

    def fitted(own: Camera) -> Camera:
        cx, cy = ((centre + 0.5) / scale - 0.5 for centre in (own.cx, own.cy))
        return replace(own, fx=own.fx / scale, fy=own.fy / scale, cx=cx, cy=cy)

    return lambda rig: replace(rig, left=fitted(rig.left), right=fitted(rig.right))


def _rectified(rig: StereoRig) -> StereoRig:
    return rectified_rig(lambda: rig, rig)[0]


def _inverted(rig: StereoRig) -> StereoRig:
    """The inverse pose, with the right camera on the right."""
    pose = rig.right_SE3_left.inverse()
    return replace(rig, right_SE3_left=SE3(pose.rotation, -pose.translation))


def _in_units(per_m: float) -> Callable[[AnyArray, StoredDepth], F32]:
    return lambda values, stored: metres(values, per_m)


def _swapped(values: AnyArray, stored: StoredDepth) -> F32:
    return metres(values.byteswap(), stored.units_per_m)


def _along_ray(values: AnyArray, stored: StoredDepth) -> F32:
    return metres(values, stored.units_per_m) / stored.ray


def _divided_twice(values: AnyArray, stored: StoredDepth) -> F32:
    return metres(values, stored.units_per_m) * stored.ray


def _inverse(values: AnyArray, stored: StoredDepth) -> F32:
    """Depth of values that grow towards the camera, the usual one at 3 m: their unit is not known."""
    depth = np.where(values > 0, 3.0 * stored.usual / np.maximum(values, 1e-6), 0.0)
    return metres(depth.astype(np.float32).clip(0, 1e3), 1.0)


def _in_size(scale: float) -> Callable[[F32], F32]:
    """A map at another size, around its middle."""

    def placed(depth: F32) -> F32:
        height, width = depth.shape
        to = np.array([[scale, 0.0, (1 - scale) * width / 2], [0.0, scale, (1 - scale) * height / 2]])
        return np.asarray(cv2.warpAffine(depth, to, (width, height), flags=cv2.INTER_LINEAR), dtype=np.float32)

    return placed


AS_RECORDED = Hypothesis("", "")
TURNED: dict[str, Callable[[AnyArray], AnyArray]] = {
    "mirrored": lambda image: image[:, ::-1],
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
    "flipped top to bottom": lambda image: image[::-1],
    "turned by 90 degrees to the left": lambda image: np.rot90(image, -1),
    "turned by 90 degrees to the right": np.rot90,
    "interlaced, one field above the other": _woven,
}
"""What may have been done to images, and what undoes it."""
WHICH = (
    ("the right images are", False, False, True),
    ("the left images are", False, True, False),
    ("the images of both cameras are", False, True, True),
    ("the images of both cameras are exchanged and", True, True, True),
)
"""To which images, whether they are exchanged, and whether it is undone in the left and the right one."""
LENGTHS = {
    "millimetres": 1e-3, "centimetres": 1e-2, "inches, or in squares of about 25 mm": 0.0254, "decimetres": 0.1,
    "feet": 0.3048, "tens of metres": 10.0, "kilometres": 1e3,
}  # fmt: skip
"""Units of a baseline [m]."""
BACK = "record or convert the images as the cameras took them"
SCALED = "give the calibration of these images"
REGISTER = "give the calibration of the depth camera and its pose, or record registered depth"
UPRIGHT = "turn the images, and calibrate the turned ones"
TIMES = "give each camera the times of its images; where one counts from 0 and the other from 1, renumber it"
PAIRS = (
    Hypothesis("left and right are exchanged", "exchange them", exchanged=True),
    *(
        Hypothesis(f"{which} {what}", BACK, exchanged, undo if left else _as_it_is, undo if right else _as_it_is)
        for what, undo in TURNED.items()
        for which, exchanged, left, right in WHICH
    ),
    Hypothesis("the images of one camera are negative", BACK, right=lambda image: 255 - image),
    Hypothesis("the images are rectified already", "give the calibration of the rectified images", rig=_rectified),
    Hypothesis("the pose of the right camera is inverted", "store right_SE3_left, not left_SE3_right", rig=_inverted),
    *(
        Hypothesis(f"the calibration is that of images {what} the size", SCALED, rig=_of_images(scale))
        for what, scale in (("twice", 2.0), ("1.5 times", 1.5), ("two thirds of", 2 / 3), ("half", 0.5))
    ),
)
"""Of the images and the calibration of a pair: rows show them."""
COLOURS = Hypothesis("red and blue are exchanged in the images of one camera", "exchange its channels")
"""Of colours, which both cameras see alike."""
VIEWS = (
    *(Hypothesis(f"the baseline is in {unit}", "give it in metres", baseline=m) for unit, m in LENGTHS.items()),
    Hypothesis("the camera hangs upside down", UPRIGHT, turns=2),
    Hypothesis("the camera lies on its left side", UPRIGHT, turns=3),
    Hypothesis("the camera lies on its right side", UPRIGHT, turns=1),
)
"""Of what is measured rightly and taken wrongly: the floor shows them."""
DEPTHS = (
    *(Hypothesis(f"depth counts {n:g} values per metre", "state its scale", depth=_in_units(n)) for n in DEPTH_UNITS),
    Hypothesis("depth has its two bytes exchanged", "exchange the bytes of each value", depth=_swapped),
    Hypothesis("depth is measured along the ray", "divide it by the ray's length at unit depth", depth=_along_ray),
    Hypothesis("depth was taken from the ray to the axis twice", "leave it as it was measured", depth=_divided_twice),
    Hypothesis("depth is inverse depth or disparity", "store focal length x baseline / disparity", depth=_inverse),
)
"""Of stored depth: the floor shows them."""
PLACES = (
    Hypothesis("depth is mirrored against its image", BACK, placed=lambda depth: depth[:, ::-1]),
    Hypothesis("depth is flipped top to bottom against its image", BACK, placed=lambda depth: depth[::-1]),
    Hypothesis("depth is turned by 180 degrees against its image", BACK, placed=lambda depth: depth[::-1, ::-1]),
    *(
        Hypothesis(f"depth is not registered to its image, {size:g} of its size", REGISTER, placed=_in_size(size))
        for size in (0.72, 0.84, 0.92, 1.09, 1.19, 1.39)
    ),
)
"""Of depth on its image, whose edges it has. Unregistered depth has the size of another lens: 0.92 of Kinects, 0.72 of
RealSense."""
BESIDE = Hypothesis("depth is not registered to its image but lies beside it", REGISTER)
LATE = {
    "right camera": Hypothesis("the cameras are not synchronous, or one of them is numbered one higher", TIMES),
    "depth": Hypothesis("depth and its image are not of one time", TIMES),
}
"""Of time: what moves, moves in both at once."""
HYPOTHESES = (*PAIRS, COLOURS, *VIEWS, *DEPTHS, *PLACES, BESIDE, *LATE.values())
UNEXPLAINED = f"none of {len(HYPOTHESES)} causes that were tried explains it"


@dataclass(frozen=True)
class Explained:
    """The hypothesis that makes a recording fit, and what it gives."""

    hypothesis: Hypothesis
    gives: str

    def __str__(self) -> str:
        return f"if {self.hypothesis.name}, {self.gives}: {self.hypothesis.remedy}"


class FloorView(NamedTuple):
    """The floor in some depth, None where none is found, and how plausible it is with what moves above it: the
    logarithm of its share of the depth, and of how usual the heights of camera and people are."""

    floor: Floor | None = None
    plausible: float = -math.inf

    def __str__(self) -> str:
        return f"the floor is {self.floor.height_m:.2f} m below the camera" if self.floor else "no floor is found"


def view_of(depths: Sequence[F32], geometry: RectifiedGeometry, search: FloorSearch) -> FloorView:
    """The view in (H, W) float32 depth images [m], NaN where unknown."""
    known = np.concatenate([np.empty(0), *(depth[::8, ::8].ravel() for depth in depths)])
    known = known[np.isfinite(known)]
    if not len(known) or not VIEW_M[0] < np.median(known) < VIEW_M[1]:
        return FloorView()
    try:
        floor = floor_in(depths, geometry, search.floor, "")
    except WorkError:
        return FloorView()
    grids = [back_project(depth, geometry)[::FITTED_STEP_PX, ::FITTED_STEP_PX] for depth in depths]
    moved = [floor.world_SE3_left @ patch for patch in moved_patches(grids) or () if len(patch) >= MIN_BODY]
    off = math.log(floor.height_m / CAMERA_M) / CAMERA_SPREAD
    plausible = math.log(max(floor.inlier_fraction, 1e-6)) - 0.5 * off**2
    if moved:
        tall_m = float(np.percentile([np.percentile(points[:, 2], 95) for points in moved], 75))
        plausible -= 0.5 * min(abs(tall_m - PERSON_M) / PERSON_STD_M, PERSON_STDS_MAX) ** 2
    return FloorView(floor, plausible)


def _taken(
    hypothesis: Hypothesis, depths: Sequence[F32], geometry: RectifiedGeometry, search: FloorSearch
) -> FloorView:
    """The view under one of ``VIEWS``."""
    for _ in range(hypothesis.turns):
        depths, g = [np.ascontiguousarray(np.rot90(depth)) for depth in depths], geometry
        geometry = replace(
            g, width=g.height, height=g.width, focal_u_px=g.focal_v_px, focal_v_px=g.focal_u_px, cu_px=g.cv_px,
            cv_px=g.width - 1 - g.cu_px, baseline_m=g.disparity_metre / g.focal_v_px,
        )  # fmt: skip
    factor = hypothesis.baseline
    geometry = replace(geometry, baseline_m=geometry.baseline_m * factor)
    return view_of([depth * np.float32(factor) for depth in depths], geometry, search)


def _better(tried: Iterable[tuple[Hypothesis, FloorView]], own: FloorView) -> Explained | None:
    """The hypothesis of the most plausible view, where that is better than the view as recorded."""
    hypothesis, view = max(tried, key=lambda one: one[1].plausible)
    if view.floor is None or view.plausible < max(PLAUSIBLE, own.plausible + math.log(BETTER)):
        return None
    return Explained(hypothesis, str(view) + (f" in place of {own.floor.height_m:.2f} m" if own.floor else ""))


class _Pairs:
    """Some pairs under a hypothesis."""

    def __init__(self, hypothesis: Hypothesis, rig: StereoRig, shots: Sequence[Shot]) -> None:
        self.hypothesis = hypothesis
        self._rectifier = Rectifier(hypothesis.rig(rig) if hypothesis.rig else rig, RectifyParams(working_px=WIDTH))
        self._shots, self._offsets, self._tried = shots, list[float](), 0

    def _rectified(self, shot: Shot) -> Rectified | None:
        """None where images as they would be are of another size than the calibration's."""
        images, rig = self.hypothesis.images(shot[0], shot[1]), self._rectifier.rig
        sizes = [image.shape[1::-1] for image in images]
        return self._rectifier(*images) if sizes == [rig.left.size, rig.right.size] else None

    def aligned(self, count: int) -> float:
        """Share of the corners of the first pairs that lie on their rows, nearer than infinity."""
        reach = 0.25 * WIDTH
        for shot in self._shots[self._tried : count]:
            self._tried += 1
            if (pair := self._rectified(shot)) is not None:
                greys = pair.left_grey, pair.right_grey
                matches = match_corners(*greys, reach, -reach, features=CORNERS, search_px=6)
                self._offsets += matches[matches[:, 0] - matches[:, 2] > -0.5, 3].tolist()
        near = np.maximum(0.0, 1.0 - (np.array(self._offsets) / ROW_PX) ** 2)
        return float(near.sum()) / (CORNERS * max(self._tried, 1))

    @property
    def rows_px(self) -> float:
        """Median row offset [px of 640]."""
        return 640.0 / WIDTH * float(np.median(np.abs(self._offsets))) if self._offsets else math.nan

    @property
    def geometry(self) -> RectifiedGeometry:
        return self._rectifier.geometry

    def depths(self) -> list[F32]:
        """(H, W) float32 depth [m], NaN where unknown, of every pair: in another unit nothing is too far."""
        searched = DisparityRange(0, 16 * math.ceil(0.25 * WIDTH / 16))
        match = SgbmMatcher(self.geometry, None, searched, self._rectifier.mask, self._rectifier.right_mask)
        pairs = [pair for shot in self._shots if (pair := self._rectified(shot)) is not None]
        found = [match(pair.left_grey, pair.right_grey) for pair in pairs]
        least, metre = np.float32(0.5), np.float32(self.geometry.disparity_metre)
        return [np.asarray(metre / np.where(d >= least, d, np.float32(np.nan)), np.float32) for d in found]


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
    looks = [_Pairs(hypothesis, rig, shots) for hypothesis in (AS_RECORDED, *PAIRS)]
    first = [look.aligned(FIRST_FRAMES) for look in looks]
    looks = [look for look, share in zip(looks, first, strict=True) if share >= 0.5 * max(first) or look is looks[0]]
    shares = np.array([look.aligned(len(shots)) for look in looks])
    if shares.max() < ALIGNED:
        return None
    likely = [int(k) for k in np.argsort(-shares, kind="stable") if shares[k] >= shares.max() / BETTER]
    views = {k: view_of(looks[k].depths(), looks[k].geometry, search) for k in likely}
    # Which way is down rows alone do not show.
    at = max(likely, key=lambda k: views[k].plausible + math.log(shares[k]) + math.log(BETTER) * (k == 0))
    if views[at].floor is None:
        at = 0 if 0 in views else likely[0]
    if at > 0:
        rows = f"matched corners are on their rows within {looks[at].rows_px:.1f} px of 640"
        return Explained(looks[at].hypothesis, f"{rows} and {views[at]}")
    depths, geometry = looks[0].depths(), looks[0].geometry
    return _better(((hypothesis, _taken(hypothesis, depths, geometry, search)) for hypothesis in VIEWS), views[0])


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
    return Explained(COLOURS, gives)


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

    geometry, as_recorded = rectifier.geometry, depths(_in_units(units))
    own = view_of(as_recorded, geometry, search)
    tried = [(h, view_of(depths(h.depth), geometry, search)) for h in DEPTHS if h.depth]
    turned = [(h, _taken(h, as_recorded, geometry, search)) for h in VIEWS if h.turns]
    return _better([*tried, *turned], own)


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
    scores = _edge_scores(frames) if len(frames) >= 4 else np.zeros((1, 1, 1))
    if scores.max() < EDGES_MIN:
        return PlaceOfDepth()
    peaks = scores.reshape(len(scores), -1).max(axis=1)
    at = np.unravel_index(int(np.argmax(scores[0])), scores[0].shape)
    down, across = ((int(place) - reach) * 640.0 / WIDTH for place, reach in zip(at, REACH_PX, strict=True))
    found, best = None, int(np.argmax(peaks))
    where = f"edges and people fit best {across:+.0f} px to the right, {down:+.0f} down, of 640"
    if peaks[best] > BETTER * max(peaks[0], 0.5 * EDGES_MIN):
        found = Explained(PLACES[best - 1], f"edges fit by {peaks[best]:.2f} in place of {peaks[0]:.2f}")
    elif max(abs(across), abs(down)) > SHIFT_PX_MAX and peaks[0] > BETTER * scores[0][REACH_PX]:
        found = Explained(BESIDE, where)
    return PlaceOfDepth((across, down), found)


def _edge_scores(frames: Sequence[Frame[Shot]]) -> F64:
    """Of depth as it is and under each of ``PLACES``: mean correlation with the image at every shift."""
    images, depths = small_images(frames), small_depths(frames)
    usual, usual_depth = median_image(images), median_image(depths)
    scores = np.zeros((1 + len(PLACES), 2 * REACH_PX[0] + 1, 2 * REACH_PX[1] + 1))
    for image, depth in zip(images, depths, strict=True):
        with np.errstate(invalid="ignore"):
            near = (usual_depth - depth > 0.2).astype(np.float32)
        moved = (np.abs(image - usual) > CHANGE_LEVEL).astype(np.float32)
        for seen, measured in ((_edges(image), _depth_edges(depth)), (moved, near)):
            for score, hypothesis in zip(scores, (AS_RECORDED, *PLACES), strict=True):
                score += _correlation(np.ascontiguousarray(hypothesis.placed(measured)), seen) / len(frames)
    return scores


def small_images(frames: Sequence[Frame[Shot]]) -> list[F32]:
    """(h, ``WIDTH``) grey image of each frame."""
    small = (cv2.resize(as_grey(frame.image), _small(frame), interpolation=cv2.INTER_AREA) for frame in frames)
    return [np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0), dtype=np.float32) for image in small]


def small_depths(frames: Sequence[Frame[Shot]]) -> list[F32]:
    """(h, ``WIDTH``) depth [m] of each frame, NaN where unknown."""
    nearest = (cv2.resize(frame.images[1], _small(frame), interpolation=cv2.INTER_NEAREST) for frame in frames)
    return [np.asarray(depth, dtype=np.float32) for depth in nearest]


def _small(frame: Frame[Shot]) -> tuple[int, int]:
    rows, columns = frame.image.shape[:2]
    return WIDTH, max(1, round(rows * WIDTH / columns))


def _edges(image: F32) -> F32:
    """Strength of the edges of an image; capped at that of the strongest tenth."""
    strength = np.hypot(cv2.Sobel(image, cv2.CV_32F, 1, 0), cv2.Sobel(image, cv2.CV_32F, 0, 1))
    return np.asarray(np.minimum(strength, np.percentile(strength, 90)), dtype=np.float32)


def _depth_edges(depth: F32) -> F32:
    """1 where known depth jumps within three pixels, else 0."""
    known, kernel = np.isfinite(depth), np.ones((3, 3), np.uint8)
    far = cv2.dilate(np.where(known, depth, 0.0).astype(np.float32), kernel)
    near = cv2.erode(np.where(known, depth, 99.0).astype(np.float32), kernel)
    return np.asarray(far - near > 0.1 + 0.05 * near, dtype=np.float32)


def _correlation(measured: F32, seen: F32) -> F64:
    """(2 y + 1, 2 x + 1) correlation of two maps of one size, the first moved by every shift of ``REACH_PX``."""
    a, b = (one - one.mean() for one in (measured, seen))
    norm = float(np.linalg.norm(a) * np.linalg.norm(b))
    (y, x), (rows, columns) = REACH_PX, seen.shape
    if norm < 1e-6:
        return np.zeros((2 * y + 1, 2 * x + 1))
    size = rows + y, columns + x
    product = np.fft.irfft2(np.conj(np.fft.rfft2(a, size)) * np.fft.rfft2(b, size), size)
    return np.asarray(np.roll(product, (y, x), (0, 1))[: 2 * y + 1, : 2 * x + 1] / norm, dtype=np.float64)
