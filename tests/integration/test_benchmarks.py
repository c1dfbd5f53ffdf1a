"""``python -m benchmarks``: options, tables and JSON of each benchmark, on recordings that are small."""

import json
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cli import one_sentence
from toy_run import EMPTY, FEW, FRAMES
from toy_stereo import walking

Bench = Callable[..., tuple[int, str, str]]
NAMES = ("suite", "claims", "real", "jitter", "things", "speed", "counting", "pets", "calibration", "doctor")
TRUTH = "frame,id,x_m,y_m,height_m\n" + "".join(
    f"{i},1,{walking(i - EMPTY)[0].x_m:.3f},{walking(i - EMPTY)[0].y_m:.3f},1.75\n" for i in range(EMPTY, FRAMES)
)


@pytest.fixture
def bench(capsys, monkeypatch) -> Bench:
    """Run a benchmark in this process: exit status, and what it prints on stdout and stderr."""

    def command(*words):
        monkeypatch.setattr(sys, "argv", ["benchmarks", *map(str, words)])
        status = 0
        try:
            runpy.run_module("benchmarks", run_name="__main__")
        except SystemExit as left:
            status = int(left.code or 0)
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return command


def json_of(result: tuple[int, str, str]) -> dict[str, Any]:
    status, out, err = result
    assert status == 0, err
    return dict(json.loads(out))


@pytest.fixture
def data(copy) -> Path:
    """A folder with one recording that has truth."""
    (copy / "truth.csv").write_text(TRUTH)
    return copy.parent


TINY = """description = "somebody crosses"
fps = 10
duration_s = 6
[rig]
width = 160
height = 120
focal_px = 110
baseline_m = 0.3
at_m = [3, 0.2, 2.3]
tilt_deg = 66
[[people]]
start_m = [0.4, 3]
steps = [{ go = [[5.6, 3]], speed_mps = 1.2 }]
"""


@pytest.fixture
def tiny(tmp_path) -> tuple[object, ...]:
    """Words for the suite of a scene that is rendered in seconds."""
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / "tiny.toml").write_text(TINY)
    return "suite", "--scenes", tmp_path / "scenes", "--cache", tmp_path / "cache", "--json", "--seed"


def test_suite_scores_members_of_a_scene(bench, tiny, tmp_path):
    found = json_of(bench(*tiny, 3, "--seed", 4, "--out", tmp_path / "out"))
    scenes = found["online"]["scenes"]
    assert [(scene["scene"], scene["seed"]) for scene in scenes] == [("tiny", 3), ("tiny", 4)]
    assert all(scene["truth_rows"] > 10 for scene in scenes)
    assert scenes[0]["duration_s"] != scenes[1]["duration_s"]
    assert json.loads((tmp_path / "out" / "suite.json").read_text()) == found
    assert (tmp_path / "out" / "tiny-3" / "tracks.csv").is_file()


def test_suite_works_on_a_member_once(bench, tiny, tmp_path):
    first = json_of(bench(*tiny, 3))
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").rglob("*")}
    assert json_of(bench(*tiny, 3)) == first
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").rglob("*")} == kept


@pytest.mark.parametrize("name", NAMES)
def test_every_benchmark_has_help_with_an_example(bench, name):
    status, out, _ = bench(name, "--help")
    assert status == 0
    assert f"python -m benchmarks {name}" in " ".join(out.split())


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("speed", "--frames", "1"), "--frames"),
        (("speed", "--recording", "nowhere"), "nowhere"),
        (("suite", "--minutes", "0"), "--minutes"),
        (("suite", "--scene", "attic"), "--scene"),
        (("suite", "--scenes", "tests/data"), "--scene"),
        (("counting", "--frames", "0"), "--frames"),
        (("counting", "--rooms", "-1"), "--rooms"),
        (("real", "--data", "nowhere"), "nowhere"),
        (("pets", "nowhere", "--tracker", "ellipse-particle"), "nowhere"),
        (("pets", "nowhere"), "--camera"),
        (("calibration", "--only", "nothing"), "--only"),
    ],
)
def test_what_cannot_be_run_is_refused_in_a_sentence(bench, words, named):
    status, _, err = bench(*words)
    assert status == 2
    assert named in one_sentence(err)


def test_real_scores_a_tracker_next_to_the_baseline(bench, data):
    rows = json_of(bench("real", "--data", data, "--set", FEW, "--json"))["scores"]
    assert [(row["recording"], row["tracker"]) for row in rows] == [("copy", "joint"), ("copy", "peaks")]
    assert rows[0]["people"] == rows[0]["ids"] == 1
    assert rows[0]["judged"] == rows[0]["positions"] == FRAMES - EMPTY


def test_real_prints_a_row_per_tracker(bench, data):
    status, out, _ = bench("real", "--data", data, "--set", FEW)
    head, first, second, *_ = out.splitlines()
    assert status == 0
    assert head.split()[:4] == ["recording", "tracker", "right", "number"]
    assert (first.split()[1], second.split()[1]) == ("joint", "peaks")


def test_speed_times_every_stage(bench, data):
    tables = json_of(bench("speed", "--recording", data / "copy", "--frames", 20, "--set", FEW, "--json"))
    stages = {row["stage"] for row in tables["stages"]}
    assert {"all", "match", "foreground", "track"} <= stages
    assert sum(row["frames"] for row in tables["people"]) == FRAMES // 2
