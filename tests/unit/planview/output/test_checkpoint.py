"""Runs that stop and are continued."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.errors import InputError
from planview.output.folder import RunInfo, write_run_info
from planview.output.resume import (
    CHECKPOINT,
    Checkpoint,
    checkpoint_of,
    difference,
    known_identity,
    read_checkpoint,
    write_checkpoint,
)

IDENTITY: dict[str, Any] = {"version": {}} | known_identity(RunInfo(config={"seed": 0}, tracker="joint"))


@pytest.mark.parametrize("array", [np.arange(6.0).reshape(2, 3), np.arange(6.0).reshape(2, 3).T])
def test_an_array_comes_back_with_its_layout(tmp_path, array):
    write_checkpoint(tmp_path, Checkpoint(IDENTITY, {}, {"one": [array], "other": {"array": 0}}))
    state = read_checkpoint(tmp_path / CHECKPOINT).state
    np.testing.assert_array_equal(state["one"][0], array, strict=True)
    assert state["one"][0].strides == array.strides
    assert state["other"] == {"array": 0}


def write(folder: Path, frame: int) -> None:
    write_checkpoint(folder, Checkpoint(IDENTITY, {"tables": {}, "logs": {}}, {"frame": frame}))


def frame_in(checkpoint: Checkpoint | None) -> int:
    return int(checkpoint.state["frame"])


def test_a_checkpoint_replaces_the_one_before(tmp_path):
    for frame in (1, 2, 3):
        write(tmp_path, frame)
    assert frame_in(read_checkpoint(tmp_path / CHECKPOINT)) == 3
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("damage", ["cut", "flip", "empty"])
def test_a_damaged_checkpoint_is_not_resumed_from(tmp_path, damage):
    write(tmp_path, 1)
    data = bytearray((tmp_path / CHECKPOINT).read_bytes())
    middle = len(data) // 2
    data[middle] ^= 0x55
    kept = {"cut": bytes(data[:middle]), "flip": bytes(data), "empty": b""}[damage]
    (tmp_path / CHECKPOINT).write_bytes(kept)
    write_run_info(RunInfo(config=IDENTITY["configuration"], tracker="joint"), tmp_path / "run.json")
    with pytest.warns(UserWarning, match="the checkpoint is damaged"), pytest.warns(UserWarning, match="starts again"):
        assert checkpoint_of(tmp_path, IDENTITY) is None


def test_a_checkpoint_of_another_configuration_is_refused(tmp_path):
    write(tmp_path, 1)
    with pytest.raises(InputError, match=r"\(seed\)"):
        checkpoint_of(tmp_path, IDENTITY | {"configuration": {"seed": 1}})
    assert difference(IDENTITY, IDENTITY) == ""
    assert difference(IDENTITY, IDENTITY | {"version": {"numpy": "9"}}) == "another version (numpy)"
