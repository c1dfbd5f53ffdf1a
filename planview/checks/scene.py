"""Checks of geometry: rows and order of a pair, floor, depth, and what explains those that failed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from calib.floor.plane import MIN_INLIER_FRACTION
from calib.pose import SE3
from calib.rig import Floor
from calib.types import F32, F64
from planview.checks.check import Check, limit_check
from planview.checks.heights import LIKELY_M, height_check, heights_above_floor, person_heights
from planview.checks.images import explained_check
from planview.checks.motion import repeated_check
from planview.checks.timing import Lag, lag_of
from stereo.depth import RectifiedGeometry, back_project, median_image
from stereo.doctor.diagnose import diagnose, place_of_depth
from stereo.doctor.hypotheses import REGISTER, UNEXPLAINED
from stereo.doctor.overlay import SHIFT_PX_MAX, small_depths, small_images
from stereo.doctor.pairs import CHANGE_LEVEL
from stereo.floor import DepthFrames, FloorSearch, PairFrames
from stereo.recording import DepthCamera, Frame, Recording, Shot, StereoPair

MIN_MATCHES = 60
"""Fewest corners found in both images on which the geometry is judged."""


def alignment_checks(seen: PairFrames) -> list[Check]:
    """Row offset, which rotation of a camera explains it, and left-right order."""
    plain = seen.plain
    matches = seen.matches
    offset_px = math.nan
    ordered = math.nan
    turned_deg = math.nan
    std_deg = math.nan
    correction = seen.correction
    if len(matches) >= MIN_MATCHES:
        offset_px = float(np.median(np.abs(matches[:, 3]))) * 640.0 / plain.geometry.width
        ordered = float(np.mean(matches[:, 0] - matches[:, 2] > -0.5))
        turned_deg = float(np.degrees(np.linalg.norm(correction.applied)))
        std_deg = float(np.degrees(np.linalg.norm(correction.deviations)))
    return [
        limit_check("matched corners", float(len(matches)), "", "corners that both cameras show", least=MIN_MATCHES),
        # Share of corners whose right place is to the left of the left one; far corners may err by calibration.
        limit_check("left-right order", ordered, "", "share of corners nearer than infinity", least=0.8),
        # Row offset of the calibration as it is [px of 640]: a factory calibration after some years has up to 0.5. A
        # run takes out the turn that explains it, but a rig that moved this far is better calibrated again.
        limit_check("row offset", offset_px, "px", "median, of 640 px, before the rig is corrected", most=1.5),
        # Rotation of the right camera since calibration: half a degree of pan shifts disparities by 3.5 px of 640, or
        # 15 % of the depth at 2 m; a worn factory calibration has up to 0.2.
        limit_check("camera turn", turned_deg, "deg", f"since calibration; {correction}", std=std_deg, most=0.5),
        # Row offset that is left [px]: block matching loses half of its matches beyond.
        limit_check("row residual", correction.after_px, "px", "median, after the rig is corrected", most=0.5),
    ]


VALID_SHARE_MIN = 0.35
"""Share of pixels with a disparity; bare walls and saturated floors have none, people must."""


def disparity_check(shares: Sequence[float]) -> Check:
    """The share of pixels with a disparity in the median frame."""
    share = float(np.median(shares)) if len(shares) else math.nan
    return limit_check("valid disparity", share, "", "share of the picture, median frame", least=VALID_SHARE_MIN)


def scene_checks(seen: PairFrames | DepthFrames, floor: Floor | None, refused: str) -> list[Check]:
    """Share of valid disparity, floor share, flatness and height, and the error of depth."""
    inside = seen.rectifier.mask > 0
    shares = [float(np.mean(np.isfinite(disparity[inside]))) for disparity in seen.disparities]
    return [disparity_check(shares), *floor_checks(floor, refused), *depth_checks(seen.rectifier.geometry)]


def floor_checks(floor: Floor | None, refused: str = "") -> list[Check]:
    """Share, flatness and distance of the floor (None: ``refused`` gives the reason), and a warning where it may be a
    wall."""
    share = math.nan
    flatness_m = math.nan
    height_m = math.nan
    std_m = math.nan
    note = refused
    if floor is not None:
        share = floor.inlier_fraction
        flatness_m = floor.residual_m
        height_m = floor.height_m
        note = "share of valid depth that lies on it"
        if floor.covariance is not None:
            std_m = math.sqrt(floor.covariance[0, 0])
    checks = [
        # Share of valid depth on the floor (a hand's breadth of floor between furniture still shows it).
        limit_check("floor share", share, "", note, least=0.10, needed=floor is None),
        # Deviation of floor points from the plane [m]: with more, a foot looks like a shadow.
        limit_check("floor flatness", flatness_m, "m", "rms from the plane", most=0.12),
        camera_height(height_m, "above the floor", std_m),
    ]
    if floor is not None and floor.doubt:
        checks.append(Check("floor or wall", False, math.degrees(floor.tilt_rad), "deg", note=floor.doubt, warns=True))
    return checks


OUTDATED_DEG = 2.0
OUTDATED_M = 0.10
"""A floor that is further from the one that the images show puts people 6 cm off their places, or makes them 10 cm
taller or smaller; right ones of rendered rooms are within 0.4 degrees and 1 cm."""
OUTDATED_DEVIATIONS = 4.0
"""And as many standard deviations of the one that the images show."""
OUTDATED_RATIO = 3.0
"""Points on the plane that the images show alone, over those on the given one alone, from which that is no other plane
of the same room."""


def given_floor_check(seen: PairFrames | DepthFrames, given: SE3, shown: Floor, source: str) -> Check:
    """A floor that was measured before, against that which the background shows; ``source`` names its file."""
    cosine = float(given.rotation[2] @ shown.world_SE3_left.rotation[2])
    angle_deg = math.degrees(math.acos(min(1.0, cosine)))
    lower_m = float(given.translation[2]) - shown.height_m
    deviations = np.zeros(3)
    if shown.covariance is not None:
        deviations = OUTDATED_DEVIATIONS * np.sqrt(np.diag(shown.covariance))
    changes = []
    if angle_deg > max(OUTDATED_DEG, math.degrees(float(deviations[1:].max()))):
        changes.append(f"rotated by {angle_deg:.1f} degrees")
    if abs(lower_m) > max(OUTDATED_M, float(deviations[0])):
        changes.append(f"moved {'down' if lower_m > 0 else 'up'} by {abs(lower_m):.2f} m")
    note = f"of {source} against the floor that the images show"
    is_outdated = bool(changes) and not _is_other_plane(seen, given, shown)
    if is_outdated:
        note = (
            f"{source} no longer fits: the images show a floor {shown.height_m:.2f} m below the camera at tilt "
            f"{math.degrees(shown.tilt_rad):.1f} degrees; the camera has {' and '.join(changes)} since the file was "
            "written"
        )
    return Check("given floor", not is_outdated, angle_deg, "deg", note=note)


def _is_other_plane(seen: PairFrames | DepthFrames, given: SE3, shown: Floor) -> bool:
    """True if a given floor is there next to the plane that the images show, as below a table; or is hidden below it,
    so that people are as tall as they are above the given one only."""
    geometry = seen.rectifier.geometry
    points = back_project(geometry.depth(median_image(seen.disparities)), geometry)
    off_given = _deviations_off(points, given, geometry)
    off_shown = _deviations_off(points, shown.world_SE3_left, geometry)
    given_alone = float(np.mean((off_given < 1.0) & (off_shown > 2.0)))
    shown_alone = float(np.mean((off_shown < 1.0) & (off_given > 2.0)))
    if given_alone > MIN_INLIER_FRACTION and shown_alone < OUTDATED_RATIO * given_alone:
        return True
    height_m = height_check(person_heights(seen, shown)).value
    low, high = LIKELY_M
    return height_m < low and low <= height_m + float(given.translation[2]) - shown.height_m <= high


def _deviations_off(points: F32, pose: SE3, geometry: RectifiedGeometry) -> F32:
    """(H, W) distances of points to a floor, over what noise makes of them: medians deviate by a third of a frame's, so
    that one is three of their deviations, and what calibrations warp."""
    with np.errstate(invalid="ignore"):
        noise_m = 0.02 + pose.translation[2] / points[..., 2] * geometry.depth_std_m(points[..., 2])
        return np.asarray(np.abs(heights_above_floor(points, pose)) / noise_m)


def camera_height(height_m: float, note: str, std_m: float = math.nan) -> Check:
    """A height above the floor from which people can be tracked."""
    return limit_check("camera height", height_m, "m", note, std=std_m, least=1.2, most=10.0)


DOUBTED = frozenset({
    "left-right order", "row offset", "camera turn", "row residual", "valid disparity", "floor share", "floor flatness",
    "camera height", "person height",
})  # fmt: skip
"""Checks whose failure another reading of the recording may explain."""


def explanation_checks(
    recording: Recording[StereoPair | DepthCamera], checks: Sequence[Check], floor: Floor | None, search: FloorSearch
) -> list[Check]:
    """The explanation of checks that failed; none where there is nothing to explain."""
    small = floor is not None and floor.inlier_fraction < recording.sensor.floor_share_doubted
    failed = any(not check.ok and check.name in DOUBTED for check in checks)
    if not (failed or small):
        return []
    finding = diagnose(recording, search)
    return [explained_check("explanation", finding, UNEXPLAINED, warns=True)] if failed or finding else []


def registration_checks(spread: Sequence[Frame[Shot]], run: Sequence[Frame[Shot]]) -> list[Check]:
    """The place of depth on its image, from frames spread over a recording, and its time, from consecutive ones."""
    place = place_of_depth(spread)
    farthest_px = float(np.abs(place.shift_px).max())
    check = limit_check("depth on its image", farthest_px, "px", str(place), most=SHIFT_PX_MAX, warns=True)
    if place.finding:  # depth of another place is worse, of another view useless
        check = explained_check(check.name, place.finding, "", warns=place.finding.hypothesis.remedy == REGISTER)
    lag = Lag() if check.failed else delay_of(run)
    return [check, lag.check("depth delay", "depth", " of its image")]


def run_checks(recording: Recording[Any]) -> list[Check]:
    """The checks of images with depth on frames of a recording that is about to be tracked."""
    first = max(0, recording.n_frames // 2 - CONSECUTIVE // 2)
    run = recording.at(list(range(first, min(recording.n_frames, first + CONSECUTIVE))))
    return [*registration_checks(recording.sample(8), run), repeated_check([frame.image for frame in run])]


CONSECUTIVE = 48
"""Frames in a row in which a delay is searched (our choice)."""
CELLS = (6, 8)
"""Parts of the image, down and across, in which movement is compared over time."""


def delay_of(frames: Sequence[Frame[Shot]]) -> Lag:
    """Frames by which depth moves after its image (see ``lag_of``)."""
    if len(frames) < 2:
        return Lag()
    images = small_images(frames)
    depths = small_depths(frames)
    image_moves = [_root_shares(np.abs(now - before) > CHANGE_LEVEL) for before, now in pairwise(images)]
    depth_moves = []
    with np.errstate(invalid="ignore"):
        for before, now in pairwise(depths):
            depth_moves.append(_root_shares(np.abs(now - before) > 0.1 + 0.02 * before**2))
    return lag_of(np.stack(image_moves), np.stack(depth_moves))


def _root_shares(mask: F32) -> F64:
    """The root of the share of a mask in each part of the image."""
    share = cv2.resize(mask.astype(np.float32), CELLS[::-1], interpolation=cv2.INTER_AREA)
    return np.sqrt(share.astype(np.float64)).ravel()


def depth_checks(geometry: RectifiedGeometry) -> list[Check]:
    """Predicted deviation of depth at 2, 4 and 8 m."""
    checks = []
    # Largest deviation at a distance [m]: at 4 m half a metre is a person's width.
    for distance_m, most in ((2, 0.15), (4, 0.5), (8, None)):
        deviation_m = geometry.depth_std_m(float(distance_m))
        note = "predicted standard deviation"
        checks.append(limit_check(f"depth error at {distance_m} m", deviation_m, "m", note, most=most))
    return checks
