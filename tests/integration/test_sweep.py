"""``planview sweep``: studies over recordings, configurations and seeds."""

import csv
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from cli import one_sentence
from distributed import Client, LocalCluster
from toy_run import EMPTY, FRAMES, run_few
from toy_stereo import walking

from planview.output.run import run
from planview.output.run_spec import RunSpec

TRUTH = "frame,id,x_m,y_m,height_m\n" + "".join(
    f"{i},1,{walking(i - EMPTY)[0].x_m:.3f},{walking(i - EMPTY)[0].y_m:.3f},1.75\n" for i in range(EMPTY, FRAMES)
)


@pytest.fixture(scope="module", autouse=True)
def worker() -> Iterator[None]:
    """One Dask worker in this process does all runs: it starts at once."""
    local = LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None)
    with local as cluster, pytest.MonkeyPatch.context() as patch:
        patch.setattr("planview.api.sweep.workers", lambda *_: Client(cluster))
        yield


@pytest.fixture(scope="module")
def toy_maps(engine, tmp_path_factory) -> Path:
    """The plan-view recording of the toy recording."""
    folder = tmp_path_factory.mktemp("maps")
    run(engine, RunSpec(folder, maps=True))
    return folder / "maps.h5"


@pytest.fixture
def halls(toy_maps, tmp_path) -> Path:
    """Folders a and b, each with maps.h5 and truth."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        shutil.copy(toy_maps, tmp_path / name / "maps.h5")
        (tmp_path / name / "truth.csv").write_text(TRUTH)
    return tmp_path


def study(folder: Path, text: str) -> Path:
    path = folder / "study.toml"
    path.write_text(text)
    return path


def rows(out: Path) -> list[dict[str, str]]:
    with (out / "summary.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def made(out: Path) -> dict[Path, int]:
    """Runs and plan-view recordings, and when they were made."""
    return {path: path.stat().st_mtime_ns for path in out.glob("*/*/run.json")}


def test_study_does_no_run_twice(succeed, halls):
    text = 'recordings = ["a/maps.h5"]\n[parameters]\njoint.stay_s = [0.35, {}]\n'
    path, out = study(halls, text.format(0.4)), halls / "study"
    succeed("sweep", path)
    first = made(out)
    assert len(first) == 2
    succeed("sweep", path)
    assert made(out) == first
    study(halls, text.format(0.45))
    succeed("sweep", path)
    assert len(made(out)) == 3
    assert made(out).items() > first.items()
    assert [(r["joint.stay_s"], r["state"]) for r in rows(out)] == [("0.35", "done"), ("0.45", "done")]


def test_study_gives_the_tracks_of_a_plain_run(succeed, copy, tmp_path):
    (tmp_path / "c.toml").write_text("[analysis]\nsetup_frames = 4\n")
    run_few(succeed, copy, tmp_path / "plain")
    path = study(tmp_path, 'recordings = ["copy"]\nconfig = "c.toml"\n')
    succeed("sweep", path)
    (tracks,) = (tmp_path / "study").glob("jobs/*/tracks.csv")
    assert tracks.read_bytes() == (tmp_path / "plain" / "tracks.csv").read_bytes()


def test_recordings_of_one_name_do_not_get_each_others_results(succeed, halls):
    out = halls / "out"
    with (halls / "b" / "maps.h5").open("ab") as file:
        file.write(b"\0")
    succeed("sweep", halls / "a" / "maps.h5", "--out", out)
    folder_of_a = rows(out)[0]["folder"]
    succeed("sweep", halls / "b" / "maps.h5", "--out", out)
    assert rows(out)[0]["folder"] != folder_of_a


def test_recordings_of_equal_content_are_scored_against_their_own_truth(succeed, halls):
    (halls / "b" / "truth.csv").write_text(TRUTH.replace(",1,", ",7,").replace("1.75", "1.95"))
    succeed("sweep", halls / "a" / "maps.h5", halls / "b" / "maps.h5", "--out", halls / "out")
    errors = [float(row["height_error_mean_m"]) for row in rows(halls / "out")]
    assert abs(errors[1] - errors[0]) > 0.1


def test_bad_recordings_do_not_stop_the_others(cli, halls):
    (halls / "b" / "maps.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    path = study(halls, 'recordings = ["b/maps.h5", "none", "a/maps.h5"]\nseeds = [0, 1]\n')
    status, output = cli("sweep", path)
    assert status == 1
    assert one_sentence(output) == "planview: 4 of 6 runs failed; the others are done"
    assert "failed: none, defaults, seed 0:" in output
    assert [row["state"] for row in rows(halls / "study")] == ["failed"] * 4 + ["done"] * 2
    (halls / "b" / "maps.h5").write_bytes((halls / "a" / "maps.h5").read_bytes())
    assert "2 of 6 runs failed" in cli("sweep", path)[1]


def test_sweep_prints_the_figures_of_each_configuration(halls, shown_by):
    path = study(halls, 'recordings = ["a/maps.h5"]\n[parameters]\njoint.stay_s = [0.5]\n')
    text = shown_by("sweep", path)
    assert text.split()[:2] == ["runs", "mota"]
    assert "joint.stay_s=0.5" in text


def test_json_has_every_run_with_its_figures(halls, json_of):
    path = study(halls, 'recordings = ["a/maps.h5"]\n')
    found = json_of("sweep", path)
    (only,) = found["runs"]
    assert found["failed"] == 0
    assert only["error"] is None
    assert only["mota"] == pytest.approx(float(rows(halls / "study")[0]["mota"]), rel=1e-5)


@pytest.mark.parametrize("vary", ["maps.no_such=1,2", "maps.cell_m", "maps.cell_m=0.03,0.03", "seed=x", "seed=-1"])
def test_sweep_refuses_wrong_settings_before_it_runs(cli, copy, tmp_path, vary):
    status, output = cli("sweep", copy, "--out", tmp_path / "sweep", "--vary", vary)
    assert status == 2
    assert one_sentence(output)
    assert not (tmp_path / "sweep").exists()


def test_what_killed_processes_left_is_removed(succeed, halls):
    left = halls / "out" / "jobs" / ".attempt-4194305-0"
    left.mkdir(parents=True)
    succeed("sweep", halls / "a" / "maps.h5", "--out", halls / "out")
    assert not left.exists()
