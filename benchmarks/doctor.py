"""Faults made in healthy recordings, and what the doctor of recordings names: a matrix of faults and recordings."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple, cast

import cv2
import numpy as np
from cyclopts import Parameter

from benchmarks.options import JsonFlag, progress, report
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import AnyArray
from planview.checks.motion import MotionWatch, thumbnails
from planview.checks.scene import delay_of
from stereo.depth import DEPTH_UNITS, metres
from stereo.doctor.explain import RAW_UNITS, explain, explain_colours, explain_fields, place_of_depth
from stereo.doctor.hypotheses import COLOURS, FIELDS, LATE, LENGTHS, OFFSET_DEPTH, REGISTER, WHICH
from stereo.readers import open_any
from stereo.recording import Decoded, DepthCamera, Pair, Recording
from stereo.rectify import Rectifier, rectified_rig

FRAMES = 60
"""Consecutive frames in which a delay is looked for."""
Change = Callable[[AnyArray], AnyArray]
Read = Callable[[Sequence[int]], list[tuple[Decoded, Decoded]]]


class Fault(NamedTuple):
    """What is done to a recording: to the images, or image and stored depth, of a frame, to the head, and by how many
    frames the second camera is late, or the second field of both cameras' images if they are woven."""

    name: str
    images: Callable[[AnyArray, AnyArray], tuple[AnyArray, AnyArray]] | None = None
    head: Callable[[Any], Any] | None = None
    late: int = 0
    woven: bool = False


def _woven(now: AnyArray, later: AnyArray) -> AnyArray:
    """The even rows of one image and the odd ones of a later one."""
    return np.where(np.arange(len(now)).reshape(-1, *[1] * (now.ndim - 1)) % 2, later, now)


def _interlaced(image: AnyArray) -> AnyArray:
    return np.concatenate([image[::2], image[1::2]])


DONE: dict[str, Change] = {
    "mirrored": np.fliplr,
    "turned by 180 degrees": lambda image: np.rot90(image, 2),
    "flipped top to bottom": np.flipud,
    "turned by 90 degrees to the left": np.rot90,
    "turned by 90 degrees to the right": lambda image: np.rot90(image, -1),
    "interlaced, one field above the other": _interlaced,
    "of half the size": lambda image: cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA),
}


