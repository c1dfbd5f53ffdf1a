"""A small exact recording, its engine, and a way to run commands in this process."""

import shutil
from pathlib import Path

import pytest
from short_clip import write_short_clip
from toy_run import EMPTY, FEW, FRAMES, Pair, write_world
from toy_stereo import ToyWorld, toy_rig, walking, write_toy_recording

from calib.world import RigEntry, save_rigs
from planview.engine.config import load_config
from planview.engine.engine import Engine
from planview.engine.open import open_engine


@pytest.fixture(scope="session")
def pairs() -> list[Pair]:
    """An empty room, and from frame EMPTY on a person who walks through it."""
    world, rig = ToyWorld(), toy_rig()
    return [world.pair(rig, walking(i - EMPTY) if i >= EMPTY else (), i) for i in range(FRAMES)]


@pytest.fixture(scope="session")
def recording(pairs, tmp_path_factory) -> Path:
    return write_toy_recording(tmp_path_factory.mktemp("toy") / "recording", toy_rig(), pairs)


@pytest.fixture(scope="session")
def engine(recording) -> Engine:
    """Floor found once; iterating it again gives the same frames."""
    return open_engine(recording, config=load_config(None, [FEW]))


@pytest.fixture(scope="session")
def short_clip(tmp_path_factory) -> Path:
    """A folder in which data/synthetic/demo is a part of the committed clip."""
    return write_short_clip(tmp_path_factory.mktemp("short"))


@pytest.fixture
def copy(recording, engine, tmp_path) -> Path:
    """A recording to be damaged; its floor is given, so that only the damage is tried."""
    folder = tmp_path / "copy"
    shutil.copytree(recording, folder)
    write_world(engine, folder)
    return folder


@pytest.fixture(scope="session")
def sensors(recording, engine, tmp_path_factory) -> Path:
    """Two sensors at one place that record the same."""
    folder, pose = tmp_path_factory.mktemp("sensors"), engine.stereo.floor.world_SE3_left
    for name in ("left_one", "right_one"):
        shutil.copytree(recording, folder / name)
    save_rigs([RigEntry("left_one", pose), RigEntry("right_one", pose)], folder / "rigs.toml")
    return folder
