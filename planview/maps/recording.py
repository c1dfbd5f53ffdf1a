"""Plan-view recordings: the foreground points of every frame in one HDF5 file, without images.

Height and occupancy maps are functions of the points (Harville 2002, section 3), and a point of its pixel and
disparity, so that these two are stored, without loss, and the maps are built again by the code that built them first.
A point's appearance is its colour code (``planview.maps.view``).

Layout: attributes ``format``, ``version``, ``config`` (JSON), ``fps``; groups ``rig``, ``floor`` and ``grid`` with
attributes named as in the classes they hold; per frame ``frames/index``, ``frames/timestamp_s``, ``frames/end`` (where
its points end) and ``frames/unmatched_end``; per point ``points/pixel``, ``points/disparity`` and, optionally,
``points/appearance``; per pixel of foreground without depth ``unmatched/pixel``; per background ``background/frame``
(from which on) and ``background/disparity``; ``skipped/index`` and ``skipped/why``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

from calib.errors import InputError, WorkError
from calib.io import reason, refuse_full_disk
from calib.pose import SE3
from calib.rig import DepthTechnology, Floor
from calib.types import F32, I32, U8, AnyArray
from calib.world import MAX_AWAY_M, refuse_strange_pose
from planview.maps.grid import MAX_CELLS, FloorRig, Grid
from planview.maps.view import CODES, NO_DEPTH, View
from planview.trajectories.hdf5 import SIGNATURE, open_hdf5
from stereo.depth import RectifiedGeometry
from stereo.matcher import DisparityRange
from stereo.readers.base import Layout, Reader
from stereo.recording import Frame, FrameClock, OpenOptions, Skipped

FORMAT = "planview maps"
VERSION = 2
"""Version of the layout; a file of another one is refused."""
BLOCK_FRAMES = 32
"""Frames written and read at a time."""
RANGES: dict[str, tuple[float, float]] = {
    "width": (1, 20_000), "height": (1, 20_000), "reduction": (1, 64), "first_px": (0, 20_000), "count": (1, 20_000),
    "focal_u_px": (1.0, 1e6), "focal_v_px": (1.0, 1e6), "cu_px": (-1e5, 1e5), "cv_px": (-1e5, 1e5),
    "baseline_m": (1e-4, 100.0), "disparity_std_px": (1e-4, 100.0), "depth_std_min_m": (0.0, 10.0),
    "x_min_m": (-MAX_AWAY_M, MAX_AWAY_M), "y_min_m": (-MAX_AWAY_M, MAX_AWAY_M), "cell_m": (1e-3, 1.0),
    "n_rows": (1, MAX_CELLS), "n_cols": (1, MAX_CELLS),
}  # fmt: skip
"""Ranges of the numbers of a rig, its floor and its grid (our choice: wider than any camera)."""
APPEARANCE = "points/appearance"
COLUMNS: dict[str, type] = {
    "frames/index": np.int64, "frames/timestamp_s": np.float64, "frames/end": np.int64,
    "frames/unmatched_end": np.int64, "points/pixel": np.int32, "points/disparity": np.float32,
    "unmatched/pixel": np.int32, "background/frame": np.int64,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class RecordedPoints:
    """The foreground points of one frame: the shot of a sensor whose views were recorded.

    Attributes:
        pixels: (N,) int32, row * width + column at the size of foreground and maps, ascending.
        disparities: (N,) float32 [px of the rectified image].
        colours: (N,) uint8 colour codes; None when not recorded.
        unmatched: (K,) int32 pixels of foreground without depth, ascending; all where the frame shows nothing.
        background: (H, W) float32 [px], the background's disparity where it is another from this frame on; else None.
    """

    pixels: I32
    disparities: F32
    colours: U8 | None
    unmatched: I32
    background: F32 | None = None

    @staticmethod
    def of(view: View) -> RecordedPoints:
        """The points of a view. Raises InputError: it was recorded itself, or is of one camera without depth."""
        if view.depth is None:
            raise InputError("expected a stereo pair or images with depth to record the points of, found no disparity")
        unmatched = np.flatnonzero(view.kind.reshape(-1) >= NO_DEPTH).astype(np.int32)
        pixels = view.points.pixels
        values = view.depth.disparity.reshape(-1)[pixels]
        return RecordedPoints(pixels, values, view.points.colours, unmatched, view.renewed)


class RecordedViews(NamedTuple):
    """Everything that the points of a recording need to become views again: the rig above its floor, with the grid of
    the maps, and JSON of the configuration that made them."""

    rig: FloorRig
    config: str


class MapsRecording:
    """A plan-view recording: iterate it for frames of ``RecordedPoints``.

    Attributes:
        path: the file.
        sensor: the rig, its floor, the grid of the maps and the configuration.
        n_frames, fps, files, skipped, notes, options: see ``stereo.recording.Recording``.
    """

    name = ""
    is_live = False
    identity = ()

    def __init__(self, path: Path) -> None:
        """Read all but the points. Raises InputError: no such file, not a plan-view recording, cut short, damaged, or
        of another version."""
        self.path = path
        self.files = (path,)
        with _reading(path), open_hdf5(path) as file:
            _check_version(path, file)
            self.sensor: RecordedViews = RecordedViews(_read_rig(file), str(file.attrs["config"]))
            self.fps = _number(file.attrs["fps"], "fps", 1e-3, 1e4)
            self._indices, self._times, self._ends, self._unmatched_ends, self._renewed = (
                _column(file, name, kind) for name, kind in COLUMNS.items() if name.startswith(("frames", "background"))
            )
            skipped = _column(file, "skipped/index", np.int64)
            why = file["skipped/why"].asstr()[: len(self._indices)]
            self.skipped = [Skipped(int(i), str(w)) for i, w in zip(skipped, why, strict=True)]
            self._check_tables(file)
        self.n_frames = len(self._indices)
        self.notes: list[str] = []
        self.options = OpenOptions()

    @property
    def parts(self) -> tuple[MapsRecording, ...]:
        """A recording of each sensor: itself."""
        return (self,)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self.path)!r}, {self.n_frames} frames, {self.fps:.4g} per second)"

    def __iter__(self) -> Iterator[Frame[RecordedPoints]]:
        """Every frame in order. Raises InputError: points that are damaged or outside the image."""
        with _reading(self.path), open_hdf5(self.path) as file:
            for first in range(0, self.n_frames, BLOCK_FRAMES):
                last = min(first + BLOCK_FRAMES, self.n_frames)
                parts = {name: _split(file[name], ends, first, last) for name, ends in self._ends_of(file).items()}
                for n in range(first, last):
                    yield self._frame(file, n, {name: own[n - first] for name, own in parts.items()})

    def _ends_of(self, file: Any) -> dict[str, AnyArray]:
        """By name of a column of points, where each frame's end."""
        points = ["points/pixel", "points/disparity", *([APPEARANCE] if APPEARANCE in file else [])]
        return dict.fromkeys(points, self._ends) | {"unmatched/pixel": self._unmatched_ends}

    def _frame(self, file: Any, n: int, own: dict[str, AnyArray]) -> Frame[RecordedPoints]:
        """The n-th frame with its points."""
        index, (height, width), background = int(self._indices[n]), self.sensor.rig.shape, None
        pixels, disparities, unmatched = (own[name] for name in ("points/pixel", "points/disparity", "unmatched/pixel"))
        codes = own.get(APPEARANCE)
        wrong = ""
        if not all(_ascend(each, height * width) for each in (pixels, unmatched)):
            wrong = f"pixels in order inside {width}x{height}"
        elif not (np.isfinite(disparities).all() and (disparities > 0).all()):
            wrong = "disparities of points"
        elif codes is not None and (codes >= CODES).any():
            wrong = f"colour codes below {CODES}"
        if wrong:
            raise InputError(f"{self.path}: frame {index}: expected {wrong}, found others")
        for row in np.flatnonzero(self._renewed == index)[:1].tolist():
            background = np.asarray(file["background/disparity"][row], np.float32).reshape(self.sensor.rig.shape)
        points = RecordedPoints(pixels, disparities, codes, unmatched, background)
        return Frame(index, float(self._times[n]), (points,))

    def _check_tables(self, file: Any) -> None:
        """Columns fit the frames, and hold what the kernels may be given."""
        n = len(self._indices)
        pixels = math.prod(self.sensor.rig.shape)
        if not n == len(self._times) == len(self._ends):
            raise ValueError("columns of frames that differ in length")
        if (np.diff(self._indices, prepend=-1) <= 0).any():
            raise ValueError("frames out of order")
        # Three years: readers take longer steps for a clock that was set.
        if not ((np.abs(self._times) <= 1e8).all() and (np.diff(self._times) > 0).all()):
            raise ValueError("times that do not increase")
        for name, ends in self._ends_of(file).items():
            steps = np.diff(ends, prepend=0)
            last = int(ends[-1]) if len(ends) else 0
            if len(ends) != n or (steps < 0).any() or (steps > pixels).any():
                raise ValueError(f"{name} that does not fit the frames")
            if file[name].dtype != COLUMNS.get(name, np.uint8) or file[name].shape != (last,):
                raise ValueError(f"{name} of {file[name].shape} {file[name].dtype} where frames end with {last}")
        background = file["background/disparity"]
        if background.dtype != np.float32 or background.shape != (len(self._renewed), pixels):
            raise ValueError("backgrounds of another size")


