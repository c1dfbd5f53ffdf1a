"""world.toml and rigs.toml: what is written is read again, and what cannot be cameras above a floor is refused."""

from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError
from calib.pose import SE3
from calib.rig import Floor
from calib.world import RigEntry, load_rigs, load_world, save_rigs, save_world

NORTH = RigEntry("north", SE3.from_rotvec([2.0, 0.1, 0.2], [0.0, 0.0, 2.4]))
SOUTH = RigEntry('so"uth\n', SE3.from_rotvec([2.1, 0.3, 0.4], [3.0, 1.0, 2.2]), 1.25)


def test_heads_are_read_as_they_were_written(tmp_path: Path) -> None:
    save_rigs([NORTH, SOUTH], tmp_path / "rigs.toml", "two\nlines")
    for entry, again in zip((NORTH, SOUTH), load_rigs(tmp_path / "rigs.toml"), strict=True):
        assert (again.folder, again.start_s) == (entry.folder, entry.start_s)
        np.testing.assert_array_equal(again.world_SE3_left.matrix, entry.world_SE3_left.matrix)


@pytest.mark.parametrize(
    ("entries", "found"),
    [
        ([NORTH, NORTH], "once"),
        ([RigEntry("../north", NORTH.world_SE3_left)], "inside"),
        ([RigEntry("north", SE3.from_rotvec([2.0, 0.1, 0.2], [0.0, 0.0, -2.4]))], "above the floor"),
        ([], "'head'"),
    ],
)
def test_heads_that_cannot_be_are_refused(entries: list[RigEntry], found: str, tmp_path: Path) -> None:
    save_rigs(entries, tmp_path / "rigs.toml")
    with pytest.raises(InputError, match=found):
        load_rigs(tmp_path / "rigs.toml")


@pytest.mark.parametrize("text", ["head = 3", "[[head]]\nfolder = 'a'", "head = [1]", "[[head", "head = []"])
def test_files_that_list_no_heads_are_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "rigs.toml").write_text(text)
    with pytest.raises(InputError, match=r"rigs\.toml: expected"):
        load_rigs(tmp_path / "rigs.toml")


def test_world_is_read_as_it_was_written(tmp_path: Path) -> None:
    floor = Floor(NORTH.world_SE3_left, 0.8, 0.01, np.eye(3), (-3.0, 0.0, 3.0, 6.0))
    save_world(floor, tmp_path / "world.toml")
    again = load_world(tmp_path / "world.toml")
    assert (again.height_m, again.inlier_fraction, again.extent_m) == (2.4, 0.8, floor.extent_m)
    np.testing.assert_array_equal(again.world_SE3_left.matrix, floor.world_SE3_left.matrix)


@pytest.mark.parametrize(
    ("place", "found"),
    [
        ((0.0, 0.0, 1e-9), "found 1e-09 m"),
        ((0.0, 0.0, -2.0), "found -2 m"),
        ((0.0, 0.0, 250.0), "found 250 m"),
        ((1e9, 0.0, 2.0), "within 10000 m of the origin"),
    ],
)
def test_camera_in_an_impossible_place_is_refused(place: tuple[float, ...], found: str, tmp_path: Path) -> None:
    save_world(Floor(SE3.from_rotvec([2.0, 0.1, 0.2], place)), tmp_path / "world.toml")
    with pytest.raises(InputError, match=rf"world\.toml: expected a camera .*{found}"):
        load_world(tmp_path / "world.toml")


@pytest.mark.parametrize("extent", [(5.0, 0.0, 3.0, 6.0), (float("nan"), 0.0, 3.0, 6.0), (0.0, 0.0, float("inf"), 1.0)])
def test_extent_that_is_no_rectangle_is_refused(extent: tuple[float, float, float, float], tmp_path: Path) -> None:
    save_world(Floor(NORTH.world_SE3_left, extent_m=extent), tmp_path / "world.toml")
    with pytest.raises(InputError, match="an extent_m of"):
        load_world(tmp_path / "world.toml")


def test_list_of_heads_with_a_key_of_60000_parts_is_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "rigs.toml").write_text("a" + ".a" * 60_000 + " = 1")
    with pytest.raises(InputError, match=r"rigs\.toml: expected .*nested up to 32 deep"):
        load_rigs(tmp_path / "rigs.toml")
