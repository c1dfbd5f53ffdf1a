"""``planview demo`` and ``view``."""

import json
import shutil

import pytest
from toy_run import EMPTY, FRAMES
from toy_stereo import walking

from planview.cli import main
from planview.output.folder import prepare_folder


def test_demo_tracks_its_clip_and_prints_the_metrics(recording, tmp_path, monkeypatch, capsys):
    clip, out = tmp_path / "clip", tmp_path / "out"
    shutil.copytree(recording, clip)
    cards = [(i, walking(i - EMPTY)[0]) for i in range(EMPTY, FRAMES)]
    truth = "".join(f"{i},1,{card.x_m:.3f},{card.y_m:.3f},1.75\n" for i, card in cards)
    (clip / "truth.csv").write_text("frame,id,x_m,y_m,height_m\n" + truth)
    monkeypatch.setattr("planview.commands.run.DEMO", clip)
    with pytest.raises(SystemExit):
        main(["demo", "--out", str(out), "--json"])
    metrics = json.loads(capsys.readouterr().out)
    assert metrics["significant_errors"]["total"] == 0
    assert metrics["position_error_mean_m"] < 0.15
    assert {"tracks.csv", "run.json", "run.rrd", "report.html", "decisions.csv"} <= {f.name for f in out.iterdir()}


def test_demo_without_its_clip_is_refused(refused, tmp_path, monkeypatch):
    monkeypatch.setattr("planview.commands.run.DEMO", tmp_path / "none")
    assert "demo clip" in refused("demo", "--out", tmp_path / "out")


def test_view_of_a_run_without_rerun_recording_is_refused(refused, tmp_path):
    prepare_folder(tmp_path / "out", overwrite=False)
    assert "--rrd" in refused("view", tmp_path / "out")
