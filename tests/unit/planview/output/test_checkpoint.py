"""Runs that stop and are continued."""

import io
import json
import math
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calib.errors import InputError
from planview.foreground.gain import Exposure
from planview.foreground.mixture import Foreground
from planview.foreground.params import ForegroundParams
from planview.output.folder import RunInfo, write_run_info
from planview.output.resume import (
    CHECKPOINT,
    Checkpoint,
    SavedState,
    checkpoint_of,
    decode,
    difference,
    encode,
    read_checkpoint,
    write_checkpoint,
)
from planview.tracking.base import Existence

IDENTITY: dict[str, Any] = {
    "version": {},
    "configuration": {"seed": 0},
    "recording": {},
    "settings": {"tracker": "joint"},
}


def restored(value: object) -> Any:
    """A value through JSON."""
    state = encode({"it": value})
    return decode(SavedState(json.loads(json.dumps(state.document)), state.arrays))["it"]


@pytest.mark.parametrize(
    "value",
    [
        None, True, 7, 2**127, -0.0, math.inf, "é", (1, (2.5,)), [1, "a"], {(1, 2): [3]}, {3, 1},
        frozenset({"a"}), deque([1, 2], maxlen=3), np.float32(0.1), np.int64(-3), Exposure(2.0, 3.0),
        ForegroundParams(beta=5.0), np.timedelta64(3, "s"),
    ],
)  # fmt: skip
def test_a_value_comes_back_with_its_type(value: object) -> None:
    back = restored(value)
    assert (type(back), repr(back)) == (type(value), repr(value))


@pytest.mark.parametrize("array", [np.arange(6.0).reshape(2, 3), np.arange(6.0).reshape(2, 3).T, np.array(3)])
def test_an_array_comes_back_from_a_file_with_its_layout(tmp_path: Path, array: np.ndarray) -> None:
    write_checkpoint(tmp_path, Checkpoint(IDENTITY, {}, encode({"it": array})))
    back = decode(read_checkpoint(tmp_path / CHECKPOINT).state)["it"]
    np.testing.assert_array_equal(back, array)
    assert (back.dtype, back.strides) == (array.dtype, array.strides)


@pytest.mark.parametrize("array", [np.zeros((0, 5)), np.arange(9)[::-2], np.arange(9.0)[3:5]])
def test_a_part_of_an_array_comes_back_with_its_values(array: np.ndarray) -> None:
    np.testing.assert_array_equal(restored(array), array, strict=True)


def test_an_object_in_two_places_is_one_again():
    person = Existence(1, 0.0, 0.0)
    first, second = restored([person, person])
    assert first is second and (first.track_id, first.state) == (1, "tentative")


def test_a_random_generator_goes_on_with_the_same_numbers() -> None:
    rng = np.random.default_rng(3)
    rng.normal(size=5)
    back = restored(rng)
    assert back.normal(size=4).tolist() == rng.normal(size=4).tolist()


def test_a_foreground_goes_on_from_the_state_of_another() -> None:
    image = np.full((4, 6, 3), 90, np.uint8)
    one, other = (Foreground(ForegroundParams(), (4, 6)) for _ in range(2))
    one.update(image, None, 0.0)
    other.set_state(decode(encode({"foreground": one.state()}))["foreground"])
    assert other.background_luma().tolist() == one.background_luma().tolist() != np.zeros((4, 6)).tolist()


@dataclass
class Foreign:
    """A class that is not the project's."""


@pytest.mark.parametrize("value", [Foreign(), SimpleNamespace(a=1), lambda: 1, np.array([object()]), print])
def test_what_is_not_the_projects_is_refused_with_its_place(value: object) -> None:
    with pytest.raises(TypeError, match=r"it\[1\].*which a checkpoint cannot hold"):
        encode({"it": [0, value]})


@pytest.mark.parametrize("name", ["os:system", "planview.output.folder:Path", "planview.output.no_such_module:Thing"])
def test_a_class_that_is_not_the_projects_is_not_taken_from_a_file(name: str) -> None:
    with pytest.raises(ValueError, match="expected a class of planview"):
        decode(SavedState({"object": [name, {}]}, []))


def write(folder: Path, frame: int) -> None:
    write_checkpoint(folder, Checkpoint(IDENTITY, {"tables": {}, "logs": {}}, encode({"frame": [frame]})))


def frame_in(checkpoint: Checkpoint | None) -> int:
    return int(decode(checkpoint.state)["frame"][0])


def test_a_checkpoint_replaces_the_one_before(tmp_path: Path) -> None:
    for frame in (1, 2, 3):
        write(tmp_path, frame)
    assert frame_in(read_checkpoint(tmp_path / CHECKPOINT)) == 3 and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "rewritten"])
def test_a_damaged_checkpoint_is_not_resumed_from(tmp_path: Path, damage: str) -> None:
    write(tmp_path, 1)
    data = bytearray((tmp_path / CHECKPOINT).read_bytes())
    middle = len(data) // 2
    data[middle] ^= 0x55
    rewritten = io.BytesIO()
    with np.load(tmp_path / CHECKPOINT) as file:
        np.savez(rewritten, **{**file, "array0": np.zeros(8, np.uint8)})
    kept = {"cut": bytes(data[:middle]), "flip": bytes(data), "empty": b"", "rewritten": rewritten.getvalue()}[damage]
    (tmp_path / CHECKPOINT).write_bytes(kept)
    write_run_info(RunInfo(config=IDENTITY["configuration"], tracker="joint"), tmp_path / "run.json")
    output: list[str] = []
    assert checkpoint_of(tmp_path, IDENTITY, output.append) is None
    assert "the checkpoint is damaged" in output[0] and "starts again" in output[1]


def test_a_checkpoint_of_another_configuration_is_refused_and_the_first_difference_named(tmp_path):
    write(tmp_path, 1)
    with pytest.raises(InputError, match=r"found one of another configuration \(seed\)"):
        checkpoint_of(tmp_path, IDENTITY | {"configuration": {"seed": 1}}, print)
    assert difference(IDENTITY, IDENTITY) == ""
    assert difference(IDENTITY, IDENTITY | {"version": {"numpy": "9"}}) == "another version (numpy)"
