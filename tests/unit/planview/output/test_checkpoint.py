"""Checkpoints: graphs of objects through plain values and back, files that are damaged, and what must fit."""

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
from planview.output.memory import Encoded, decode, encode
from planview.output.resume import (
    LATEST,
    PREVIOUS,
    Checkpoint,
    checkpoint_of,
    difference,
    read_checkpoint,
    write_checkpoint,
)
from planview.tracking.lifecycle import Existence

IDENTITY: dict[str, Any] = {"version": {}, "configuration": {"seed": 0}, "recording": {}, "settings": {}}


def restored(value: object) -> Any:
    """A value through JSON and memory of its own."""
    encoded = encode({"it": value})
    roots, nodes = json.loads(json.dumps([encoded.roots, encoded.nodes]))
    return decode(Encoded(roots, nodes, [block.copy() for block in encoded.blocks]), {})["it"]


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


@pytest.mark.parametrize("array", [np.arange(6.0).reshape(2, 3).T, np.zeros((0, 5)), np.array(3), np.arange(9)[::-2]])
def test_an_array_comes_back_with_its_layout(array: np.ndarray) -> None:
    back = restored(array)
    np.testing.assert_array_equal(back, array)
    assert (back.dtype, back.strides) == (array.dtype, array.strides)


def test_arrays_that_share_memory_share_it_again() -> None:
    whole = np.zeros(6)
    back_whole, back_part = restored([whole, whole[2:4]])
    back_part[:] = 5.0
    assert back_whole.tolist() == [0, 0, 5, 5, 0, 0]


def test_an_object_in_two_places_is_one_object_again() -> None:
    person = Existence(1, 0.0, 0.0)
    first, second = restored([person, person])
    assert first is second
    assert (first.track_id, first.state) == (1, "tentative")


def test_a_random_generator_goes_on_with_the_same_numbers() -> None:
    rng = np.random.default_rng(3)
    rng.normal(size=5)
    back = restored(rng)
    assert back.normal(size=4).tolist() == rng.normal(size=4).tolist()


def test_a_present_object_gets_the_memory_and_keeps_its_threads() -> None:
    image = np.full((4, 6, 3), 90, np.uint8)
    one, other = (Foreground(ForegroundParams(), (4, 6)) for _ in range(2))
    worker = other._worker
    one.update(image, None, 0.0)
    decode(encode({"foreground": one}), {"foreground": other})
    assert other._worker is worker
    assert other.background_luma().tolist() == one.background_luma().tolist() != np.zeros((4, 6)).tolist()


@dataclass
class Foreign:
    """A class that is not the project's."""


@pytest.mark.parametrize("value", [Foreign(), SimpleNamespace(a=1), lambda: 1, np.array([object()]), print])
def test_what_is_not_the_projects_is_refused_with_its_place(value: object) -> None:
    with pytest.raises(TypeError, match=r"it\[1\].*which a checkpoint cannot hold"):
        encode({"it": [0, value]})


@pytest.mark.parametrize(
    "node",
    [
        ["object", {}, "os:system"],
        ["object", {}, "planview.output.folder:Path"],
        ["object", {}, "planview.output.no_such_module:Thing"],
        ["record", [], "planview.tracking.lifecycle:Existence"],
        ["array", ["|O", [1], [8], True, 0, 0]],
        ["array", ["<f8", [9], [8], True, 0, 0]],
        ["array", ["<f8", [10**9], [0], True, 0, 0]],
        ["array", ["<f8", [1], [10**30], True, 0, 0]],
        ["generator", 1, "Generator"],
        ["spell", 1],
    ],
)
def test_a_node_that_is_no_memory_is_refused(node: list[object]) -> None:
    with pytest.raises(ValueError):
        decode(Encoded({"it": {"#": 0}}, [node], [np.zeros(8, np.uint8)]), {})


def write(folder: Path, frame: int) -> None:
    write_checkpoint(folder, Checkpoint(IDENTITY, {"tables": {}, "logs": {}}, encode({"frame": [frame]})))


def frame_in(checkpoint: Checkpoint | None) -> int:
    assert checkpoint is not None
    return int(decode(checkpoint.memory, {})["frame"][0])


def test_the_last_two_checkpoints_are_kept(tmp_path: Path) -> None:
    for frame in (1, 2, 3):
        write(tmp_path, frame)
    assert frame_in(read_checkpoint(tmp_path / LATEST)) == 3
    assert frame_in(read_checkpoint(tmp_path / PREVIOUS)) == 2
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "rewritten"])
def test_a_damaged_checkpoint_gives_way_to_the_one_before(tmp_path: Path, damage: str) -> None:
    write(tmp_path, 1)
    write(tmp_path, 2)
    data = bytearray((tmp_path / LATEST).read_bytes())
    middle = len(data) // 2
    data[middle] ^= 0x55
    rewritten = io.BytesIO()
    with np.load(tmp_path / LATEST) as file:
        np.savez(rewritten, **{**file, "block0": np.zeros(8, np.uint8)})
    kept = {"cut": bytes(data[:middle]), "flip": bytes(data), "empty": b"", "rewritten": rewritten.getvalue()}[damage]
    (tmp_path / LATEST).write_bytes(kept)
    told: list[str] = []
    assert frame_in(checkpoint_of(tmp_path, IDENTITY, told.append)) == 1
    assert len(told) == 1
    assert "the checkpoint is damaged" in told[0]


@pytest.mark.parametrize(
    "written",
    [
        {},
        {"tables": [], "logs": {}},
        {"tables": {"tracks.csv": ["a", 1]}, "logs": {}},
        {"tables": {"../x.csv": [1, 1]}, "logs": {}},
        {"tables": {"tracks.csv": [-1, 1]}, "logs": {}},
        {"tables": {}, "logs": {"MapsLog": 1.5}},
    ],
)
def test_positions_that_no_run_writes_are_damage(tmp_path: Path, written: dict[str, Any]) -> None:
    write_checkpoint(tmp_path, Checkpoint(IDENTITY, written, encode({})))
    with pytest.raises(ValueError, match="written"):
        read_checkpoint(tmp_path / LATEST)


def test_a_checkpoint_of_another_configuration_is_refused(tmp_path: Path) -> None:
    write(tmp_path, 1)
    with pytest.raises(InputError, match=r"found one of another configuration \(seed\)"):
        checkpoint_of(tmp_path, IDENTITY | {"configuration": {"seed": 1}}, print)


def test_the_first_difference_of_two_runs_is_named() -> None:
    assert difference(IDENTITY, IDENTITY) == ""
    assert difference(IDENTITY, IDENTITY | {"version": {"numpy": "9"}}) == "another version (numpy)"
