"""``planview sweep --cluster`` on a real scheduler with two workers on loopback, one of which is killed."""

import csv
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from planview.output.maps_log import MapsLog
from planview.output.run import run

pytestmark = pytest.mark.slow
REPOSITORY = Path(__file__).resolve().parents[2]
JOBS = 8


@contextmanager
def process(module: str, *words: str) -> Iterator[subprocess.Popen[str]]:
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    command = [sys.executable, "-m", f"distributed.cli.{module}", *words]
    started = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environment)
    try:
        yield started
    finally:
        started.kill()
        started.communicate()


def address_of(scheduler: subprocess.Popen[str]) -> str:
    assert scheduler.stderr is not None
    for line in scheduler.stderr:
        found = re.search(r"Scheduler at:\s+(tcp://\S+)", line)
        if found:
            threading.Thread(target=scheduler.stderr.read, daemon=True).start()
            return found.group(1)
    raise AssertionError("the scheduler ended")


@pytest.fixture
def cluster() -> Iterator[tuple[str, list[subprocess.Popen[str]]]]:
    """Address of a scheduler, and its two workers without nannies."""
    with ExitStack() as stack:
        local = ("--host", "127.0.0.1", "--no-dashboard")
        scheduler = stack.enter_context(process("dask_scheduler", "--port", "0", *local))
        address = address_of(scheduler)
        words = (address, "--nthreads", "1", "--no-nanny", *local)
        yield address, [stack.enter_context(process("dask_worker", *words)) for _ in range(2)]


def kill_when_working(worker: subprocess.Popen[str], out: Path) -> None:
    """Kill a worker in the middle of a run, when a first run of the study is done."""
    while not list(out.glob("jobs/*/scores_*.json")):
        time.sleep(0.01)
    while worker.poll() is None:
        if list(out.glob(f"jobs/.attempt-{worker.pid}-*")):
            worker.send_signal(signal.SIGKILL)
        time.sleep(0.001)


def test_study_finishes_when_one_of_two_workers_is_killed(cli, engine, cluster, tmp_path):
    address, workers = cluster
    (tmp_path / "live").mkdir()
    run(engine, tmp_path / "live", None, [MapsLog(engine, tmp_path / "live" / "maps.h5")])
    (tmp_path / "a").mkdir()
    shutil.move(tmp_path / "live" / "maps.h5", tmp_path / "a" / "maps.h5")
    path, out = tmp_path / "study.toml", tmp_path / "study"
    path.write_text(f'recordings = ["a/maps.h5"]\nseeds = {list(range(JOBS))}\n')
    killer = threading.Thread(target=kill_when_working, args=(workers[0], out), daemon=True)
    killer.start()
    status, output = cli("sweep", path, "--cluster", address)
    killer.join(timeout=10)
    assert workers[0].poll() == -signal.SIGKILL, "the worker was never caught at work"
    assert status == 0, output
    with (out / "summary.csv").open(newline="") as file:
        assert [row["state"] for row in csv.DictReader(file)] == ["done"] * JOBS
    assert len(list(out.glob("jobs/*/tracks.csv"))) == JOBS
