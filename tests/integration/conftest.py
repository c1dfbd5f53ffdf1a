"""A small exact recording, its engine, and a way to run commands in this process."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from short_clip import write_short_clip
from toy_run import EMPTY, FEW, FRAMES, Pair, Refused, Say, one_sentence, write_world
from toy_stereo import ToyWorld, toy_rig, walking, write_toy_recording

from planview.cli import main
from planview.engine.config import load_config
from planview.engine.engine import Engine
from planview.engine.open import open_engine


@pytest.fixture(scope="session")
def pairs() -> list[Pair]:
    """An empty room, and from frame EMPTY on a person who walks through it."""
    world, rig = ToyWorld(), toy_rig()
    return [world.pair(rig, walking(i - EMPTY) if i >= EMPTY else (), i) for i in range(FRAMES)]


@pytest.fixture(scope="session")
def recording(pairs: list[Pair], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_toy_recording(tmp_path_factory.mktemp("toy") / "recording", toy_rig(), pairs)


@pytest.fixture(scope="session")
def engine(recording: Path) -> Engine:
    """Floor found once; iterating it anew gives the same frames."""
    return open_engine(recording, config=load_config(None, [FEW]))


@pytest.fixture(scope="session")
def short_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which data/synthetic/demo is a part of the committed clip."""
    return write_short_clip(tmp_path_factory.mktemp("short"))


@pytest.fixture
def copy(recording: Path, engine: Engine, tmp_path: Path) -> Path:
    """A recording to be damaged; its floor is given, so that only the damage is tried."""
    folder = tmp_path / "copy"
    shutil.copytree(recording, folder)
    write_world(engine, folder)
    return folder


@pytest.fixture
def say(capsys: pytest.CaptureFixture[str]) -> Say:
    """Run a command in this process: exit status and what it says on stderr."""

    def command(*argv: object) -> tuple[int, str]:
        try:
            main([str(word) for word in argv])
        except SystemExit as left:
            return int(left.code or 0), capsys.readouterr().err
        return 0, capsys.readouterr().err

    return command


@pytest.fixture
def refused(say: Say) -> Refused:
    """Run a command that is refused: the one sentence that says why."""

    def command(*argv: object, status: int = 2) -> str:
        found, told = say(*argv)
        assert found == status, told
        return one_sentence(told)

    return command


@pytest.fixture
def json_of(capsys: pytest.CaptureFixture[str]) -> Callable[..., dict[str, Any]]:
    """Run a command with --json: the object that it prints."""

    def command(*argv: object) -> dict[str, Any]:
        with pytest.raises(SystemExit) as left:
            main([*map(str, argv), "--json"])
        assert not left.value.code
        return dict(json.loads(capsys.readouterr().out))

    return command
