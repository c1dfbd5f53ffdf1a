"""Plan-view recordings: the foreground points of every frame in one HDF5 file, without images.

Height and occupancy maps are functions of the points (Harville 2002, section 3), and a point of its pixel and
disparity, so that these two are stored, without loss, and the maps are built anew by the code that built them first.
A point's appearance is its colour code (``planview.maps.colour``).

Layout: attributes ``format``, ``version``, ``config`` (JSON), ``fps``; groups ``rig``, ``floor`` and ``grid`` with
attributes named as in the classes they hold; per frame ``frames/index``, ``frames/timestamp_s``, ``frames/end`` (where
its points end) and ``frames/unmatched_end``; per point ``points/pixel``, ``points/disparity`` and, optionally,
``points/appearance``; per pixel of foreground without depth ``unmatched/pixel``; per background ``background/frame``
(from which on) and ``background/disparity``; ``skipped/index`` and ``skipped/why``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import InputError
from calib.pose import SE3
from calib.rig import Floor
from calib.types import F32, I32, U8, AnyArray
from planview.maps.builder import FloorPoints
from planview.maps.colour import CODES
from planview.maps.grid import Grid
from planview.maps.pixels import NO_DEPTH, SeenPixels
from planview.maps.view import StereoView
from stereo.depth import RectifiedGeometry
from stereo.matcher import DisparityRange
from stereo.recording import Skipped

FORMAT = "planview maps"
VERSION = 2
"""Changes when an older reader would misunderstand the file; 1 has neither unmatched pixels nor backgrounds."""
BLOCK_FRAMES = 32
"""Frames written and read at a time."""
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""First bytes of an HDF5 file (format specification, superblock)."""
FRAME_COLUMNS: dict[str, type] = {"index": np.int64, "timestamp_s": np.float64, "end": np.int64}
POINT_COLUMNS: dict[str, type] = {"pixel": np.int32, "disparity": np.float32}


@dataclass(frozen=True, eq=False)
class MapsFrame:
    """The foreground points of one frame.

    Attributes:
        index, timestamp_s: as in the recording.
        pixels: (N,) int32, row * width + column at the size of foreground and maps, ascending.
        disparities: (N,) float32 [px of the rectified image].
        colours: (N,) uint8 colour codes; None when not recorded.
        unmatched: (K,) int32 pixels of foreground without depth, ascending; None when not recorded.
        background: (H, W) float32 [px], the background's disparity where it is another from this frame on; else None.
    """

    index: int
    timestamp_s: float
    pixels: I32
    disparities: F32
    colours: U8 | None = None
    unmatched: I32 | None = None
    background: F32 | None = None

    @staticmethod
    def of(index: int, timestamp_s: float, points: FloorPoints, disparity: F32, seen: SeenPixels) -> MapsFrame:
        """The points of a frame, with their values in its (H, W) disparity at the size of foreground and maps."""
        unmatched = np.flatnonzero(seen.kind.reshape(-1) == NO_DEPTH).astype(np.int32)
        values = disparity.reshape(-1)[points.pixels]
        return MapsFrame(index, timestamp_s, points.pixels, values, points.colours, unmatched, seen.renewed)


