"""rigs.toml: what is written is read again, and what cannot be heads is refused."""

from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError
from calib.pose import SE3
from calib.world import RigEntry, load_rigs, save_rigs

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
