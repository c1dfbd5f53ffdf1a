"""Checks of what is seen: rows, order and light of a pair, then floor, disparities and the height of people."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from calib.doubt import Finding
from calib.floor.plane import MIN_INLIER_FRACTION
from calib.images import as_grey
from calib.pose import SE3
from calib.rig import Floor
from calib.types import F32, F64, U8, Bool
from planview.checks.check import Check, limited
from planview.checks.motion import repeated_check
from planview.checks.timing import Lag, lag_of
from planview.foreground.ghosts import find_blobs
from planview.maps.grid import MapParams
from stereo.depth import RectifiedGeometry, back_project, median_image
from stereo.doctor.diagnose import diagnose, diagnose_colours, diagnose_fields, place_of_depth
from stereo.doctor.hypotheses import REGISTER, UNEXPLAINED
from stereo.doctor.overlay import SHIFT_PX_MAX, small_depths, small_images
from stereo.doctor.pairs import CHANGE_LEVEL
from stereo.floor import DepthFrames, FloorSearch, PairFrames
from stereo.matcher import SATURATED_LEVEL
from stereo.recording import DepthCamera, Frame, Recording, Shot, StereoPair
from stereo.rig_correction import fit_correction
from stereo.viewpoint import SWAY_DEG, SpreadView, Standing, Sway

MIN_MATCHES = 60
"""Fewest corners found in both images on which the geometry is judged."""


def alignment_checks(seen: PairFrames) -> list[Check]:
    """Row offset, what turn of a camera explains it, and left-right order."""
    plain = seen.plain
    matches = seen.matches
    correction = seen.correction
    enough = len(matches) >= MIN_MATCHES
    offset = float(np.median(np.abs(matches[:, 3]))) * 640.0 / plain.geometry.width if enough else math.nan
    positive = float(np.mean(matches[:, 0] - matches[:, 2] > -0.5)) if enough else math.nan
    turn = fit_correction(matches, plain.geometry)
    turned = (np.linalg.norm(turn.applied), np.linalg.norm(turn.deviations)) if enough else (math.nan, math.nan)
    turned_deg, std_deg = np.degrees(turned).tolist()
    return [
        limited("matched corners", float(len(matches)), "", "corners that both cameras show", least=MIN_MATCHES),
        # Share of corners whose right place is to the left of the left one; far corners may err by calibration.
        limited("left-right order", positive, "", "share of corners nearer than infinity", least=0.8),
        # Row offset of the calibration as it is [px of 640]: a factory calibration after some years has up to 0.5. A
        # run takes out the turn that explains it, but a rig that moved this far is better calibrated again.
        limited("row offset", offset, "px", "median, of 640 px, before the rig is corrected", most=1.5),
        # Rotation of the right camera since calibration: half a degree of pan shifts disparities by 3.5 px of 640, or
        # 15 % of the depth at 2 m; a worn factory calibration has up to 0.2.
        limited("camera turn", turned_deg, "deg", f"since calibration; {correction}", std=std_deg, most=0.5),
        # Row offset that is left [px]: block matching loses half of its matches beyond.
        limited("row residual", correction.after_px, "px", "median, after the rig is corrected", most=0.5),
    ]


CODED_BLOCK_PX = 8
"""Side of the blocks that JPEG, MPEG and H.264 transform."""


def image_checks(frames: Sequence[Frame[Shot]]) -> list[Check]:
    """Over-exposure, under-exposure, brightness of left against right, and compression, of frames as recorded."""
    sides = [[as_grey(image) for image in images] for images in zip(*(f.images for f in frames), strict=True)]
    levels = [float(np.median([np.mean(i[::4, ::4]) for i in side])) + 1.0 for side in sides]
    ratio = max(levels) / min(levels)
    blocks = max(float(np.median([blocking(i) for i in side])) for side in sides)
    steps = "steps at the borders of 8x8 blocks over those inside: compress less"
    return [
        *light_checks(*sides),
        # Ratio of the cameras' median brightness; block matching bears small differences only.
        limited("brightness match", ratio, "", "mean brightness of one camera over the other", most=2.0),
        # Grey steps at the borders of blocks over those inside, which match at the same place in both cameras and
        # pull disparities there. Images as recorded have 0.7 to 1.3, JPEG of quality 10 has 5 and loses the floor.
        limited("compression", blocks, "", steps, most=2.0),
        explained_check("colours", diagnose_colours(frames), "rows of both cameras have the same colours", warns=True),
        *fields_checks(frames),
    ]


def explained_check(name: str, finding: Finding | None, note: str, *, warns: bool = False) -> Check:
    """Fails where something is explained by what should not be so."""
    return Check(name, finding is None, math.nan, note=str(finding or note), warns=warns)


def fields_checks(frames: Sequence[Frame[Shot]]) -> list[Check]:
    """A warning where the images of one camera, or of the left one of a pair, are woven of two fields."""
    finding = diagnose_fields(frames)
    return [explained_check("fields", finding, "", warns=True)] if finding else []


def light_checks(*cameras: Sequence[U8]) -> list[Check]:
    """Over-exposure and under-exposure, from images of one camera, or of the left and the right one."""
    sides = [[as_grey(image) for image in images] for images in cameras]
    over = [float(np.median([np.mean(i[::2, ::2] >= SATURATED_LEVEL) for i in side])) for side in sides]
    bright = [float(np.median([np.percentile(i[::2, ::2], 90) for i in side])) for side in sides]
    names = ["", ""] if len(sides) == 1 else [" of the left camera", " of the right camera"]
    most_over = names[int(np.argmax(over))]
    darkest = names[int(np.argmin(bright))]
    return [
        # Share of saturated pixels that leaves enough to see people by; a sunny terrace has up to a quarter.
        limited("over-exposure", max(over), "", f"share of saturated pixels{most_over}", most=0.35, warns=True),
        # The brightest tenth of a picture must reach this grey level: below, sensor noise is a good part of any
        # texture.
        limited("under-exposure", min(bright), "grey", f"brightest tenth of the picture{darkest}", least=40.0),
    ]


SHAKE_DEG = 0.1
"""Deviation of a camera's rotation from which it shakes [degrees]: 1 cm at 5 m."""


