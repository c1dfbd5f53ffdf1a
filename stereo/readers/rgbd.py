"""Images with depth: depth files, their rate, the recording they open to, and folders of them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import cv2
import numpy as np

from calib.camera import Camera
from calib.errors import InputError
from calib.formats.rgbd import load_rgbd
from calib.pose import SE3
from calib.rig import DepthSensor, RgbdRig
from calib.types import F32, F64, AnyArray
from stereo.depth import median_image
from stereo.readers.base import (
    DEFAULT_FPS,
    Decoded,
    DecodedDepth,
    OpenOptions,
    PairedFrames,
    Reader,
    Stream,
    both,
    rate_of,
)
from stereo.readers.images import (
    MAX_BYTES,
    ImageFiles,
    Size,
    first_readable,
    folder_of,
    header_size,
    image_files,
    is_image_size,
    read_of_size,
)
from stereo.readers.pairing import depth_note, nearest_mates, pair_files
from stereo.readers.stereo_layout import FrameClock, clock_of, world_pose
from stereo.readers.times import stamps_in_names
from stereo.recording import RgbdFrame

UNITS_PER_M = 1000.0
"""Depth values per metre of files that do not say: sensors and their tools write millimetres."""
RANGE_M = 30.0
"""No depth sensor for rooms measures farther [m]; such values mark what is unknown (65535, for one)."""


class DepthFiles:
    """Depth images as files of one channel; None stands for a file that is missing.

    Whole numbers count ``units_per_m`` to the metre, with 0 for unknown; floating-point numbers are metres.

    Attributes:
        size: (width, height) [px].
        n_frames: files.
    Raises:
        InputError: no file of the list can be decoded as depth.
    """

    def __init__(self, files: Sequence[Path | None], units_per_m: float = UNITS_PER_M) -> None:
        self._files = tuple(files)
        self._units_per_m = units_per_m
        self.n_frames = len(self._files)
        first = first_readable(self._files, read_depth)
        if first is None:
            folder = folder_of(self._files)
            raise InputError(f"{folder}: expected depth images (one channel of 16 bits), found none of {self.n_frames}")
        self.size = first.shape[1], first.shape[0]

    def __iter__(self) -> Iterator[DecodedDepth]:
        return self.at(range(self.n_frames))

    def at(self, indices: Iterable[int]) -> Iterator[DecodedDepth]:
        """Only these frames."""
        for index in indices:
            stored, why = read_of_size(self._files[index], read_depth, self.size)
            yield DecodedDepth(index, None, None if stored is None else metres(stored, self._units_per_m), why)

    def scaled(self, units_per_m: float) -> DepthFiles:
        """The same files with another scale."""
        return DepthFiles(self._files, units_per_m)


def metres(stored: AnyArray, units_per_m: float) -> F32:
    """(H, W) float32 [m] of depth as stored, NaN where unknown: 0, negative, not finite or out of any range."""
    whole = np.issubdtype(stored.dtype, np.integer)
    depth = stored.astype(np.float32) * np.float32(1.0 / units_per_m if whole else 1.0)
    with np.errstate(invalid="ignore"):
        return np.where((depth > 0) & (depth < RANGE_M), depth, np.float32(np.nan))


def read_depth(file: Path) -> AnyArray | None:
    """(H, W) uint16 or float32 as stored; None when it cannot be decoded or holds anything else."""
    try:
        return decode_depth(file.read_bytes()) if file.stat().st_size <= MAX_BYTES else None
    except OSError:
        return None


def decode_depth(data: bytes) -> AnyArray | None:
    """(H, W) uint16 or float32 of an encoded depth image; None when it cannot be decoded or holds anything else."""
    if not is_image_size(header_size(data)):
        return None
    try:
        stored = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
    if stored is None or stored.ndim != 2 or stored.dtype not in (np.uint16, np.float32):
        return None
    return np.asarray(stored)


WALKING_MPS = 1.3
"""Comfortable walking speed of adults (Bohannon 1997, Age and Ageing 26: 1.27 to 1.46 m/s), less a little indoors."""
PAIRS = 24
"""Places in the recording at which two consecutive frames are compared (our choice)."""
MIN_PAIRS = 4
"""With movement in fewer of them nothing is said (our choice)."""
STEP_PX = 8
"""Every n-th row and column is looked at."""
NEARER_M = 0.3
"""What stands this far in front of the background is a person or a thing that was moved (our choice)."""
BODY_M2 = (0.1, 1.5)
"""Surface that a person shows [m^2]."""
STEP_M = (0.03, 1.5)
"""Steps between frames: shorter ones are noise and people who stand, longer ones are not of one person [m]."""


def rate_by_movement(at: Callable[[Sequence[int]], list[RgbdFrame]], n_frames: int, camera: Camera) -> float | None:
    """Frames per second at which what moves is as fast as a walker.

    Args:
        at: decodes frames of these ascending indices.
        camera: of the images.
    Returns:
        None where too little moves.
    """
    firsts = np.unique(np.linspace(0, max(0, n_frames - 2), PAIRS).astype(int))
    indices = np.unique(np.concatenate([firsts, firsts + 1]))
    depths = {f.index: f.depth_m[::STEP_PX, ::STEP_PX] for f in at([int(i) for i in indices if i < n_frames])}
    if len(depths) < MIN_PAIRS:
        return None
    background = median_image(list(depths.values()))
    # (h, w, 3) rays at unit depth of the pixels looked at.
    columns, rows = np.meshgrid(np.arange(0, camera.width, STEP_PX), np.arange(0, camera.height, STEP_PX))
    rays = camera.unproject(np.column_stack([columns.ravel(), rows.ravel()])).reshape(*columns.shape, 3)
    places = {index: _place(depth, background, rays, camera) for index, depth in depths.items()}
    steps = np.array([_step(places.get(int(i)), places.get(int(i) + 1)) for i in firsts])
    steps = steps[(steps > STEP_M[0]) & (steps < STEP_M[1])]
    return float(WALKING_MPS / np.median(steps)) if len(steps) >= MIN_PAIRS else None


def _place(depth: F32, background: F32, rays: F64, camera: Camera) -> F64 | None:
    """Middle [m] of the largest thing in front of the background; None without one of a person's size."""
    with np.errstate(invalid="ignore"):
        nearer = (background - depth > NEARER_M).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(nearer)
    if count < 2:
        return None
    of_it = labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    area = depth[of_it] ** 2 * (STEP_PX**2 / (camera.fx * camera.fy))
    if not BODY_M2[0] <= float(area.sum()) <= BODY_M2[1]:
        return None
    return np.asarray(np.median(rays[of_it] * depth[of_it][:, None], axis=0), dtype=np.float64)


