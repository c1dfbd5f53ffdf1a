"""Images with depth that a reader found, their calibration, and the recording they open to."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from calib.pose import SE3
from calib.rgbd import DepthSensor, RgbdRig
from calib.types import F64
from stereo.pace import rate_by_movement
from stereo.readers.paired import DEFAULT_FPS, PairedFrames
from stereo.readers.reader import Stream
from stereo.readers.source import Decoded, DecodedDepth
from stereo.readers.stereo_layout import world_pose
from stereo.recording import RgbdFrame

Size = tuple[int, int]
RgbdPairs = Callable[[Sequence[int] | None], Generator[tuple[Decoded, DecodedDepth], None, None]]
"""Decodes images and their depth of these ascending indices, or all."""

SENSOR_OF_SIZE: dict[Size, DepthSensor] = {
    (512, 424): "time-of-flight",  # Kinect 2
    (640, 576): "time-of-flight",  # Azure Kinect, narrow and wide, binned or not
    (320, 288): "time-of-flight",
    (512, 512): "time-of-flight",
    (1024, 1024): "time-of-flight",
    (1024, 768): "time-of-flight",  # RealSense L515
    (848, 480): "stereo",  # RealSense D400
    (1280, 720): "stereo",
    (480, 270): "stereo",
    (1280, 800): "stereo",  # OAK-D
    (640, 400): "stereo",
}
"""Sizes of depth images that only one kind of sensor has; all others count as structured light, 640x480 and 320x240
being those of Kinect, Xtion and Astra."""


SLOW = 0.6
"""Images without times are assumed to come at the usual rate unless people then would move faster than a fast walker of
2.2 m/s (our choice)."""


class RgbdImages(PairedFrames[RgbdFrame, DecodedDepth]):
    """Images with depth in their own pixels (an ``RgbdRecording``).

    Attributes:
        camera, source, sensor, world_SE3_camera: see ``RgbdRecording``.
    """

    sides = ("image", "depth")

    def __init__(
        self,
        path: Path,
        rig: RgbdRig,
        sensor: DepthSensor,
        pairs: RgbdPairs,
        n_frames: int,
        fps: float,
        times_s: F64 | None,
        world_SE3_camera: SE3 | None,
    ) -> None:
        super().__init__(path, pairs, n_frames, fps, times_s)
        self.camera, self.source, self.sensor = rig.camera, rig.source, sensor
        self.world_SE3_camera = world_SE3_camera
        from stereo.registration import DepthRegistration  # its kernels: only depth in a camera of its own needs numba

        self._register = DepthRegistration(rig)

    def _joined(self, first: Decoded, second: DecodedDepth, timestamp_s: float) -> RgbdFrame | None:
        if first.image is None or second.depth_m is None:
            return None
        return RgbdFrame(first.index, timestamp_s, first.image, self._register(second.depth_m))


@dataclass(frozen=True, eq=False)
class RgbdLayout:
    """Images and depth whose frames are paired (a ``Layout``).

    Attributes:
        path: as given.
        folder: where world.toml lies.
        pairs: decodes images and their depth, given the depth values per metre of the calibration (None: not given).
        times_s: (n,) float64 [s] by frame index, NaN where unknown; None takes the times of the decoded images.
        rig: reads the calibration; raises InputError.
        unpaired: images without depth.
        assumed: those of the notes that ``open`` gives anew, once it has estimated the rate of images without times.
    """

    path: Path
    folder: Path
    pairs: Callable[[float | None, Sequence[int] | None], Generator[tuple[Decoded, DecodedDepth], None, None]]
    streams: tuple[Stream, Stream]
    n_frames: int
    fps: float
    times_s: F64 | None
    rig: Callable[[], RgbdRig]
    notes: tuple[str, ...] = ()
    even: bool = False
    unpaired: int = 0
    assumed: tuple[str, ...] = ()
    kind: Literal["rgbd"] = "rgbd"

    def open(self) -> RgbdImages:
        """See ``Layout``."""
        rig = self.rig()
        image, depth = (stream.size for stream in self.streams)
        notes = [note for note in self.notes if note not in self.assumed]
        if rig.depth_camera is None and image != depth:
            notes.append(f"depth of {depth[0]}x{depth[1]} without a calibration of its own counts as registered")
            rig = resized(rig, depth)
        sensor = rig.sensor or SENSOR_OF_SIZE.get(depth, "structured-light")
        recording = RgbdImages(
            self.path, rig, sensor, partial(self.pairs, rig.units_per_m), self.n_frames, self.fps, self.times_s,
            world_pose(self.folder),
        )  # fmt: skip
        recording.notes, recording.even = notes, self.even
        if self.times_s is None and not self.even:
            _pace(recording)
        return recording


def _pace(recording: RgbdImages) -> None:
    """Give frames without times the rate at which people walk, where that is clearly less than usual."""
    rate = rate_by_movement(recording.at, recording.n_frames, recording.camera)
    slow = rate is not None and rate < SLOW * DEFAULT_FPS
    recording.fps = round(rate, 1) if slow and rate else DEFAULT_FPS
    why = ", at which what moves is as fast as a walker" if slow else ""
    recording.notes.append(
        f"no timestamps: {recording.fps:g} frames per second are assumed{why} (--fps gives another rate)"
    )


def resized(rig: RgbdRig, depth_size: Size) -> RgbdRig:
    """A registered rig whose depth has another resolution than its images: a depth camera of the same view."""
    return RgbdRig(
        rig.camera, rig.camera.scaled(*depth_size), units_per_m=rig.units_per_m, sensor=rig.sensor, source=rig.source
    )