def _split(column: Any, ends: AnyArray, first: int, last: int) -> list[AnyArray]:
    """The values of each of some frames, which end at ``ends``."""
    start = int(ends[first - 1]) if first else 0
    return np.split(column[start : int(ends[last - 1])], (ends[first : last - 1] - start).astype(int))


def _ascend(pixels: AnyArray, below: int) -> bool:
    return not len(pixels) or bool(pixels[0] >= 0 and pixels[-1] < below and (np.diff(pixels) > 0).all())


def _is_hdf5(path: Path) -> bool:
    """True if a path is a file of HDF5, by its name or its first bytes."""
    if not path.is_file():
        return False
    if path.suffix in (".h5", ".hdf5"):
        return True
    with path.open("rb") as file:
        return file.read(len(SIGNATURE)) == SIGNATURE


def _find_maps(path: Path, options: OpenOptions) -> Layout:
    if options.calibration is not None:
        raise InputError(f"{options.calibration}: expected no calibration for {path}, which has its own")
    recording = MapsRecording(path)
    return Layout("maps", (), recording.n_frames, FrameClock(recording.fps), (), 0, lambda: recording)


MAPS = Reader("maps", "plan-view maps", _is_hdf5, _find_maps, lambda path: MapsRecording(path).sensor.config)


