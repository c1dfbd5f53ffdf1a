"""``planview run``, stopped in its middle and resumed: the results of a run that was left alone."""

from pathlib import Path

import pytest
from toy_run import FEW, Say, one_sentence

from planview.counting.rules import load_rules
from planview.counting.stream import Analytics
from planview.engine.engine import FrameResult
from planview.engine.pipeline import Pipeline
from planview.output.folder import read_run_info
from planview.output.maps_log import MapsLog
from planview.output.resume import checkpoint_of
from planview.output.run import RunOptions, run, run_identity

RULES = '[[zone]]\nname = "all"\npolygon_m = [[-9, -9], [9, -9], [9, 9], [-9, 9]]\nmin_age_s = 0.0\n'
RESULTS = ("tracks.csv", "events.csv", "decisions.csv", "counts.json")
FREQUENT_S = 1e-9


class StoppedError(Exception):
    """What ends a run in these tests."""


def options_with(rules: Path) -> RunOptions:
    return RunOptions(analytics=Analytics(load_rules(rules)), debug=True, checkpoint_every_s=FREQUENT_S)


def stop_at(frame: int) -> object:
    def watch(result: FrameResult) -> None:
        if result.frame == frame:
            raise StoppedError

    return watch


@pytest.fixture
def rules(tmp_path: Path) -> Path:
    (tmp_path / "rules.toml").write_text(RULES)
    return tmp_path / "rules.toml"


@pytest.mark.parametrize("frame", [2, 20])
def test_a_resumed_run_writes_what_an_uninterrupted_one_writes(
    engine: Pipeline, tmp_path: Path, rules: Path, frame: int
) -> None:
    alone, stopped = tmp_path / "alone", tmp_path / "stopped"
    run(engine, alone, options_with(rules), [MapsLog(engine, folder_of(alone) / "maps.h5")])
    with pytest.raises(StoppedError):
        run(engine, stopped, options_with(rules), [MapsLog(engine, folder_of(stopped) / "maps.h5")], stop_at(frame))
    assert read_run_info(stopped / "run.json").state == "interrupted"

    options, told = options_with(rules), []
    checkpoint = checkpoint_of(stopped, run_identity(engine, options, ["MapsLog"], stopped), told.append)
    assert checkpoint is not None
    log = MapsLog(engine, stopped / "maps.h5", checkpoint.written["logs"]["MapsLog"])
    info = run(engine, stopped, options, [log], None, checkpoint)
    assert told == []
    assert (info.state, info.frames_read) == ("finished", engine.recording.n_frames)
    for name in RESULTS:
        assert (stopped / name).read_bytes() == (alone / name).read_bytes()
    assert '"all"' in (stopped / "counts.json").read_text()
    assert {file.name for file in stopped.iterdir()} == {file.name for file in alone.iterdir()}


def folder_of(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    return folder


def test_rows_that_were_changed_since_the_checkpoints_are_not_gone_on_from(
    engine: Pipeline, tmp_path: Path, rules: Path
) -> None:
    with pytest.raises(StoppedError):
        run(engine, tmp_path, options_with(rules), (), stop_at(30))
    (tmp_path / "tracks.csv").write_text("frame\n")
    told: list[str] = []
    assert checkpoint_of(tmp_path, run_identity(engine, options_with(rules), [], tmp_path), told.append) is None
    assert [text.count("changed since") for text in told] == [1, 1, 0]


def test_another_recording_or_option_is_not_gone_on_with(say: Say, copy: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert (
        say("run", copy, "--out", out, "--set", FEW, "--frames", 3, "--set", f"run.checkpoint_every_s={FREQUENT_S}")[0]
        == 0
    )
    (out / "run.json").write_text((out / "run.json").read_text().replace('"finished": true', '"finished": false'))
    status, told = say("run", copy, "--out", out, "--set", "analysis.setup_frames=5", "--resume")
    assert status == 2
    assert "expected the beginning of this run, found another" in one_sentence(told)
