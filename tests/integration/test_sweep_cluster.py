"""``planview sweep`` in processes of its own and on those of a cluster, one of which is killed."""

import csv
import os
import re
import signal
import threading
import time
from pathlib import Path

import pytest
from distributed import LocalCluster

from planview.output.run import run
from planview.output.run_spec import RunSpec

pytestmark = pytest.mark.slow
JOBS = 8


def kill_one_at_work(out: Path) -> None:
    """Kill a worker in the middle of a run, when a first run of the study is done."""
    working = []
    while not working or not list(out.glob("jobs/*/scores_*.json")):
        time.sleep(0.001)
        working = list(out.glob("jobs/.attempt-*"))
    found = re.fullmatch(r"\.attempt-(\d+)-.*", working[0].name)
    os.kill(int(found[1]), signal.SIGKILL)


@pytest.mark.parametrize("where", ["here", "on a cluster"])
def test_study_finishes_when_a_worker_is_killed(where, cli, engine, tmp_path):
    run(engine, RunSpec(tmp_path / "a", maps=True))
    path, out = tmp_path / "study.toml", tmp_path / "study"
    path.write_text(f'recordings = ["a/maps.h5"]\nseeds = {list(range(JOBS))}\n')
    killer = threading.Thread(target=kill_one_at_work, args=(out,), daemon=True)
    killer.start()
    if where == "here":
        status, output = cli("sweep", path, "--jobs", 2)
    else:
        with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as cluster:
            status, output = cli("sweep", path, "--cluster", cluster.scheduler_address)
    killer.join(timeout=10)
    assert not killer.is_alive(), "no worker was caught at work"
    assert status == 0, output
    with (out / "summary.csv").open(newline="") as file:
        assert [row["state"] for row in csv.DictReader(file)] == ["done"] * JOBS
    assert len(list(out.glob("jobs/*/tracks.csv"))) == JOBS