def standing_checks(standing: Standing, after: str) -> list[Check]:
    """Whether the cameras look where they looked before, from the frames so far; ``after``: what follows if not."""
    shake = shake_check(standing.sway)
    if standing.first is None:
        moved = Check("camera moved", True, 0.0, "frames", note="the cameras look where they looked before")
        if standing.swayed_frames:
            note = f"by more than {SWAY_DEG:g} degree in {standing.swayed_frames} frames, in which nobody is reported"
            shake = replace(shake, ok=False, note=f"{shake.note}; {note}")
        return [moved, shake]
    frame, time_s = standing.first
    paused = standing.moved_frames + standing.swayed_frames
    note = f"{standing.how} at frame {frame} ({time_s:.1f} s): {after}, and nobody is reported in {paused} frames"
    return [Check("camera moved", False, float(paused), "frames", note=note), shake]


def spread_checks(view: SpreadView) -> list[Check]:
    """The same, from frames spread over a recording."""
    moves = [f"{how} at frame {frame} or before" for frame, how in view.elsewhere.items()]
    note = moves[0] if moves else "the same view throughout"
    return [Check("camera moved", not moves, float(len(moves)), "frames", note=note), shake_check(view.sway)]


def shake_check(sway: Sway) -> Check:
    """A warning where cameras come and go about one view."""
    note = "rotation to and fro about one view; people are tracked, and their places err by as much: fix the mount"
    return limited("camera shake", sway.together_deg, "deg", note, most=SHAKE_DEG, warns=True)


def grey_level(image: U8) -> float:
    """Mean grey level of an image."""
    return float(as_grey(image)[::8, ::8].mean())


def flicker_check(levels: Sequence[float]) -> Check:
    """Light that alternates, from the mean grey levels of consecutive frames."""
    own = np.asarray(levels, dtype=np.float64)
    share = math.nan
    if len(own) > 8:
        steps = np.diff(own) * np.where(np.arange(len(own) - 1) % 2, 1.0, -1.0)
        darker = abs(float(np.median(steps)))
        share = darker / max(float(np.mean(own)) + 0.5 * darker, 1.0)
    # A lamp's flicker and automatic exposure change a few percent.
    note = "share by which every second frame is darker: exposure or emitter alternates; both lights are followed"
    return limited("light from frame to frame", share, "", note, most=0.08, warns=True)


