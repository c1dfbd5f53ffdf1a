"""``planview sweep --cluster`` on a real scheduler with two workers on loopback, one of which is killed."""

import csv
import os
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from planview.output.run import run
from planview.output.tables import MapsLog

pytestmark = pytest.mark.slow
distributed = pytest.importorskip("distributed")
JOBS = 8


@pytest.fixture
def cluster() -> Iterator[tuple[str, int]]:
    """Address of a scheduler, and the process of one of its two workers."""
    local = distributed.LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None)
    with local, distributed.Client(local) as client:
        yield local.scheduler_address, next(iter(client.run(os.getpid).values()))


def kill_when_working(worker: int, out: Path) -> None:
    """Kill a worker in the middle of a run, when a first run of the study is done."""
    while not list(out.glob("jobs/*/scores_*.json")) or not list(out.glob(f"jobs/.attempt-{worker}-*")):
        time.sleep(0.001)
    os.kill(worker, signal.SIGKILL)


def test_study_finishes_when_one_of_two_workers_is_killed(cli, engine, cluster, tmp_path):
    address, worker = cluster
    (tmp_path / "live").mkdir()
    run(engine, tmp_path / "live", None, [MapsLog(engine, tmp_path / "live" / "maps.h5")])
    (tmp_path / "a").mkdir()
    shutil.move(tmp_path / "live" / "maps.h5", tmp_path / "a" / "maps.h5")
    path, out = tmp_path / "study.toml", tmp_path / "study"
    path.write_text(f'recordings = ["a/maps.h5"]\nseeds = {list(range(JOBS))}\n')
    killer = threading.Thread(target=kill_when_working, args=(worker, out), daemon=True)
    killer.start()
    status, output = cli("sweep", path, "--cluster", address)
    killer.join(timeout=10)
    assert not killer.is_alive(), "the worker was never caught at work"
    assert status == 0, output
    with (out / "summary.csv").open(newline="") as file:
        assert [row["state"] for row in csv.DictReader(file)] == ["done"] * JOBS
    assert len(list(out.glob("jobs/*/tracks.csv"))) == JOBS