def _check_version(path: Path, file: Any) -> None:
    if file.attrs.get("format") != FORMAT:
        raise ValueError("another HDF5 file")
    if file.attrs["version"] != VERSION:
        raise InputError(
            f"{path}: expected plan-view maps of version {VERSION}, found version {file.attrs['version']}: "
            "track the recording again with this version of planview"
        )
    if APPEARANCE in file and (found := file[APPEARANCE].attrs["codes"]) != CODES:
        raise InputError(f"{path}: expected colours in {CODES} codes, found {found}: another version wrote them")


def _read_rig(file: Any) -> FloorRig:
    rig = dict(file["rig"].attrs)
    floor = dict(file["floor"].attrs)
    pose = SE3.from_matrix(floor["world_SE3_left"])
    refuse_strange_pose(pose)
    extent = tuple(_number(v, "extent_m", -np.inf, np.inf) for v in floor.get("extent_m", ()))
    technology = rig.get("sensor")
    if technology not in (None, *get_args(DepthTechnology)):
        raise ValueError(f"a sensor {technology!r:.40}")
    return FloorRig(
        geometry=RectifiedGeometry(**_fields(rig, RectifiedGeometry)),
        floor=Floor(
            pose, float(floor["inlier_fraction"]), float(floor["residual_m"]),
            extent_m=(extent[0], extent[1], extent[2], extent[3]) if extent else None,
        ),
        floor_source=str(floor["source"]),
        calibration=str(rig["calibration"]),
        vertical_residual_px=float(rig["vertical_residual_px"]),
        disparities=DisparityRange(**_fields(rig, DisparityRange)),
        grid=Grid(**_fields(dict(file["grid"].attrs), Grid)),
        reduction=int(_number(rig["reduction"], "reduction", *RANGES["reduction"])),
        technology=technology,
        correction=str(rig["correction"]),
    )  # fmt: skip


def _fields(attributes: dict[str, Any], kind: Any) -> dict[str, Any]:
    """The fields of a dataclass among attributes, as Python's own numbers."""
    found: dict[str, Any] = {}
    for field in fields(kind):
        value = _number(attributes[field.name], field.name, *RANGES[field.name])
        if field.type == "int" and value % 1:
            raise ValueError(f"{field.name} of {value:g}")
        found[field.name] = int(value) if field.type == "int" else value
    return found


def _number(value: Any, name: str, low: float, high: float) -> float:
    """An attribute that is one number of a range."""
    if np.ndim(value) or not low <= float(value) <= high:
        raise ValueError(f"{name} of {value!s:.40} where {low:g} to {high:g} can be")
    return float(value)


def _column(file: Any, name: str, kind: type) -> AnyArray:
    """A column of numbers, one or less a frame."""
    column = file[name]
    # More frames than two days of 30 Hz hold no file's columns (our choice).
    if column.ndim != 1 or column.dtype != kind or len(column) > 5_000_000:
        raise ValueError(f"{name} of {column.shape} {column.dtype}")
    return np.asarray(column[:])


_DAMAGE = ArithmeticError, AttributeError, LookupError, MemoryError, OSError, RuntimeError, TypeError, ValueError


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except _DAMAGE as error:
        raise InputError(f"{path}: expected plan-view maps, found {' '.join(str(error).split())}") from error