def blocking(image: U8) -> float:
    """Mean grey step along the rows of a (H, W) image across the borders of blocks, over that inside of them."""
    steps = np.abs(np.diff(image[::4].astype(np.int16), axis=1)).mean(axis=0)
    border = np.arange(len(steps)) % CODED_BLOCK_PX == CODED_BLOCK_PX - 1
    return float(steps[border].mean() / max(float(steps[~border].mean()), 1e-3)) if border.any() else np.nan


HEIGHT_TOLERANCE = 0.08
"""A known height must be met within this share: 5 cm of noise and shoes, and some error of the floor."""
POSSIBLE_M = (0.4, 2.3)
LIKELY_M = (1.5, 1.95)
"""Heights of moving things that can be people, and of standing adults, whom a usual recording shows [m]."""


def height_check(heights: F64, person_height_m: float | None = None) -> Check:
    """Measured (N,) heights [m] of people against the known one, or against what people can be."""
    # Cut by the image's edge or half hidden, people look smaller, never taller.
    value = float(np.percentile(heights, 75)) if len(heights) >= 3 else math.nan
    if person_height_m is None:
        unknown = "of moving people; no known height was given"
        # Heights of moving things when no person's height is known: a pushed chair or box to a tall man in a hat.
        if not math.isfinite(value) or not POSSIBLE_M[0] <= value <= POSSIBLE_M[1]:
            return limited("person height", value, "m", unknown, least=POSSIBLE_M[0], most=POSSIBLE_M[1])
        causes = "a wrong focal length, baseline or unit of length in the calibration, or no standing adults"
        inside = LIKELY_M[0] <= value <= LIKELY_M[1]
        note = unknown if inside else f"likely {causes}"
        return limited("person height", value, "m", note, least=LIKELY_M[0], most=LIKELY_M[1], warns=True)
    least = person_height_m * (1 - HEIGHT_TOLERANCE)
    most = person_height_m * (1 + HEIGHT_TOLERANCE)
    note = f"known to be {person_height_m:g} m" if math.isfinite(value) else "no person was found to measure"
    return limited("person height", value, "m", f"{note}: baseline and units", least=least, most=most, needed=True)


def person_heights(seen: PairFrames | DepthFrames, floor: Floor | None) -> F64:
    """(N,) heights [m] of things that stand out of the background, one per thing and frame."""
    if floor is None:
        return np.empty(0)
    geometry = seen.rectifier.geometry
    disparities = seen.disparities
    background = median_image(disparities)
    # Disparity by which something must be nearer than the background to stand out of it: four deviations.
    moved = (disparity - background > 1.0 for disparity in disparities)
    things = [standing_things(d, m, geometry, floor) for d, m in zip(disparities, moved, strict=True)]
    return large_heights(np.concatenate(things))


def large_heights(things: F64) -> F64:
    """Heights [m] of those (N, 2) ``standing_things`` that are no shreds."""
    if len(things) == 0:
        return np.empty(0)
    # Things with less than this part of the surface of the largest ones are shreds, not people.
    large = things[:, 1] >= 0.4 * np.percentile(things[:, 1], 90)
    return np.asarray(things[large, 0], dtype=np.float64)


def heights_above_floor(points: F32, world_SE3_left: SE3) -> F32:
    """(H, W) heights [m] of (H, W, 3) points of the rectified left camera."""
    z = world_SE3_left.rotation[2].astype(np.float32)
    return np.asarray(points @ z + np.float32(world_SE3_left.translation[2]), dtype=np.float32)


