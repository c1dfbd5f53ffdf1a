"""Plan-view recordings: what was written is read, and what a camera cannot have written is refused in a sentence."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from toy_maps import write_toy_maps

from calib.errors import InputError
from planview.engine.open import open_engine
from planview.maps.recording import MapsRecording
from stereo.recording import Skipped

FIELDS = (
    *(("rig", name) for name in ("width", "height", "focal_u_px", "cu_px", "baseline_m", "reduction", "count")),
    *(("grid", name) for name in ("x_min_m", "cell_m", "n_rows")),
    ("", "fps"),
)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_toy_maps(tmp_path_factory.mktemp("maps") / "maps.h5")


@pytest.fixture
def maps(good: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(good, tmp_path / "maps.h5"))


def track(path: Path) -> int:
    return sum(1 for _ in open_engine(path))


def test_frames_are_read_as_they_were_written(maps: Path) -> None:
    recording = MapsRecording(maps)
    frames = list(recording)
    assert [f.index for f in frames][5:9] == [5, 6, 8, 9] and recording.n_frames == track(maps) == 39
    assert recording.skipped == [Skipped(7, "left: file is missing")] and recording.fps == 15.0
    first = frames[0]
    assert first.unmatched is not None and len(first.unmatched) >= 9 and len(first.pixels) == len(first.disparities)
    assert first.background is not None and frames[1].background is None


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e9, 1e9, "text", [1.0, 2.0]])
@pytest.mark.parametrize(("group", "name"), FIELDS)
def test_number_that_no_rig_has_is_refused_by_its_name(maps: Path, group: str, name: str, value: object) -> None:
    with h5py.File(maps, "r+") as file:
        (file[group] if group else file).attrs[name] = value
    with pytest.raises(InputError, match=r"maps\.h5: expected plan-view maps .*, found ") as refused:
        MapsRecording(maps)
    assert isinstance(value, str | list) or name in str(refused.value)


def longer(file: Any) -> None:
    for column in file["frames"].values():
        column.resize(5 * 10**8, axis=0)


def other(name: str, values: object) -> Callable[[Any], None]:
    """The dataset holds something else."""

    def damage(file: Any) -> None:
        del file[name]
        file[name] = values

    return damage


def one(name: str, place: int, value: float) -> Callable[[Any], None]:
    def damage(file: Any) -> None:
        file[name][place] = value

    return damage


def pose(place: tuple[int, int], value: float) -> Callable[[Any], None]:
    def damage(file: Any) -> None:
        matrix = file["floor"].attrs["world_SE3_left"]
        matrix[place] = value
        file["floor"].attrs["world_SE3_left"] = matrix

    return damage


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (longer, "500000000"),
        (one("frames/timestamp_s", 3, 0.0), "times that do not increase"),
        (one("frames/timestamp_s", 3, np.nan), "times that do not increase"),
        (one("frames/timestamp_s", -1, 1e300), "times that do not increase"),
        (one("frames/index", 3, 0), "frames out of order"),
        (one("frames/end", 3, 10**9), "does not fit the frames"),
        (one("frames/unmatched_end", 3, -1), "does not fit the frames"),
        (other("frames/index", np.arange(39.0)), "frames/index of"),
        (other("points/pixel", np.zeros((3, 3), np.int32)), "points/pixel of"),
        (other("background/disparity", np.zeros((1, 5), np.float32)), "backgrounds of another size"),
        (one("points/appearance", 5, 255), "colour codes below 200"),
        (one("points/pixel", 5, -4), "pixels in order"),
        (one("points/pixel", 5, 10**9), "pixels in order"),
        (one("unmatched/pixel", 1, 10**9), "pixels in order"),
        (one("points/disparity", 5, np.inf), "disparities of points"),
        (one("points/disparity", 5, -1.0), "disparities of points"),
        (pose((2, 3), 1e9), "above the floor"),
        (pose((0, 3), 1e9), "of the origin"),
        (pose((0, 0), np.nan), "finite rotation"),
        (lambda file: file["rig"].attrs.update(sensor="eye"), "a sensor 'eye'"),
        (lambda file: file["rig"].attrs.update(width=80.5), "width of 80.5"),
    ],
)
def test_table_that_no_run_wrote_is_refused(maps: Path, damage: Callable[[Any], None], named: str) -> None:
    with h5py.File(maps, "r+") as file:
        damage(file)
    with pytest.raises(InputError, match=rf"maps\.h5: .*{named}"):
        track(maps)


def test_floor_that_the_camera_does_not_see_is_refused(maps: Path) -> None:
    up = np.eye(4)  # looks at the sky from 2.5 m
    up[2, 3] = 2.5
    with h5py.File(maps, "r+") as file:
        file["floor"].attrs["world_SE3_left"] = up
    with pytest.raises(InputError, match=r"maps\.h5: expected a camera that sees the space between floor and H_max"):
        track(maps)