def _step(one: F64 | None, other: F64 | None) -> float:
    return float("nan") if one is None or other is None else float(np.linalg.norm(other - one))


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
        from stereo.rgbd import DepthRegistration  # its kernels: only depth in a camera of its own needs numba

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
            # Give frames without times the rate at which people walk, where that is clearly less than usual.
            rate = rate_by_movement(recording.at, recording.n_frames, recording.camera)
            slow = rate is not None and rate < SLOW * DEFAULT_FPS
            recording.fps = round(rate, 1) if slow and rate else DEFAULT_FPS
            why = ", at which what moves is as fast as a walker" if slow else ""
            recording.notes.append(
                f"no timestamps: {recording.fps:g} frames per second are assumed{why} (--fps gives another rate)"
            )
        return recording


def resized(rig: RgbdRig, depth_size: Size) -> RgbdRig:
    """A registered rig whose depth has another resolution than its images: a depth camera of the same view."""
    return RgbdRig(
        rig.camera, rig.camera.scaled(*depth_size), units_per_m=rig.units_per_m, sensor=rig.sensor, source=rig.source
    )


_COLOUR = re.compile(r"(?<![a-z])(rgb|colou?r|image|images|img|left)(?![a-z])|^(rgb|colou?r)", re.IGNORECASE)
_DEPTH = re.compile(r"depth", re.IGNORECASE)