def standing_things(disparity: F32, moved: Bool, geometry: RectifiedGeometry, floor: Floor, step: int = 1) -> F64:
    """(N, 2) height [m] and surface (in units that all things share) of what stands out of the background, from the
    (H, W) disparity of samples of step x step pixels, NaN where unknown, and whether a sample moved."""
    depth = geometry.depth(disparity)
    above = heights_above_floor(back_project(depth, geometry, step), floor.world_SE3_left)
    stands_out = moved & (above > 0.25)  # [m]
    mask = cv2.morphologyEx(stands_out.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    blobs = find_blobs(np.asarray(mask, dtype=np.uint8))
    surface = depth * depth
    # Share of the picture that a person takes: at 8 m some 0.2 %. Not an area in metres, which would hide wrong
    # units.
    min_px, max_px = (share * mask.size for share in (0.001, 0.25))
    found = []
    for label in range(1, len(blobs)):
        # At the upper edge of the image a head may be outside.
        if blobs.box_px[label, 1] > 2 and min_px <= blobs.area_px[label] <= max_px:
            of_it = (blobs.labels == label) & np.isfinite(above)
            # Percentile of a person's points used as the top of the head: single points above it are wrong matches.
            found.append((float(np.percentile(above[of_it], 98.0)), float(surface[of_it].sum())))
    return np.array(found, dtype=np.float64).reshape(-1, 2)


VALID_SHARE_MIN = 0.35
"""Share of pixels with a disparity; bare walls and saturated floors have none, people must."""


def scene_checks(seen: PairFrames | DepthFrames, floor: Floor | None, refused: str) -> list[Check]:
    """Share of valid disparity, floor share, flatness and height, depth and cell error at 2, 4 and 8 m."""
    inside = seen.rectifier.mask > 0
    shares = [float(np.mean(np.isfinite(disparity[inside]))) for disparity in seen.disparities]
    return [
        limited(
            "valid disparity", float(np.median(shares)), "", "share of the picture, median frame", least=VALID_SHARE_MIN
        ),
        *floor_checks(floor, refused),
        *depth_checks(seen.rectifier.geometry),
    ]


def floor_checks(floor: Floor | None, refused: str = "") -> list[Check]:
    """Share, flatness and distance of the floor (None: ``refused`` gives the reason), and a warning where it may be a
    wall."""
    share, height_m = (floor.inlier_fraction, floor.height_m) if floor else (math.nan, math.nan)
    std_m = math.nan if floor is None or floor.covariance is None else math.sqrt(floor.covariance[0, 0])
    why = "share of valid depth that lies on it" if floor else refused
    checks = [
        # Share of valid depth on the floor (a hand's breadth of floor between furniture still shows it).
        limited("floor share", share, "", why, least=0.10, needed=floor is None),
        # Deviation of floor points from the plane [m]: with more, a foot looks like a shadow.
        limited("floor flatness", floor.residual_m if floor else math.nan, "m", "rms from the plane", most=0.12),
        camera_height(height_m, "above the floor", std_m),
    ]
    if floor and floor.doubt:
        checks.append(Check("floor or wall", False, math.degrees(floor.tilt_rad), "deg", note=floor.doubt, warns=True))
    return checks


OUTDATED_DEG = 2.0
OUTDATED_M = 0.10
"""A floor that is further from the one that the images show puts the heads of people 6 cm off their places, or makes
people 10 cm taller or smaller; right ones of rendered rooms are within 0.4 degrees and 1 cm."""
OUTDATED_DEVIATIONS = 4.0
"""And as many standard deviations of the one that the images show."""
OUTDATED_RATIO = 3.0
"""Points on the plane that the images show alone, over those on the given one alone, from which that is no other plane
of the same room."""


def given_floor_check(seen: PairFrames | DepthFrames, given: SE3, found: Floor, source: str) -> Check:
    """Whether a floor that was measured before is still that which the background shows; ``source`` names its file."""
    now = found.world_SE3_left
    name = "given floor"
    angle_deg = math.degrees(math.acos(min(1.0, float(given.rotation[2] @ now.rotation[2]))))
    lower_m = float(given.translation[2]) - found.height_m
    spread = np.zeros(3) if found.covariance is None else OUTDATED_DEVIATIONS * np.sqrt(np.diag(found.covariance))
    has_rotated = angle_deg > max(OUTDATED_DEG, math.degrees(float(spread[1:].max())))
    has_moved = abs(lower_m) > max(OUTDATED_M, float(spread[0]))
    if not (has_rotated or has_moved) or _is_other_plane(seen, given, found):
        return Check(name, True, angle_deg, "deg", note=f"of {source} against the floor that the images show")
    how = [f"rotated by {angle_deg:.1f} degrees"] * has_rotated
    how += [f"moved {'down' if lower_m > 0 else 'up'} by {abs(lower_m):.2f} m"] * has_moved
    note = (
        f"{source} no longer fits: the images show a floor {found.height_m:.2f} m below the camera at tilt "
        f"{math.degrees(found.tilt_rad):.1f} degrees; the camera has {' and '.join(how)} since the file was written"
    )
    return Check(name, False, angle_deg, "deg", note=note)


def _is_other_plane(seen: PairFrames | DepthFrames, given: SE3, found: Floor) -> bool:
    """Whether a given floor is there next to the plane that was found, as below a table; or hidden below it, so that
    people are as tall as they are above the given one only."""
    geometry = seen.rectifier.geometry
    points = back_project(geometry.depth(median_image(seen.disparities)), geometry)
    off = []
    for pose in (given, found.world_SE3_left):
        with np.errstate(invalid="ignore"):
            # Medians deviate by a third of a frame's noise: three of their deviations, and what calibrations warp.
            noise_m = 0.02 + pose.translation[2] / points[..., 2] * geometry.depth_std_m(points[..., 2])
            off.append(np.abs(heights_above_floor(points, pose)) / noise_m)
    alone = [float(np.mean((a < 1.0) & (b > 2.0))) for a, b in (off, off[::-1])]
    if alone[0] > MIN_INLIER_FRACTION and alone[1] < OUTDATED_RATIO * alone[0]:
        return True
    height_m = height_check(person_heights(seen, found)).value
    low, high = LIKELY_M
    return height_m < low and low <= height_m + float(given.translation[2]) - found.height_m <= high


def camera_height(height_m: float, note: str, std_m: float = math.nan) -> Check:
    """A height above the floor from which people can be tracked."""
    return limited("camera height", height_m, "m", note, std=std_m, least=1.2, most=10.0)


DOUBTED = frozenset({
    "left-right order", "row offset", "camera turn", "row residual", "valid disparity", "floor share", "floor flatness",
    "camera height", "person height",
})  # fmt: skip
"""Checks whose failure another reading of the recording may explain."""


def explanation_checks(
    recording: Recording[StereoPair | DepthCamera], checks: Sequence[Check], floor: Floor | None, search: FloorSearch
) -> list[Check]:
    """What explains the checks that failed; nothing where there is nothing to explain."""
    small = floor is not None and floor.inlier_fraction < recording.sensor.floor_share_doubted
    failed = any(not check.ok and check.name in DOUBTED for check in checks)
    if not (failed or small):
        return []
    finding = diagnose(recording, search)
    return [explained_check("explanation", finding, UNEXPLAINED, warns=True)] if failed or finding else []


def registration_checks(spread: Sequence[Frame[Shot]], run: Sequence[Frame[Shot]]) -> list[Check]:
    """Whether depth lies on its image, of frames spread over a recording, and is of its time, of consecutive ones."""
    place = place_of_depth(spread)
    name = "depth on its image"
    if place.finding:  # depth of another place is worse, of another view useless
        check = explained_check(name, place.finding, "", warns=place.finding.hypothesis.remedy == REGISTER)
    else:
        farthest_px = max(abs(shift_px) for shift_px in place.shift_px)
        check = limited(name, farthest_px, "px", str(place), most=SHIFT_PX_MAX, warns=True)
    lag = delay_of(run) if check.ok or check.warns else Lag()
    return [check, lag.check("depth delay", "depth", " of its image", apart=lag.apart)]


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
    moved = [_cells(np.abs(b - a) > CHANGE_LEVEL) for a, b in pairwise(images)]
    with np.errstate(invalid="ignore"):
        stepped = [_cells(np.abs(b - a) > 0.1 + 0.02 * a**2) for a, b in pairwise(depths)]
    return lag_of(np.stack(moved), np.stack(stepped))


def _cells(mask: F32) -> F64:
    """The root of the share of a mask in each part of the image."""
    share = cv2.resize(mask.astype(np.float32), CELLS[::-1], interpolation=cv2.INTER_AREA)
    return np.sqrt(share.astype(np.float64)).ravel()


def depth_checks(geometry: RectifiedGeometry) -> list[Check]:
    """Predicted deviation of depth, and of a point's place in cells of the plan-view map, at 2, 4 and 8 m."""
    checks = []
    cell_m = MapParams().cell_m
    note = "predicted standard deviation"
    # Largest deviation at a distance [m]: at 4 m half a metre is a person's width.
    for distance, most in ((2, 0.15), (4, 0.5), (8, None)):
        deviation = geometry.depth_std_m(float(distance))
        checks.append(limited(f"depth error at {distance} m", deviation, "m", note, most=most))
        cells = math.hypot(deviation, distance / geometry.focal_u_px * geometry.disparity_std_px) / cell_m
        checks.append(limited(f"cell error at {distance} m", cells, "cells", f"cells of {cell_m * 100:g} cm"))
    return checks
