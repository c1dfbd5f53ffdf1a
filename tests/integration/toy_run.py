"""A small exact recording on which commands are tried, and how to try them."""

import subprocess
import sysconfig
from pathlib import Path

from cli import Succeed

from calib.types import U8
from planview.engine.engine import Engine

FRAMES = 36
EMPTY = 10
FEW = "analysis.setup_frames=4"
Pair = tuple[U8, U8]


def write_world(engine: Engine, folder: Path) -> None:
    from calib.world import save_world

    save_world(engine.stereo.floor, folder / "world.toml")


def run_few(succeed: Succeed, recording: Path, out: Path, *more: object) -> str:
    return succeed("run", recording, "--out", out, "--set", FEW, *more)


def is_whole(rrd: Path) -> bool:
    """True if rerun reads a whole recording."""
    rerun = Path(sysconfig.get_path("scripts")) / "rerun"
    return subprocess.run([rerun, "rrd", "verify", rrd], timeout=60).returncode == 0


def rows_in(file: Path) -> int:
    return file.read_text().count("\n") - 1 if file.exists() else 0