class MapsWriter:
    """Writes a plan-view recording; ``close`` it, or it cannot be read. Raises WorkError: the disk is full, or the file
    cannot be written.

    Args:
        path: the file to make.
        sensor: the rig, its floor, the grid of the maps and the configuration.
        fps: nominal frames per second.
    """

    def __init__(self, path: Path, sensor: RecordedViews, fps: float) -> None:
        from h5py import File  # a tenth of a second, and few runs write maps

        self._path = path
        self._block: list[Frame[RecordedPoints]] = []
        with _writing(path):
            refuse_full_disk(path)
            self._file = File(path, "w")
            self._file.attrs.update(format=FORMAT, version=VERSION, config=sensor.config, fps=fps)
            _write_rig(self._file, sensor.rig)
            for name, kind in COLUMNS.items():
                self._column(name, kind)
            self._column("background/disparity", np.float32, math.prod(sensor.rig.shape))

    def add(self, frame: Frame[RecordedPoints]) -> None:
        """Append a frame."""
        self._block.append(frame)
        if len(self._block) == BLOCK_FRAMES:
            self._flush()

    def close(self, skipped: Sequence[Skipped] = ()) -> None:
        """Write what is left, and the frames passed over."""
        from h5py import string_dtype

        try:
            self._flush()
            with _writing(self._path):
                self._file["skipped/index"] = np.array([frame.index for frame in skipped], dtype=np.int64)
                self._file["skipped/why"] = np.array([frame.why for frame in skipped], dtype=string_dtype())
        finally:
            with _writing(self._path):
                self._file.close()

    def _flush(self) -> None:
        block = self._block
        self._block = []
        if not block:
            return
        shots = [shot for frame in block for shot in frame.shots if shot is not None]
        columns: dict[str, Any] = {
            "points/pixel": [shot.pixels for shot in shots],
            "points/disparity": [shot.disparities for shot in shots],
            "unmatched/pixel": [shot.unmatched for shot in shots],
            APPEARANCE: [shot.colours for shot in shots if shot.colours is not None],
            "background/disparity": [s.background.reshape(1, -1) for s in shots if s.background is not None],
        }
        columns = {name: np.concatenate(parts) for name, parts in columns.items() if parts}
        if APPEARANCE in columns and len(columns[APPEARANCE]) != len(columns["points/pixel"]):
            raise ValueError("expected colours in all frames or in none")
        columns |= {
            "frames/index": [frame.index for frame in block],
            "frames/timestamp_s": [frame.timestamp_s for frame in block],
            "frames/end": self._ends("points/pixel", [len(shot.pixels) for shot in shots]),
            "frames/unmatched_end": self._ends("unmatched/pixel", [len(shot.unmatched) for shot in shots]),
            "background/frame": [f.index for f, s in zip(block, shots, strict=True) if s.background is not None],
        }
        with _writing(self._path):
            refuse_full_disk(self._path, sum(np.asarray(values).nbytes for values in columns.values()))
            if APPEARANCE in columns and APPEARANCE not in self._file:
                self._column(APPEARANCE, np.uint8).attrs["codes"] = CODES
            for name, values in columns.items():
                column = self._file[name]
                start = len(column)
                column.resize(start + len(values), axis=0)
                column[start:] = values

    def _ends(self, column: str, lengths: Sequence[int]) -> AnyArray:
        """Ends of some more frames' values in a column."""
        return len(self._file[column]) + np.cumsum(lengths)

    def _column(self, name: str, kind: Any, width: int = 0) -> Any:
        """A column of numbers, or of rows of so many, with as many compressed together."""
        row, chunks = ((width,), (1, width)) if width else ((), (32768,))
        return self._file.create_dataset(
            name, (0, *row), kind, maxshape=(None, *row), chunks=chunks, compression="gzip", compression_opts=4,
            shuffle=True,
        )  # fmt: skip


def _write_rig(file: Any, view: FloorRig) -> None:
    floor = view.floor
    rig = asdict(view.geometry) | asdict(view.disparities)
    rig |= {"reduction": view.reduction, "calibration": view.calibration}
    rig |= {"vertical_residual_px": view.vertical_residual_px, "correction": view.correction}
    if view.technology is not None:
        rig["sensor"] = view.technology
    file.create_group("rig").attrs.update(rig)
    file.create_group("floor").attrs.update(
        world_SE3_left=floor.world_SE3_left.matrix, inlier_fraction=floor.inlier_fraction,
        residual_m=floor.residual_m, source=view.floor_source,
    )  # fmt: skip
    if floor.extent_m is not None:
        file["floor"].attrs["extent_m"] = floor.extent_m
    file.create_group("grid").attrs.update(asdict(view.grid))


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, RuntimeError) as error:
        raise WorkError(f"{path}: cannot be written ({reason(error)})") from error
