"""Memory of a long run from images, with all that it can write: what is kept does not grow with the frames.

``HYPOTHESIS_PROFILE=nightly`` runs an hour of 15 Hz instead of a minute.
"""

import ctypes
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from toy_stereo import ToyWorld, toy_rig, walking, write_toy_recording

from calib.rig import Floor
from calib.world import save_world
from planview.engine.config import Config
from planview.engine.engine import Engine
from planview.engine.open import engine_of
from planview.engine.setup import set_up
from planview.output.run import run
from planview.output.run_spec import RunSpec
from stereo.readers import open_recording
from stereo.recording import Frame, Recording, Shot, StereoPair

pytestmark = pytest.mark.slow
os.environ["MIMALLOC_PURGE_DELAY"] = "0"
"""Rerun's allocator gives back what it no longer needs at once, as ``malloc_trim`` makes glibc do."""
FRAMES, GROWTH = (54_000, 0.01) if os.environ.get("HYPOTHESIS_PROFILE") == "nightly" else (900, 0.03)
"""A minute leaves what the libraries keep of their first seconds, a hundredth of the whole, in the difference."""
LAP = 45


class Laps:
    """A short recording, read again and again as one long one."""

    n_frames = FRAMES

    def __init__(self, recording: Recording[StereoPair]) -> None:
        self._one = recording

    def __getattr__(self, name: str) -> Any:
        return getattr(self._one, name)

    def __iter__(self) -> Iterator[Frame[Shot]]:
        for first in range(0, FRAMES, LAP):
            for frame in self._one:
                yield replace(frame, index=first + frame.index, timestamp_s=(first + frame.index) / 15.0)


@pytest.fixture
def engine(tmp_path) -> Engine:
    world, rig = ToyWorld(), toy_rig((160, 120), 115.0, 0.12)
    folder = write_toy_recording(tmp_path / "r", rig, [world.pair(rig, walking(i), i) for i in range(LAP)])
    save_world(Floor(world.world_SE3_left, 0.8, 0.01), folder / "world.toml")
    recording = open_recording(folder)
    return engine_of(Laps(recording), config=Config(), setup=set_up(recording, Config()))


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="resident memory is read from /proc")
@pytest.mark.parametrize("logs", ["", "maps", "rrd"])
def test_memory_of_a_long_run_does_not_grow(engine, tmp_path, logs):
    resident = {}

    def watch(result):
        if result.frame in (FRAMES // 3 - 1, FRAMES - 1):
            ctypes.CDLL(None).malloc_trim(0)  # what glibc keeps for itself is not kept by the run
            resident[result.frame] = int(Path("/proc/self/statm").read_text().split()[1])

    spec = RunSpec(tmp_path / "out", maps=logs == "maps", rrd_every=int(logs == "rrd"), checkpoint_every_s=10.0)
    run(engine, spec, [watch])
    before, after = resident.values()
    assert after <= before * (1 + GROWTH), f"{before} to {after} pages"