class MapsRecording:
    """A plan-view recording: iterate it for its ``MapsFrame``.

    Attributes:
        path: the file.
        view: the rig, its floor and the grid of the maps.
        config: JSON of the configuration that made the points.
        n_frames, fps, skipped: see ``stereo.recording.Recording``.
    """

    def __init__(self, path: Path) -> None:
        """Read all but the points.

        Raises:
            InputError: no such file, not a plan-view recording, cut short, damaged, or of another version.
        """
        import h5py  # a tenth of a second, and only these files need it

        self.path = path
        with _reading(path), h5py.File(path, "r") as file:
            _check_version(path, file)
            self.view = _read_view(file)
            self.config = str(file.attrs["config"])
            self.fps = float(file.attrs["fps"])
            self._indices, self._times, self._ends = (_values(file, f"frames/{name}") for name in FRAME_COLUMNS)
            why = file["skipped/why"].asstr()[:]
            self.skipped = [Skipped(int(i), str(w)) for i, w in zip(file["skipped/index"][:], why, strict=True)]
            self._unmatched_ends = _values(file, "frames/unmatched_end") if "unmatched" in file else None
            self._renewed = _values(file, "background/frame") if "background" in file else np.zeros(0, np.int64)
            self._check_lengths(file)
        self.n_frames = len(self._indices)

    def __iter__(self) -> Iterator[MapsFrame]:
        """Every frame in order.

        Raises:
            InputError: points that are damaged or outside the image.
        """
        import h5py

        with _reading(self.path), h5py.File(self.path, "r") as file:
            for first in range(0, self.n_frames, BLOCK_FRAMES):
                yield from self._block(file, first, min(first + BLOCK_FRAMES, self.n_frames))

    def _block(self, file: Any, first: int, last: int) -> Iterator[MapsFrame]:
        points = file["points"]
        start, end = int(self._ends[first - 1]) if first else 0, int(self._ends[last - 1])
        pixels, disparities = points["pixel"][start:end], points["disparity"][start:end]
        colours = points["appearance"][start:end] if "appearance" in points else None
        height, width = self.view.shape
        if len(pixels) and not (pixels.min() >= 0 and pixels.max() < height * width):
            raise InputError(f"{self.path}: expected points inside {width}x{height} pixels, found them outside")
        cuts = (self._ends[first : last - 1] - start).astype(int)
        parts = [np.split(column, cuts) for column in (pixels, disparities)]
        codes = np.split(colours, cuts) if colours is not None else [None] * (last - first)
        unmatched = self._unmatched(file, first, last)
        for i in range(last - first):
            index, time = int(self._indices[first + i]), float(self._times[first + i])
            yield MapsFrame(
                index, time, parts[0][i], parts[1][i], codes[i], unmatched[i], self._background(file, index)
            )

    def _unmatched(self, file: Any, first: int, last: int) -> list[I32] | list[None]:
        if self._unmatched_ends is None:
            return [None] * (last - first)
        ends = self._unmatched_ends
        start, end = int(ends[first - 1]) if first else 0, int(ends[last - 1])
        pixels = file["unmatched/pixel"][start:end]
        height, width = self.view.shape
        if len(pixels) and not (pixels.min() >= 0 and pixels.max() < height * width):
            raise InputError(f"{self.path}: expected pixels inside {width}x{height}, found them outside")
        return list(np.split(pixels, (ends[first : last - 1] - start).astype(int)))

    def _background(self, file: Any, index: int) -> F32 | None:
        found = np.flatnonzero(self._renewed == index)
        if not len(found):
            return None
        return np.asarray(file["background/disparity"][int(found[0])], dtype=np.float32).reshape(self.view.shape)

    def _check_lengths(self, file: Any) -> None:
        n = len(self._indices)
        if not n == len(self._times) == len(self._ends):
            raise ValueError("columns of frames that differ in length")
        n_points = int(self._ends[-1]) if n else 0
        if (np.diff(self._indices) <= 0).any() or (np.diff(self._ends, prepend=0) < 0).any():
            raise ValueError("frames out of order")
        if self._unmatched_ends is not None:
            n_unmatched = int(self._unmatched_ends[-1]) if n else 0
            rising = (np.diff(self._unmatched_ends, prepend=0) >= 0).all()
            if len(self._unmatched_ends) != n or not rising or len(file["unmatched/pixel"]) != n_unmatched:
                raise ValueError("pixels without depth that do not fit the frames")
        shape = (len(self._renewed), self.view.shape[0] * self.view.shape[1])
        if "background" in file and file["background/disparity"].shape != shape:
            raise ValueError("backgrounds of another size")
        lengths = {name: len(column) for name, column in file["points"].items()}
        if set(POINT_COLUMNS) - lengths.keys() or set(lengths.values()) != {n_points}:
            raise ValueError(f"columns of points of lengths {lengths} where frames end with {n_points}")


def is_maps(path: Path) -> bool:
    """Whether a path is a file of HDF5, by its name or its first bytes."""
    if not path.is_file():
        return False
    if path.suffix in (".h5", ".hdf5"):
        return True
    with path.open("rb") as file:
        return file.read(len(_SIGNATURE)) == _SIGNATURE


def _check_version(path: Path, file: Any) -> None:
    if file.attrs.get("format") != FORMAT:
        raise ValueError("another HDF5 file")
    if file.attrs["version"] not in range(1, VERSION + 1):
        raise InputError(f"{path}: expected plan-view maps of version 1 to {VERSION}, found {file.attrs['version']}")
    if "points/appearance" in file and file["points/appearance"].attrs["codes"] != CODES:
        found = file["points/appearance"].attrs["codes"]
        raise InputError(f"{path}: expected colours in {CODES} codes, found {found}: another version wrote them")


def _read_view(file: Any) -> StereoView:
    rig, floor = dict(file["rig"].attrs), dict(file["floor"].attrs)
    extent = tuple(float(v) for v in floor["extent_m"]) if "extent_m" in floor else None
    return StereoView(
        geometry=RectifiedGeometry(**_typed(rig, RectifiedGeometry)),
        floor=Floor(
            SE3.from_matrix(floor["world_SE3_left"]), float(floor["inlier_fraction"]), float(floor["residual_m"]),
            extent_m=extent,  # type: ignore[arg-type]
        ),
        floor_source=str(floor["source"]),
        calibration=str(rig["calibration"]),
        vertical_residual_px=float(rig["vertical_residual_px"]),
        disparities=DisparityRange(**_typed(rig, DisparityRange)),
        grid=Grid(**_typed(dict(file["grid"].attrs), Grid)),
        reduction=int(rig["reduction"]),
        sensor=rig.get("sensor"),
    )  # fmt: skip


def _typed(attributes: dict[str, Any], kind: Any) -> dict[str, Any]:
    """The fields of a dataclass among attributes, as Python's own numbers; an older file has none for newer fields."""
    missing = {f.name for f in fields(kind) if f.default is not MISSING} - attributes.keys()
    return {f.name: attributes[f.name].item() for f in fields(kind) if f.name not in missing}


def _values(file: Any, name: str) -> AnyArray:
    return np.asarray(file[name][:])


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, KeyError, ValueError, TypeError, AttributeError, RuntimeError) as error:
        text = " ".join(str(error).split())
        raise InputError(f"{path}: expected plan-view maps (planview run --maps), found {text}") from error