def rgbd_pairs(
    images: ImageFiles, depths: DepthFiles, units_per_m: float | None, indices: Sequence[int] | None
) -> Generator[tuple[Decoded, DecodedDepth], None, None]:
    """Decodes images and their depth.

    Args:
        units_per_m: depth values per metre; those of ``depths`` when None.
        indices: of the frames, ascending; None for all.
    """
    return both(images, depths if units_per_m is None else depths.scaled(units_per_m), indices)


def _sides(path: Path) -> tuple[list[Path], list[Path]] | None:
    """Images and depth at a path: in two folders, or side by side in one, told apart by their names."""
    if not path.is_dir():
        return None
    folders = [f for f in path.iterdir() if f.is_dir()]
    colour = [f for f in folders if _COLOUR.search(f.name) and not _DEPTH.search(f.name)]
    depth = [f for f in folders if _DEPTH.search(f.name)]
    if len(colour) == 1 and len(depth) == 1:
        return image_files(colour[0]), image_files(depth[0])
    files = image_files(path)
    of_depth = [f for f in files if _DEPTH.search(f.stem)]
    of_colour = [f for f in files if not _DEPTH.search(f.stem)]
    return (of_colour, of_depth) if of_colour and of_depth else None


def _fits(path: Path) -> bool:
    sides = _sides(path)
    return sides is not None and all(sides) and read_depth(sides[1][0]) is not None


def _find(path: Path, options: OpenOptions) -> RgbdLayout:
    sides = _sides(path)
    if sides is None:
        raise InputError(f"{path}: expected images and depth, found neither")
    timed = None if (path / "timestamps.csv").is_file() else _timed(*sides)
    pairs = timed.pairs if timed else pair_files(*sides)
    clock = clock_of(path, options, math.nan) if timed is None or options.fps is not None else timed.clock
    images, depths = ImageFiles([pair[0] for pair in pairs]), DepthFiles([pair[1] for pair in pairs])
    return RgbdLayout(
        path, path, partial(rgbd_pairs, images, depths),
        (Stream("image", images.size, len(sides[0]), clock.times_s),
         Stream("depth", depths.size, len(sides[1]), clock.times_s)),
        len(pairs), clock.fps, clock.times_s, partial(load_rgbd, options.calibration or path, images.size, depths.size),
        clock.notes, clock.even, assumed=() if clock.times_s is not None else clock.notes,
    )  # fmt: skip


class _Timed(NamedTuple):
    """Images with the depth of their times."""

    pairs: list[tuple[Path | None, Path | None]]
    clock: FrameClock


def _timed(images: list[Path], depths: list[Path]) -> _Timed | None:
    """Pairs by the times that the names of the files hold; None where they number the frames."""
    stamps = stamps_in_names([file.stem for file in images]), stamps_in_names([file.stem for file in depths])
    if stamps[0] is None or stamps[1] is None:
        return None
    order, depth_order = np.argsort(stamps[0].ns), np.argsort(stamps[1].ns)
    ns, depth_ns = stamps[0].ns[order], stamps[1].ns[depth_order]
    mates = nearest_mates(ns, depth_ns)
    if not (mates >= 0).any():
        return None
    times = np.asarray((ns - ns[0]) / 1e9, dtype=np.float64)
    pairs: list[tuple[Path | None, Path | None]] = [
        (images[i], depths[depth_order[mate]] if mate >= 0 else None) for i, mate in zip(order, mates, strict=True)
    ]
    return _Timed(pairs, FrameClock(rate_of(times), times, tuple(depth_note(mates))))


READER = Reader("rgbd", "images with depth", "rgb/ (or color/) and depth/ with images of 16 bits", _fits, _find)
