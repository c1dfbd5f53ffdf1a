"""Runs that stop, are continued, and keep pace."""

import io
import json
import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cli import Refused

from calib.errors import InputError
from planview.engine.open import open_engine
from planview.foreground.gain import Exposure
from planview.foreground.mixture import Foreground
from planview.foreground.params import ForegroundParams
from planview.output.folder import PaceInfo, RunInfo, read_run_info, write_run_info
from planview.output.resume import (
    CHECKPOINT,
    Checkpoint,
    checkpoint_of,
    difference,
    read_checkpoint,
    write_checkpoint,
)
from planview.output.run import RunOptions, run
from planview.output.state import SavedState, decode, encode
from planview.output.totals import Pace
from planview.tracking.lifecycle import Existence

IDENTITY: dict[str, Any] = {
    "version": {},
    "configuration": {"seed": 0},
    "recording": {},
    "settings": {"tracker": "joint"},
}


def restored(value: object) -> Any:
    """A value through JSON."""
    state = encode({"it": value})
    roots, nodes = json.loads(json.dumps([state.roots, state.nodes]))
    return decode(SavedState(roots, nodes, state.arrays), {})["it"]


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
    back = decode(read_checkpoint(tmp_path / CHECKPOINT).state, {})["it"]
    np.testing.assert_array_equal(back, array)
    assert (back.dtype, back.strides) == (array.dtype, array.strides)


@pytest.mark.parametrize("array", [np.zeros((0, 5)), np.arange(9)[::-2], np.arange(9.0)[3:5]])
def test_a_part_of_an_array_comes_back_with_its_values(array: np.ndarray) -> None:
    np.testing.assert_array_equal(restored(array), array, strict=True)


def test_an_array_and_an_object_in_two_places_are_one_again():
    numbers = np.zeros(6)
    first, second = restored([numbers, numbers])
    assert first is second
    person = Existence(1, 0.0, 0.0)
    first, second = restored([person, person])
    assert first is second and (first.track_id, first.state) == (1, "tentative")


def test_a_random_generator_goes_on_with_the_same_numbers() -> None:
    rng = np.random.default_rng(3)
    rng.normal(size=5)
    back = restored(rng)
    assert back.normal(size=4).tolist() == rng.normal(size=4).tolist()


def test_a_present_object_gets_the_memory() -> None:
    image = np.full((4, 6, 3), 90, np.uint8)
    one, other = (Foreground(ForegroundParams(), (4, 6)) for _ in range(2))
    one.update(image, None, 0.0)
    decode(encode({"foreground": one}), {"foreground": other})
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
        decode(SavedState({"it": {"#": 0}}, [["object", {}, name]], []), {})


def write(folder: Path, frame: int) -> None:
    write_checkpoint(folder, Checkpoint(IDENTITY, {"tables": {}, "logs": {}}, encode({"frame": [frame]})))


def frame_in(checkpoint: Checkpoint | None) -> int:
    return int(decode(checkpoint.state, {})["frame"][0])


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


class FakeClock:
    def __init__(self) -> None:
        self.time_s = 100.0

    def now_s(self) -> float:
        return self.time_s

    def sleep(self, seconds: float) -> None:
        self.time_s += seconds


def paced(clock: FakeClock) -> Pace:
    return Pace(clock.now_s, clock.sleep)


class Engine:
    """Takes the same time for every frame; its recording's first timestamp is not 0."""

    def __init__(self, clock: FakeClock, step_s: float, recording: Any) -> None:
        self._clock, self._step_s, self.recording = clock, step_s, recording

    def step(self, frame: Any) -> Any:
        self._clock.sleep(self._step_s)
        return frame


def frames_of(times_s: Iterable[float]) -> list[SimpleNamespace]:
    return [SimpleNamespace(frame=n, timestamp_s=time_s) for n, time_s in enumerate(times_s)]


