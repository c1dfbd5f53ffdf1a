"""The demo clip: ``planview demo`` and ``view``, at half its rate, and checks that it passes."""

import json
import re
import shutil
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from toy_run import EMPTY, FRAMES
from toy_stereo import walking

import planview
from planview.checks.examine import examine
from planview.cli import main
from planview.engine.config import Config
from planview.engine.open import engine_of
from planview.engine.setup import set_up
from planview.evaluation.evaluate import evaluate_tracks
from planview.output.folder import prepare_folder
from planview.synthetic.assets import DEMO
from planview.trajectories.table import TrajectoryCollector, read_truth
from stereo.readers import open_recording
from stereo.recording import Frame, Recording, Shot, StereoPair
from tools.pictures import FACTS, demo_facts


def test_demo_prints_the_metrics_of_its_clip(recording, tmp_path, monkeypatch, json_of):
    clip, out = tmp_path / "clip", tmp_path / "out"
    shutil.copytree(recording, clip)
    cards = [(i, walking(i - EMPTY)[0]) for i in range(EMPTY, FRAMES)]
    truth = "".join(f"{i},1,{card.x_m:.3f},{card.y_m:.3f},1.75\n" for i, card in cards)
    (clip / "truth.csv").write_text("frame,id,x_m,y_m,height_m\n" + truth)
    monkeypatch.setattr("planview.commands.run.DEMO", clip)
    metrics = json_of("demo", "--out", out)
    assert metrics["significant_errors"]["total"] == 0
    assert metrics["position_error_mean_m"] < 0.15
    assert {"tracks.csv", "run.json", "run.rrd", "report.html", "decisions.csv"} <= {f.name for f in out.iterdir()}


@pytest.mark.slow
def test_readme_shows_what_the_demo_prints(tmp_path, monkeypatch, capsys):
    readme = (DEMO.parents[2] / "README.md").read_text("utf-8")
    block = re.search(r"The demo prints.*?```\n(.*?)\n```", readme, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setattr(sys, "stderr", sys.stdout)
    with pytest.raises(SystemExit):
        main(["demo"])
    printed = "\n".join(line.rstrip() for line in capsys.readouterr().out.splitlines())
    assert set(without_times(block[1]).splitlines()) <= set(without_times(printed).splitlines())


@pytest.mark.slow
def test_pictures_of_the_documents_show_whom_a_run_finds():
    facts = json.loads(FACTS.read_text("utf-8"))
    assert facts | demo_facts(planview.run(DEMO)) == facts


def without_times(text: str) -> str:
    """A printed summary with the numbers that differ from run to run replaced."""
    text = re.sub(r"tracked in \d+ s", "tracked in N s", text)
    return re.sub(r"^ms per frame.*$", lambda line: re.sub(r"[\d.]+", "N", line[0]), text, flags=re.MULTILINE)


def test_demo_without_its_clip_is_refused(refused, tmp_path, monkeypatch):
    monkeypatch.setattr("planview.commands.run.DEMO", tmp_path / "none")
    assert "demo clip" in refused("demo", "--out", tmp_path / "out")


def test_view_without_a_rerun_recording_is_refused(refused, tmp_path):
    prepare_folder(tmp_path / "out", overwrite=False)
    assert "--rrd" in refused("view", tmp_path / "out")


class EverySecondFrame:
    """A recording without its odd frames, with the timestamps of the even ones."""

    def __init__(self, recording: Recording[StereoPair]) -> None:
        self._recording = recording

    def __iter__(self) -> Iterator[Frame[Shot]]:
        for frame in self._recording:
            if frame.index % 2 == 0:
                yield replace(frame, index=frame.index // 2)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._recording, name)


@pytest.mark.slow
def test_demo_clip_at_half_its_frame_rate_is_tracked_without_a_significant_error():
    recording, config, tracks = open_recording(DEMO), Config(), TrajectoryCollector()
    for result in engine_of(EverySecondFrame(recording), config=config, setup=set_up(recording, config)):
        tracks.add(result.frame, result.timestamp_s, result.tracks)
    truth = read_truth(DEMO / "truth.csv")
    truth = truth.where(truth.frame % 2 == 0)
    scores = evaluate_tracks(tracks.trajectories(), replace(truth, frame=truth.frame // 2))
    assert not scores.significant
    assert scores.position_error_m.mean() < 0.075


def failures(folder: Path) -> dict[str, float]:
    return {check.name: check.value for check in examine(folder).checks if not check.ok}


@pytest.mark.slow
def test_check_passes_the_committed_clip():
    assert failures(DEMO) == {}


@pytest.mark.slow
def test_check_passes_the_real_overhead_pair(shared_data):
    diagnosis = examine(shared_data / "overhead-stereo")
    values = {check.name: check.value for check in diagnosis.checks}
    assert not [check for check in diagnosis.checks if check.failed]
    assert values["row offset"] > 0.3
    assert values["row residual"] < 0.2
    assert values["camera height"] == pytest.approx(2.74, abs=0.05)
    assert 1.5 < values["person height"] < 1.9