def pair_faults(rig: StereoRig) -> list[Fault]:
    """Each fault of pairs under the name that it should get."""

    def done(change: Change, exchanged: bool, left: bool, right: bool) -> Callable[..., tuple[AnyArray, AnyArray]]:
        def images(a: AnyArray, b: AnyArray) -> tuple[AnyArray, AnyArray]:
            a, b = (change(a) if left else a), (change(b) if right else b)
            return (b, a) if exchanged else (a, b)

        return images

    def calibrated(pose: SE3 | None = None, scale: float = 1.0) -> Callable[[Pair], Pair]:
        width, height = rig.left.size
        larger = rig.scaled(round(scale * width), round(scale * height))
        left, right = (replace(camera, width=width, height=height) for camera in (larger.left, larger.right))
        own = replace(larger, left=left, right=right)
        return lambda head: replace(head, rig=replace(own, right_SE3_left=pose or rig.right_SE3_left))

    pose, ideal = rig.right_SE3_left, rectified_rig(rig)
    inverse = SE3(pose.inverse().rotation, -pose.inverse().translation)
    aligned = rectified(rig)

    def shifted(a: AnyArray, b: AnyArray) -> tuple[AnyArray, AnyArray]:
        left, right = aligned(a, b)
        return left, np.roll(right, len(right) // 60, axis=0)

    lenses = replace(rig, left=rig.right, right=rig.left)
    sizes = {"twice": 2.0, "1.5 times": 1.5, "two thirds of": 2 / 3, "half": 0.5}
    found = [Fault(""), Fault("left and right are exchanged", lambda a, b: (b, a))]
    found += [Fault(f"{which} {what}", done(change, *how)) for what, change in DONE.items() for which, *how in WHICH]
    found += [
        Fault("the images of one camera are negative", lambda a, b: (a, 255 - b)),
        Fault("the images of one camera are negative", lambda a, b: (255 - a, b)),
        Fault("the images are rectified already", rectified(rig)),
        Fault("the pose of the right camera is inverted", head=calibrated(inverse)),
        Fault("the lenses of left and right are exchanged", head=lambda head: replace(head, rig=lenses)),
        *(Fault(f"the calibration is that of images {n} the size", head=calibrated(scale=f)) for n, f in sizes.items()),
        *(
            Fault(f"the baseline is in {unit}", head=calibrated(SE3(pose.rotation, pose.translation / metre)))
            for unit, metre in LENGTHS.items()
        ),
        Fault("the images are not rectified yet", head=lambda head: replace(head, rig=ideal)),
        Fault("the images of one camera are shifted up or down", shifted, lambda head: replace(head, rig=ideal)),
        Fault(FIELDS.name, late=1, woven=True),
        Fault(COLOURS.name, lambda a, b: (a, b[..., ::-1])),
        *(Fault(LATE["right camera"].name, late=n) for n in (1, 2)),
    ]
    return found


def rectified(rig: StereoRig) -> Callable[[AnyArray, AnyArray], tuple[AnyArray, AnyArray]]:
    """Images as OpenCV rectifies them."""
    pose, size = rig.right_SE3_left, rig.left.size
    (k1, d1), (k2, d2) = ((camera.matrix, camera.coefficients) for camera in (rig.left, rig.right))
    shift = pose.translation.reshape(3, 1)
    r1, r2, p1, p2, *_ = cv2.stereoRectify(k1, d1, k2, d2, size, pose.rotation, shift, alpha=0)
    left = cv2.initUndistortRectifyMap(k1, d1, r1, p1, size, cv2.CV_32FC1)
    right = cv2.initUndistortRectifyMap(k2, d2, r2, p2, size, cv2.CV_32FC1)
    return lambda a, b: (cv2.remap(a, *left, cv2.INTER_LINEAR), cv2.remap(b, *right, cv2.INTER_LINEAR))


def depth_faults(head: DepthCamera) -> list[Fault]:
    """Each fault of images with depth under the name that it should get."""
    camera, units = head.depth_camera or head.camera, head.depth_units.units_per_m if head.depth_units else 1.0
    rows, columns = np.indices(camera.size[::-1])
    ray = np.linalg.norm(camera.unproject(np.column_stack([columns.ravel(), rows.ravel()])), axis=1).reshape(rows.shape)

    def stored(change: Change) -> Callable[[AnyArray, AnyArray], tuple[AnyArray, AnyArray]]:
        def images(image: AnyArray, values: AnyArray) -> tuple[AnyArray, AnyArray]:
            changed = change(values)
            return image, np.where(changed < 65535, changed, 0).round().astype(np.uint16)

        return images

    def both(turns: int) -> Callable[[AnyArray, AnyArray], tuple[AnyArray, AnyArray]]:
        return lambda image, values: (np.rot90(image, turns), np.rot90(values, turns))

    def inverse(values: AnyArray) -> AnyArray:
        return np.where(values > 0, 2500.0 * units / np.maximum(values, 1), 0)  # disparity in sixty-fourths of a pixel

    against = ("mirrored", "flipped top to bottom", "turned by 180 degrees")
    found = [Fault("")]
    found += [
        Fault(f"depth counts {n:g} values per metre", stored(partial(np.multiply, n / units)))
        for n in DEPTH_UNITS
        if n != units
    ]
    found += [
        Fault("depth has its two bytes exchanged", stored(lambda z: z.byteswap())),
        Fault("depth is measured along the ray", stored(lambda z: z * ray)),
        Fault("depth was taken from the ray to the axis twice", stored(lambda z: z / ray)),
        Fault(
            "depth is inverse depth or disparity",
            stored(lambda z: np.where(z > 0, 2500.0 * units / np.maximum(z, 1), 0)),
        ),
        *(Fault(f"depth is {how} against its image", stored(DONE[how])) for how in against),
        Fault(OFFSET_DEPTH.name, stored(lambda z: np.roll(z, -round(0.04 * z.shape[1]), axis=1))),
        Fault("the camera hangs upside down", both(2)),
        *(Fault(LATE["depth"].name, late=n) for n in (1, 2)),
    ]
    return found


def stored(recording: Recording[Any]) -> Read:
    """Reads frames of a recording by ascending indices, with depth in ``RAW_UNITS``, and keeps them for all faults."""
    kept, units = dict[int, tuple[Decoded, Decoded]](), getattr(recording.head, "depth_units", None)

    def read(indices: Sequence[int]) -> list[tuple[Decoded, Decoded]]:
        assumed = units.units_per_m if units else 1.0
        try:
            if units:
                units.units_per_m = RAW_UNITS
            missing = sorted({*indices} - {*kept})
            kept.update((first.index, (first, second)) for first, second in recording.decode(missing))
        finally:
            if units:
                units.units_per_m = assumed
        return [kept[index] for index in indices]

    return read


def faulty(recording: Recording[Any], fault: Fault, read: Read) -> Recording[Any]:
    """The recording with the fault in it; ``read`` gives its frames (see ``stored``)."""
    head = fault.head(recording.head) if fault.head else recording.head
    units, last = getattr(head, "depth_units", None), recording.n_frames - 1 - fault.late

    def decode(indices: Sequence[int] | None) -> Generator[tuple[Decoded, Decoded], None, None]:
        frames = [i for i in (range(last + 1) if indices is None else indices) if i <= last]
        for (a, now), (later, b) in zip(read(frames), read([i + fault.late for i in frames]), strict=True):
            # The second camera shows at ``now`` what the first shows later.
            first, second = a.image, b.image
            if first is None or second is None or later.image is None or now.image is None:
                continue
            if fault.woven:
                first, second = _woven(first, later.image), _woven(now.image, second)
            if units is not None:
                second = np.nan_to_num(second * RAW_UNITS).round().astype(np.uint16)
            first, second = fault.images(first, second) if fault.images else (first, second)
            first, second = np.ascontiguousarray(first), np.ascontiguousarray(second)
            if units is not None:
                second = metres(second, units.units_per_m)
            yield replace(a, image=first), replace(now, image=second)

    return Recording(recording.path, cast(Any, decode), last + 1, recording.clock, [], head)


def named(recording: Recording[Any], consecutive: bool) -> str:
    """What the doctor names in a recording; empty where nothing."""
    spread, first = recording.sample(8), max(0, (recording.n_frames - FRAMES) // 2)
    if isinstance(recording.head, Pair):
        found = explain_colours(spread) or explain_fields(spread) or explain(recording)
    else:
        place = place_of_depth(spread).found
        offset = place if place and place.hypothesis.remedy == REGISTER else None  # a warning: where there is a floor
        found = (None if offset else place) or explain(recording) or offset
    if found or not consecutive:
        return found.names if found else ""
    run = recording.at(list(range(first, min(first + FRAMES, recording.n_frames))))
    if isinstance(recording.head, Pair):
        watch, rectifier = MotionWatch(), Rectifier(recording.head.rig)
        for pair in (rectifier(*frame.images) for frame in run):
            watch.update(thumbnails(pair.left_grey, pair.right_grey))
        late = any(check.name == "synchronisation" and not check.ok for check in watch.checks())
        return LATE["right camera"].name if late else ""
    return LATE["depth"].name if delay_of(run).apart else ""


@Parameter(name="*")
@dataclass(frozen=True)
class DoctorOptions:
    """Which recordings, and how figures are printed."""

    recording: Annotated[Sequence[Path], Parameter(negative="", show_default=False)] = (Path("data/synthetic/demo"),)
    """A healthy recording of pairs or of images with depth; repeat for more."""
    fault: str = ""
    """Only faults with this in their name."""
    json_output: JsonFlag = False
    """Print one JSON object."""


def doctor(*, options: DoctorOptions | None = None) -> None:
    """Make every fault in healthy recordings and print what the doctor names.

    Example: python -m benchmarks doctor --recording data/synthetic/demo --recording my_depth_recording
    """
    o = options or DoctorOptions()
    rows, totals = [], []
    for path in o.recording:
        recording = open_any(path)
        read, head, tally = stored(recording), recording.head, {"right": 0, "wrong": 0, "nothing": 0}
        faults = pair_faults(head.rig) if isinstance(head, Pair) else depth_faults(head)
        is_grey = isinstance(head, Pair) and all(image.ndim == 2 for image in recording.sample(1)[0].images)
        faults = [fault for fault in faults if not (is_grey and fault.name == COLOURS.name)]
        for fault in (fault for fault in faults if o.fault in fault.name):
            progress(f"{path}: {fault.name or 'as recorded'}")
            start = time.process_time()
            got = named(faulty(recording, fault, read), not fault.name or fault.late > 0)
            verdict = "right" if got == fault.name else "wrong" if got else "nothing"
            tally[verdict] += 1
            fault_name, got_name = fault.name or "as recorded", got or "nothing"
            seconds = time.process_time() - start
            rows.append(
                {"recording": path.name, "fault": fault_name, "verdict": verdict, "named": got_name, "cpu_s": seconds}
            )
        totals.append({"recording": path.name, **tally})
    report(o.json_output, faults=rows, recordings=totals)
