"""A good recording damaged in many ways: a clear sentence or a counted skip, the right status, and nothing lost."""

import os
import re
import shutil
from pathlib import Path

import pytest
from cli import contents
from faults.damage import FRAMES
from faults.faults import FAULTS
from toy_stereo import ToyWorld, toy_rig, walking, write_toy_recording

from calib.rig import Floor
from calib.world import save_world
from planview.output.folder import read_run_info
from planview.trajectories.table import read_tracks

pytestmark = pytest.mark.slow
FEW = ("--set", "analysis.setup_frames=4")
NOTES = "notes of another program"


@pytest.fixture(scope="session")
def good(tmp_path_factory) -> Path:
    """30 frames of 160x120 in which a person walks."""
    world, rig = ToyWorld(), toy_rig((160, 120), 115.0, 0.12)
    pairs = [world.pair(rig, walking(i), i) for i in range(FRAMES)]
    folder = write_toy_recording(tmp_path_factory.mktemp("faults") / "good", rig, pairs)
    save_world(Floor(world.world_SE3_left), folder / "world.toml")
    return folder


@pytest.fixture(autouse=True)
def no_report(monkeypatch) -> None:
    """Plots cost more than the run. The name is patched where it is used: a command that is imported for the first time
    while the module of the page is patched would keep the patch for all later tests."""
    monkeypatch.setattr("planview.output.run.write_report", lambda folder: None)


def test_there_are_at_least_sixty_faults():
    assert len({fault.name for fault in FAULTS}) == len(FAULTS) >= 60


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_fault(fault, good, tmp_path, cli):
    recording, out = tmp_path / "recording", tmp_path / "out"
    shutil.copytree(good, recording)
    out.mkdir()
    (out / "notes.txt").write_text(NOTES)
    fault.damage(recording)
    words = [word.replace("{}", str(recording)) for word in fault.words]
    status, printed = cli("run", recording, "--out", out, *FEW, *words)
    assert status == fault.status, printed
    assert "Traceback" not in printed
    assert (out / "notes.txt").read_text() == NOTES
    sentences = [line for line in printed.splitlines() if line.startswith("planview: ")]
    if fault.status:
        assert len(sentences) == 1 and re.search(fault.message, sentences[0]), printed
        assert not (out / "run.json").exists() or not read_run_info(out / "run.json").finished
        return
    assert not sentences
    info = read_run_info(out / "run.json")
    assert info.finished
    if not fault.name.startswith("video"):
        assert (info.frames_read, info.frames_skipped) == (FRAMES - fault.skipped, fault.skipped), info.skipped
    assert {warning.name for warning in info.warnings} >= ({fault.warns} if fault.warns else set())
    read_tracks(out / "tracks.csv")


def test_good_recording_runs_without_a_warning(good, tmp_path, succeed):
    succeed("run", good, "--out", tmp_path / "out", "--strict", *FEW)
    info = read_run_info(tmp_path / "out" / "run.json")
    assert info.warnings == []
    assert info.frames_read == FRAMES


@pytest.mark.parametrize("name", ["caf\udce9", "a\x1b]0;owned\x07b", "[red]x[/]", "-x y"], ids=ascii)
def test_folder_names_of_any_kind_stay_text(good, tmp_path, succeed, name):
    shutil.copytree(good, tmp_path / name)
    printed = succeed("run", tmp_path / name, "--out", tmp_path / f"{name}-out", *FEW)
    assert "\x1b]" not in printed
    assert "\x07" not in printed
    assert read_run_info(tmp_path / f"{name}-out" / "run.json").finished


def test_finished_run_survives_every_refusal(good, tmp_path, cli, succeed):
    out = tmp_path / "out"
    succeed("run", good, "--out", out, *FEW)
    before = contents(out)
    recording = tmp_path / "recording"
    shutil.copytree(good, recording)
    (recording / "rig.toml").unlink()
    refused = [
        ("run", good, "--out", out),
        ("run", recording, "--out", out, "--overwrite"),
        ("run", good, "--out", out, "--overwrite", "--set", "maps.cell_m=0"),
        ("run", good, "--out", out / "tracks.csv"),
        ("run", tmp_path / "none", "--out", out, "--overwrite"),
        ("run", os.devnull, "--out", out, "--overwrite"),
    ]
    for words in refused:
        status, printed = cli(*words)
        assert status == 2 and printed.startswith("planview: "), printed
    assert contents(out) == before