def played(step_s: float, times_s: Iterable[float]) -> tuple[list[int], PaceInfo, float]:
    """Frames tracked, their lines, and how long it took [s]."""
    clock = FakeClock()
    pace = paced(clock)
    tracked = []
    for result in pace.results(Engine(clock, step_s, frames_of(times_s))):  # type: ignore[arg-type]
        pace.written(result.timestamp_s)
        tracked.append(result.frame)
    return tracked, pace.info(), clock.time_s - 100.0


EIGHT_HZ = [2.0 + n / 8 for n in range(9)]


@pytest.mark.parametrize(
    ("step_s", "times_s", "tracked", "latency_ms", "took_s"),
    [
        (1 / 16, EIGHT_HZ, list(range(9)), 62.5, 1.0625),
        (1 / 4, EIGHT_HZ, [0, 2, 4, 6, 8], 250.0, 1.25),
        (1 / 4, [0.0, 10.0], [0, 1], 250.0, 10.25),
    ],
    ids=["in time: as late as a frame takes", "twice too slow: every second frame is dropped", "a pause is waited for"],
)
def test_engine_drops_the_frames_for_which_it_has_no_time(step_s, times_s, tracked, latency_ms, took_s):
    late = dict.fromkeys(("latency_median_ms", "latency_95_ms", "latency_99_ms"), latency_ms)
    info = PaceInfo(frames_dropped=len(times_s) - len(tracked), **late)
    assert played(step_s, times_s) == (tracked, info, took_s) and played(1.0, []) == ([], PaceInfo(), 0.0)


def test_latency_counts_from_when_the_frame_was_due_and_not_from_when_it_was_taken() -> None:
    tracked, info, _ = played(3 / 16, EIGHT_HZ[:4])
    # Frame 0 at 0 to 3/16; 1 (due 2/16) at 3/16 to 6/16; 3 (due 6/16; 2 was due 4/16) at 6/16 to 9/16.
    assert tracked == [0, 1, 3] and info.frames_dropped == 1 and info.latency_median_ms == 187.5
    assert info.latency_99_ms == pytest.approx(187.5 + 0.98 * 62.5)  # of 187.5, 250 and 187.5


class Device:
    """Frames of every second that come late by the delays given."""

    is_live = True

    def __init__(self, clock: FakeClock, delays_s: list[float]) -> None:
        self._clock, self._delays_s = clock, delays_s

    def __iter__(self) -> Iterator[SimpleNamespace]:
        for n, delay_s in enumerate(self._delays_s):
            self._clock.time_s = 100.0 + n + delay_s
            yield SimpleNamespace(frame=n, timestamp_s=float(n))


def test_clock_of_a_device_is_set_by_its_least_delayed_frame() -> None:
    clock = FakeClock()
    pace = paced(clock)
    list(pace.results(Engine(FakeClock(), 0.0, Device(clock, [0.5, 0.25, 0.75]))))  # type: ignore[arg-type]
    pace.written(2.0)
    assert clock.time_s == 102.75 and pace.info().latency_median_ms == 500.0


def test_run_in_real_time_keeps_its_pace_in_run_json_and_writes_no_checkpoint(street: Path, tmp_path: Path) -> None:
    out = tmp_path / "paced"
    out.mkdir()
    options = RunOptions("ellipse-particle", max_frames=3, checkpoint_every_s=1e-9, pace=paced(FakeClock()))
    run(open_engine(tmp_path / "street", "ellipse-particle"), out, options)
    info = read_run_info(out / "run.json")
    assert info.frames_read == 3 and info.pace is not None and info.pace.frames_dropped == 0
    assert info.pace.latency_99_ms == pytest.approx(0.0, abs=1e-6)
    assert sorted(path.name for path in out.iterdir()) == ["decisions.csv", "run.json", "tracks.csv"]


def test_run_in_real_time_cannot_be_resumed(street: Path, tmp_path: Path, refused: Refused) -> None:
    output = refused("run", tmp_path / "street", "--out", tmp_path / "paced", "--set", "run.real_time=true", "--resume")
    assert "--resume and run.real_time cannot be combined" in output
