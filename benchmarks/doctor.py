"""Faults made in healthy recordings, and what the doctor of recordings names: a matrix of faults and recordings."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import cv2
import numpy as np

from benchmarks.options import Report, Row, benchmark, progress, tables
from calib.doubt import Finding
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import AnyArray
from planview.checks.motion import MotionWatch
from planview.checks.scene import delay_of
from planview.synthetic.assets import DEMO
from stereo.doctor.diagnose import diagnose, place_of_depth
from stereo.doctor.hypotheses import REGISTER
from stereo.readers import open_any
from stereo.recording import Decoded, DepthCamera, Frame, Recording, Shot, StereoPair
from stereo.rectify import Rectifier, rectified_rig
from stereo.rgbd import pixel_rays
from stereo.thumbnails import Thumbnails

FRAMES = 60
"""Consecutive frames in which a delay is looked for."""
Read = Callable[[Sequence[int]], list[tuple[Decoded, Decoded]]]
Images = Callable[[AnyArray, AnyArray], tuple[AnyArray, AnyArray]]


class Fault(NamedTuple):
    """Change of a recording: to the images, or image and stored depth, of a frame, to the sensor, and by how many
    frames the second camera is late."""

    name: str
    images: Images | None = None
    sensor: Callable[[Any], Any] | None = None
    late: int = 0


NOT_SYNCHRONOUS = "the cameras are not synchronous, or one of them is numbered one higher"


def upside_down(image: AnyArray) -> AnyArray:
    return np.rot90(image, 2)


def pair_faults(rig: StereoRig) -> list[Fault]:
    """Each fault of pairs under the name that it should get."""
    pose = rig.right_SE3_left
    aligned = rectified(rig)

    def with_rig(other: StereoRig) -> Callable[[StereoPair], StereoPair]:
        return lambda sensor: replace(sensor, rig=other)

    def sized(scale: float) -> Callable[[StereoPair], StereoPair]:
        width, height = rig.left.size
        larger = rig.scaled(round(scale * width), round(scale * height))
        left = replace(larger.left, width=width, height=height)
        right = replace(larger.right, width=width, height=height)
        return with_rig(replace(larger, left=left, right=right))

    def apart(times: float) -> Callable[[StereoPair], StereoPair]:
        return with_rig(replace(rig, right_SE3_left=SE3(pose.rotation, times * pose.translation)))

    def shifted(a: AnyArray, b: AnyArray) -> tuple[AnyArray, AnyArray]:
        left, right = aligned(a, b)
        return left, np.roll(right, len(right) // 60, axis=0)

    ideal = rectified_rig(rig)
    inverted = SE3(pose.rotation.T, pose.rotation.T @ pose.translation)
    return [
        Fault(""),
        Fault("left and right are exchanged", lambda a, b: (b, a)),
        Fault("the right images are upside down", lambda a, b: (a, upside_down(b))),
        Fault("the left images are upside down", lambda a, b: (upside_down(a), b)),
        Fault("the images of both cameras are upside down", lambda a, b: (upside_down(a), upside_down(b))),
        Fault("the images of both cameras are mirrored", lambda a, b: (np.fliplr(a), np.fliplr(b))),
        Fault("the images are rectified already", aligned),
        Fault("the images are not rectified yet", sensor=with_rig(ideal)),
        Fault("the images of one camera are shifted up or down", shifted, with_rig(ideal)),
        Fault("the pose of the right camera is inverted", sensor=with_rig(replace(rig, right_SE3_left=inverted))),
        Fault("the calibration is that of images twice the size", sensor=sized(2.0)),
        Fault("the calibration is that of images half the size", sensor=sized(0.5)),
        Fault("the baseline is in millimetres", sensor=apart(1000.0)),
        Fault("the baseline is in centimetres", sensor=apart(100.0)),
        Fault("the baseline is in inches, or in squares of about 25 mm", sensor=apart(40.0)),
        Fault(NOT_SYNCHRONOUS, late=1),
        Fault(NOT_SYNCHRONOUS, late=2),
    ]


def rectified(rig: StereoRig) -> Callable[[AnyArray, AnyArray], tuple[AnyArray, AnyArray]]:
    """Images as OpenCV rectifies them."""
    pose = rig.right_SE3_left
    size = rig.left.size
    (k1, d1), (k2, d2) = ((camera.matrix, camera.coefficients) for camera in (rig.left, rig.right))
    shift = pose.translation.reshape(3, 1)
    r1, r2, p1, p2, *_ = cv2.stereoRectify(k1, d1, k2, d2, size, pose.rotation, shift, alpha=0)
    left = cv2.initUndistortRectifyMap(k1, d1, r1, p1, size, cv2.CV_32FC1)
    right = cv2.initUndistortRectifyMap(k2, d2, r2, p2, size, cv2.CV_32FC1)
    return lambda a, b: (cv2.remap(a, *left, cv2.INTER_LINEAR), cv2.remap(b, *right, cv2.INTER_LINEAR))


def depth_faults(sensor: DepthCamera) -> list[Fault]:
    """Each fault of images with depth under the name that it should get."""
    camera = sensor.depth_camera or sensor.camera
    units = sensor.depth_units.units_per_m
    ray = np.linalg.norm(pixel_rays(camera), axis=2)

    def depth(change: Callable[[AnyArray], AnyArray]) -> Images:
        def images(image: AnyArray, values: AnyArray) -> tuple[AnyArray, AnyArray]:
            changed = change(values)
            return image, np.where(changed < 65535, changed, 0).round().astype(np.uint16)

        return images

    def in_units(per_metre: float) -> Images:
        return depth(lambda values: values * (per_metre / units))

    def inverse(values: AnyArray) -> AnyArray:
        return np.where(values > 0, 2500.0 * units / np.maximum(values, 1), 0)  # disparity in sixty-fourths of a pixel

    faults = [
        Fault("depth is measured along the ray", depth(lambda values: values * ray)),
        Fault("depth is inverse depth or disparity", depth(inverse)),
        Fault("depth is mirrored against its image", depth(np.fliplr)),
        Fault(
            "depth is not registered to its image but offset from it",
            depth(lambda values: np.roll(values, -round(0.04 * values.shape[1]), axis=1)),
        ),
        Fault("the camera hangs upside down", lambda image, values: (upside_down(image), upside_down(values))),
        Fault("depth and its image are not of one time", late=1),
        Fault("depth and its image are not of one time", late=2),
    ]
    for per_metre in (10_000, 5000, 1000, 256, 100):
        if per_metre != units:
            faults.append(Fault(f"depth counts {per_metre} values per metre", in_units(per_metre)))
    return [Fault(""), *faults]


def stored(recording: Recording[Any]) -> Read:
    """Reads frames of a recording by ascending indices, with depth as it is stored, and keeps them for all faults."""
    kept = dict[int, tuple[Decoded, Decoded]]()

    def read(indices: Sequence[int]) -> list[tuple[Decoded, Decoded]]:
        missing = sorted({*indices} - {*kept})
        with KINDS[type(recording.sensor)].raw(recording.sensor):
            kept.update((first.index, (first, second)) for first, second in recording.decode(missing))
        return [kept[index] for index in indices]

    return read


def faulty(recording: Recording[Any], fault: Fault, read: Read) -> Recording[Any]:
    """The recording with the fault in it; ``read`` gives its frames (see ``stored``)."""
    sensor = fault.sensor(recording.sensor) if fault.sensor else recording.sensor
    kind = KINDS[type(sensor)]
    last = recording.n_frames - 1 - fault.late

    def decode(indices: Sequence[int] | None) -> Generator[tuple[Decoded, Decoded], None, None]:
        frames = [i for i in (range(last + 1) if indices is None else indices) if i <= last]
        for (a, now), (_, b) in zip(read(frames), read([i + fault.late for i in frames]), strict=True):
            # The second camera shows at ``now`` what the first shows later.
            first = a.image
            second = b.image
            if first is None or second is None:
                continue
            first, second = fault.images(first, second) if fault.images else (first, second)
            first = np.ascontiguousarray(first)
            second = kind.read(np.ascontiguousarray(second), sensor)
            yield replace(a, image=first), replace(now, image=second)

    return Recording(recording.path, cast(Any, decode), last + 1, recording.clock, [], sensor)


def named(recording: Recording[Any], consecutive: bool) -> str:
    """Name of the doctor's finding in a recording; empty without one."""
    spread = recording.sample(8)
    first = max(0, (recording.n_frames - FRAMES) // 2)
    kind = KINDS[type(recording.sensor)]
    finding = kind.finding(recording, spread)
    if finding or not consecutive:
        return finding.names if finding else ""
    run = recording.at(list(range(first, min(first + FRAMES, recording.n_frames))))
    return kind.late if kind.is_late(recording.sensor, run) else ""


def _depth_finding(recording: Recording[Any], spread: Sequence[Frame[Shot]]) -> Finding | None:
    place = place_of_depth(spread).finding
    offset = place if place and place.hypothesis.remedy == REGISTER else None  # a warning: where there is a floor
    return (None if offset else place) or diagnose(recording) or offset


def _is_pair_late(sensor: StereoPair, run: Sequence[Frame[Shot]]) -> bool:
    watch = MotionWatch()
    rectifier = Rectifier(sensor.rig)
    for pair in (rectifier(*frame.images) for frame in run):
        watch.update(Thumbnails.of_pair(pair.left_grey, pair.right_grey))
    return any(check.name == "synchronisation" and not check.ok for check in watch.checks())


class Kind(NamedTuple):
    """Faults and finding of a kind of recording.

    Attributes:
        faults: of a healthy sensor.
        finding: what the doctor explains in a recording, by frames spread over it.
        late, is_late: the name of a delay between its images, and whether there is one in consecutive frames.
        raw, read: read second images as they are stored meanwhile, and one of them.
    """

    faults: Callable[[Any], list[Fault]]
    finding: Callable[[Recording[Any], Sequence[Frame[Shot]]], Finding | None]
    late: str
    is_late: Callable[[Any, Sequence[Frame[Shot]]], bool]
    raw: Callable[[Any], AbstractContextManager[None]]
    read: Callable[[AnyArray, Any], AnyArray]


KINDS: dict[type, Kind] = {
    StereoPair: Kind(
        lambda sensor: pair_faults(sensor.rig),
        lambda recording, spread: diagnose(recording),
        NOT_SYNCHRONOUS,
        _is_pair_late,
        lambda sensor: nullcontext(),
        lambda image, sensor: image,
    ),
    DepthCamera: Kind(
        depth_faults,
        _depth_finding,
        "depth and its image are not of one time",
        lambda sensor, run: delay_of(run).apart,
        lambda sensor: sensor.depth_units.raw(),
        lambda stored, sensor: sensor.depth_units(stored),
    ),
}
"""By what recorded it, what is done with a recording."""


@benchmark
def doctor(*, recording: Sequence[Path] = (), fault: str = "") -> Report:
    """Make faults in healthy recordings and print which of them are named.

    Example: python -m benchmarks doctor --recording data/synthetic/demo --recording my_depth_recording

    Args:
        recording: A healthy recording of pairs or of images with depth; repeat for more. [default: the demo clip]
        fault: Only faults with this in their name.
    """
    rows = []
    totals = []
    for path in recording or [DEMO]:
        tally = {"right": 0, "wrong": 0, "nothing": 0}
        for row in _named_faults(path, fault):
            rows.append(row)
            tally[row["verdict"]] += 1
        totals.append({"recording": path.name, **tally})
    return tables(faults=rows, recordings=totals)


def _named_faults(path: Path, part: str) -> Iterator[Row]:
    """A row per fault with the part in its name: what is named when it is made in a recording."""
    recording = open_any(path)
    read = stored(recording)
    sensor = recording.sensor
    for fault in KINDS[type(sensor)].faults(sensor):
        if part not in fault.name:
            continue
        shown = fault.name or "as recorded"
        progress(f"{path}: {shown}")
        start = time.process_time()
        got = named(faulty(recording, fault, read), not fault.name or fault.late > 0)
        verdict = "right" if got == fault.name else "wrong" if got else "nothing"
        seconds = time.process_time() - start
        yield {"recording": path.name, "fault": shown, "verdict": verdict, "named": got or "nothing", "cpu_s": seconds}
