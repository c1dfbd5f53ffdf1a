"""One run per folder."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from calib.errors import InputError
from planview.output.folder import LOCK_NAME, folder_lock, prepare_folder

HOLD = """
import sys, time
from pathlib import Path
from planview.output.folder import folder_lock
with folder_lock(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@contextmanager
def another_process_holding(folder: Path) -> Iterator["subprocess.Popen[str]"]:
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, text=True)
    assert process.stdout
    assert process.stdout.readline() == "held\n"
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def test_a_folder_that_another_process_holds_is_refused_with_its_process_and_kept(tmp_path: Path) -> None:
    (tmp_path / "tracks.csv").write_text("theirs")
    with another_process_holding(tmp_path) as process:
        with pytest.raises(InputError, match=f"process {process.pid} on .* is writing into it"):
            prepare_folder(tmp_path, overwrite=True)
        assert (tmp_path / "tracks.csv").read_text() == "theirs"


def test_the_lock_of_a_killed_process_is_told_and_taken_over(tmp_path: Path) -> None:
    with another_process_holding(tmp_path) as process:
        pass
    with folder_lock(tmp_path) as told:
        assert f"process {process.pid}" in told
        assert json.loads((tmp_path / LOCK_NAME).read_text())["pid"] == os.getpid()
    assert not (tmp_path / LOCK_NAME).exists()


def test_a_lock_of_another_host_is_refused_and_says_what_to_delete(tmp_path: Path) -> None:
    (tmp_path / LOCK_NAME).write_text('{"pid": 1, "host": "elsewhere", "since": "yesterday"}')
    with pytest.raises(InputError, match=r"process 1 on elsewhere .*delete .*run\.lock"), folder_lock(tmp_path):
        pass


def test_a_process_may_lock_within_its_own_lock(tmp_path: Path) -> None:
    with folder_lock(tmp_path):
        with folder_lock(tmp_path) as told:
            assert told == ""
        assert (tmp_path / LOCK_NAME).exists()
