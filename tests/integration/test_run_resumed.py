"""``planview run``, stopped in its middle and resumed: the results of a run that was left alone."""

from collections.abc import Callable
from contextlib import suppress
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli import contents
from crossing_video import CAMERA, CrossingVideo
from rerun.chunk import RrdReader
from toy_run import FEW, run_few

import planview
from calib.errors import InputError
from calib.types import F32, U8
from planview.engine.config import load_config
from planview.engine.engine import Engine
from planview.engine.open import engine_of, open_engine
from planview.engine.setup import set_up
from planview.maps.recording import MapsRecording
from planview.output.folder import read_run_info, rrd_parts
from planview.output.resume import (
    CHECKPOINT,
    Checkpoint,
    UnidentifiedError,
    checkpoint_of,
    difference,
    read_checkpoint,
    write_checkpoint,
)
from planview.output.run import run
from planview.output.run_spec import RunSpec
from planview.output.tables import MapsLog
from planview.tracking.base import Tracker
from planview.tracking.detections import BoxTracker, DetectionParams, DetectionTracker
from planview.tracking.ellipse_particle import EllipseParticleTracker
from planview.tracking.human_model import HumanModelParams
from planview.tracking.human_model.model_map import HumanModelMapParams, build_model_map
from planview.tracking.human_model.tracker import HumanModelTracker
from planview.tracking.joint import JointTracker
from planview.tracking.template import TemplateTracker
from planview.trajectories.detections import Detections
from stereo.matcher import Matcher

RULES = (
    '[[zone]]\nname = "all"\npolygon_m = [[-9, -9], [9, -9], [9, 9], [-9, 9]]\nmin_age_s = 0.0\n'
    '[[queue]]\nname = "waiting"\nzone = "all"\n'
    '[[tripwire]]\nname = "door"\nfrom_m = [-9, 3]\nto_m = [9, 3]\n'
)
RESULTS = ("tracks.csv", "events.csv", "decisions.csv", "counts.json")
FREQUENT_S = 1e-9


class StoppedError(Exception):
    """What ends a run in these tests."""


def spec_with(rules: Path, out: Path, **others: Any) -> RunSpec:
    return RunSpec(out, rules=rules, checkpoint_every_s=FREQUENT_S, **others)


def stop_at(frame: int | None) -> object:
    def watch(result):
        if result.frame == frame:
            raise StoppedError

    return watch


@pytest.fixture
def rules(tmp_path) -> Path:
    (tmp_path / "rules.toml").write_text(RULES)
    return tmp_path / "rules.toml"


@pytest.mark.parametrize(
    "stops", [pytest.param((2,), marks=pytest.mark.slow), (20,), pytest.param((5, 20), marks=pytest.mark.slow)]
)
def test_a_resumed_run_writes_what_an_uninterrupted_one_writes(engine, tmp_path, rules, stops, monkeypatch, recwarn):
    monkeypatch.setattr("planview.checks.scene.VALID_SHARE_MIN", 2.0)  # a warning with a value of all frames
    alone = spec_with(rules, tmp_path / "alone", maps=True)
    stopped = spec_with(rules, tmp_path / "stopped", maps=True)
    run(engine, alone)
    with pytest.raises(StoppedError):
        run(engine, stopped, [stop_at(stops[0])])
    assert read_run_info(stopped.folder / "run.json").state == "interrupted"

    for stop in (*stops[1:], None):
        assert checkpoint_of(stopped.folder, stopped.identity(engine)) is not None
        with suppress(StoppedError):
            info = run(engine, replace(stopped, resume=True), [stop_at(stop)])
    assert not [one for one in recwarn if "run starts again" in str(one.message)]
    assert (info.state, info.frames_read) == ("finished", engine.recording.n_frames)
    for name in RESULTS:
        assert (stopped.folder / name).read_bytes() == (alone.folder / name).read_bytes()
    assert '"all"' in (stopped.folder / "counts.json").read_text()
    assert "valid disparity" in str(outcome(alone.folder)["warnings"])
    assert outcome(stopped.folder) == outcome(alone.folder)
    assert {file.name for file in stopped.folder.iterdir()} == {file.name for file in alone.folder.iterdir()}


def outcome(folder: Path) -> dict[str, Any]:
    """run.json without the times that the run took."""
    return read_run_info(folder / "run.json").model_dump(exclude={"started_at", "elapsed_s", "stages_ms"})


def test_a_run_of_few_frames_counts_from_the_beginning(engine, tmp_path, rules):
    whole = spec_with(rules, tmp_path / "whole")
    assert run(engine, whole).counts["rules"]["all"]["people"] > 0
    few = replace(whole, out=tmp_path / "few", last_frame=2)  # before anybody is confirmed
    assert run(engine, few).counts["rules"]["all"]["people"] == 0


@pytest.mark.parametrize("change", [lambda text: "frame\n", lambda text: text.replace(",confirmed,", ",tentative,")])
def test_a_table_that_was_changed_since_the_checkpoint_is_not_resumed_from(engine, tmp_path, rules, change):
    with pytest.raises(StoppedError):
        run(engine, spec_with(rules, tmp_path), [stop_at(30)])
    (tmp_path / "tracks.csv").write_text(change((tmp_path / "tracks.csv").read_text()))
    with pytest.warns(UserWarning, match="changed since|starts again") as output:
        assert checkpoint_of(tmp_path, spec_with(rules, tmp_path).identity(engine)) is None
    assert [str(one.message).count("changed since") for one in output] == [1, 0]


def test_another_recording_or_option_is_not_resumed_with(succeed, refused, copy, tmp_path):
    out = tmp_path / "out"
    run_few(succeed, copy, out, "--frames", "3", "--checkpoint-every", FREQUENT_S)
    (out / "run.json").write_text((out / "run.json").read_text().replace('"finished": true', '"finished": false'))
    output = refused("run", copy, "--out", out, "--set", "analysis.setup_frames=5", "--resume")
    assert "holds a run with another configuration (analysis" in output


class OwnMatcher:
    """A matcher of the user's; nothing has a disparity."""

    def __init__(self, identity: str = "") -> None:
        self.identity = identity

    def __call__(self, left_grey: U8, right_grey: U8) -> F32:
        return np.full(left_grey.shape, np.nan, np.float32)


class OwnTracker(JointTracker):
    """A tracker of the user's."""

    identity = ""


def engine_with(engine: Engine, matcher: Matcher | None = None, tracker: Tracker | None = None) -> Engine:
    """The engine with parts of the user's own, without looking for the floor again."""
    setup = replace(engine.sensors[0].rig, matcher=matcher)
    return engine_of(engine.recording, tracker or "joint", engine.config, setup=setup)


@pytest.mark.parametrize("part", ["matcher", "tracker", "by hand"])
def test_a_run_with_a_part_that_cannot_be_identified_writes_no_checkpoints(engine, tmp_path, part):
    own = {
        "matcher": lambda: engine_with(engine, OwnMatcher()),
        "tracker": lambda: engine_with(engine, tracker=OwnTracker()),
        "by hand": lambda: Engine(engine.recording, engine.config, engine.sensors, JointTracker()),
    }[part]()
    spec = RunSpec(tmp_path, last_frame=1, checkpoint_every_s=FREQUENT_S)
    with pytest.warns(UserWarning, match="'identity'"):
        run(own, spec)
    with pytest.raises(UnidentifiedError):
        spec.identity(own)


def test_the_parts_of_the_users_own_are_named_in_run_json(engine, tmp_path):
    tracker = OwnTracker()
    tracker.identity = "v2"
    run(engine_with(engine, OwnMatcher(), tracker), RunSpec(tmp_path, last_frame=0))
    info = read_run_info(tmp_path / "run.json")
    assert (info.tracker, info.own_parts) == ("OwnTracker", {"matcher": "OwnMatcher", "tracker": "OwnTracker v2"})


@pytest.fixture
def matched(copy, tmp_path) -> Path:
    """The folder of a run with a matcher of the user's own."""
    folder = tmp_path / "matched"
    planview.run(copy, out=folder, matcher=OwnMatcher("one"), frames=5, config={"analysis.setup_frames": 4})
    return folder


def test_a_run_with_a_matcher_of_the_users_own_is_replayed_with_it(matched):
    replayed = planview.replay(matched, 3, matcher=OwnMatcher("one"))
    assert "tracks are the same up to this frame" in replayed.text


def test_another_matcher_does_not_replay_a_run(matched):
    with pytest.raises(InputError, match="OwnMatcher two"):
        planview.replay(matched, 3, matcher=OwnMatcher("two"))


def stop_with_matcher(engine: Engine, folder: Path, identity: str, **options: Any) -> None:
    with pytest.raises(StoppedError):
        run(engine_with(engine, OwnMatcher(identity)), RunSpec(folder, **options), [stop_at(3)])


@pytest.mark.parametrize("every_s", [FREQUENT_S, 0.0])
def test_another_matcher_or_none_does_not_resume_a_run(engine, tmp_path, every_s):
    stop_with_matcher(engine, tmp_path, "one", checkpoint_every_s=every_s)
    for other in (engine, engine_with(engine, OwnMatcher("two"))):
        with pytest.raises(InputError, match=r"another part \(matcher\)"):
            checkpoint_of(tmp_path, RunSpec(tmp_path).identity(other))


def test_a_matcher_with_the_same_identity_resumes_a_run(engine, tmp_path):
    stop_with_matcher(engine, tmp_path, "one", checkpoint_every_s=FREQUENT_S)
    again = engine_with(engine, OwnMatcher("one"))
    assert checkpoint_of(tmp_path, RunSpec(tmp_path).identity(again)) is not None


def test_a_run_of_another_part_of_the_recording_is_not_begun_again(engine, tmp_path):
    with pytest.raises(StoppedError):
        run(engine, RunSpec(tmp_path, first_frame=2), [stop_at(5)])
    with pytest.raises(InputError, match=r"another settings \(first_frame\)"):
        checkpoint_of(tmp_path, RunSpec(tmp_path).identity(engine))


def test_a_run_resumes_although_files_next_to_it_have_changed(copy, tmp_path, rules):
    config = load_config(None, [FEW])
    with pytest.raises(StoppedError):
        run(open_engine(copy, config=config), spec_with(rules, tmp_path / "out"), [stop_at(5)])
    (copy / "README.md").write_text("# What this is\n")
    (copy / "notes.txt").write_text("rain\n")
    (copy / "hall.jpg").write_bytes(b"a picture of the place")
    (copy / "loop").symlink_to(".")
    renamed = rules.rename(rules.with_name("door.toml"))
    identity = spec_with(renamed, tmp_path / "out").identity(open_engine(copy, config=config))
    assert checkpoint_of(tmp_path / "out", identity) is not None


def test_another_image_or_calibration_is_another_recording(copy, tmp_path):
    config = load_config(None, [FEW])

    def identity():
        return RunSpec().identity(open_engine(copy, config=config))

    before = identity()
    assert difference(before, identity()) == ""
    image = sorted((copy / "left").iterdir())[3]
    image.write_bytes(image.read_bytes() + b"more")
    assert "recording (images)" in difference(before, identity())


@pytest.mark.parametrize("left", [["run.json", "run.rrd", "maps.h5.part"], ["run.json.part"]])
def test_a_run_that_was_killed_before_its_first_checkpoint_starts_again(succeed, copy, tmp_path, left):
    out = tmp_path / "out"
    run_few(succeed, copy, out, "--frames", "3")
    kept = (out / "run.json").read_text().replace('"finished": true', '"finished": false')
    tracks = (out / "tracks.csv").read_bytes()
    for file in out.iterdir():
        file.unlink()
    for name in left:
        (out / name).write_text(kept if name == "run.json" else "half")
    run_few(succeed, copy, out, "--frames", "3", "--resume")
    assert (out / "tracks.csv").read_bytes() == tracks
    assert not (out / "maps.h5.part").exists()


@pytest.mark.parametrize("refine", [[], ["--refine"]])
def test_what_a_kill_after_the_last_frame_left_undone_is_done(succeed, copy, tmp_path, refine):
    out = tmp_path / "out"
    words = ("run", copy, "--out", out, "--set", FEW, *refine)
    succeed(*words)
    whole = contents(out)
    (out / "report.html").unlink()
    for name in (CHECKPOINT, CHECKPOINT + ".part"):
        (out / name).write_bytes(b"half")
    if refine:  # between run.json and the tracks
        (out / "tracks.csv").write_bytes((out / "tracks_online.csv").read_bytes())
        (out / "refinement.csv").unlink()
    assert "nothing is left" not in succeed(*words, "--resume")
    found = contents(out)
    assert found.keys() == whole.keys()
    assert found["tracks.csv"] == whole["tracks.csv"]
    assert "nothing is left to resume" in succeed(*words, "--resume")


def test_a_finished_run_of_other_settings_is_not_taken_for_the_one_that_is_resumed(succeed, refused, copy, tmp_path):
    out = tmp_path / "out"
    run_few(succeed, copy, out, "--frames", "3")
    before = contents(out)
    assert "another configuration (joint)" in refused(
        "run", copy, "--out", out, "--set", FEW, "--set", "joint.stay_s=0.7", "--resume"
    )
    assert contents(out) == before


def test_a_run_that_was_killed_before_it_was_refined_is_refined(succeed, copy, tmp_path):
    out = tmp_path / "out"
    run_few(succeed, copy, out)
    words = ("run", copy, "--out", out, "--set", FEW, "--resume", "--refine")
    assert "nothing is left" not in succeed(*words)
    assert read_run_info(out / "run.json").refined
    assert (out / "tracks_online.csv").is_file()
    assert "nothing is left to resume" in succeed(*words)


def rows_of(recording: Path) -> dict[tuple[str, int | None], dict[str, object]]:
    """What a recording shows at every frame, and at all of them (None), but when it was made and the time it took."""
    found = {}
    for part in rrd_parts(recording):
        for chunk in RrdReader(part).stream():
            if not chunk.entity_path.startswith(("/time_ms", "/__properties")):
                for row in chunk.to_record_batch().to_pylist():
                    values = {name: value for name, value in row.items() if ":" in name and value is not None}
                    found.setdefault((chunk.entity_path, row.get("frame")), {}).update(values)
    return found


@pytest.mark.slow
def test_the_rerun_recording_of_a_run_stopped_twice_shows_what_one_left_alone_shows(engine, tmp_path, rules):
    out = tmp_path / "out"
    alone = tmp_path / "alone"
    run(engine, spec_with(rules, alone, rrd_every=1))
    for frame in (12, 24, None):
        with suppress(StoppedError):
            run(engine, spec_with(rules, out, rrd_every=1, resume=frame != 12), [stop_at(frame)])
    assert len(rrd_parts(out / "run.rrd")) == 3
    assert rows_of(out / "run.rrd") == rows_of(alone / "run.rrd")


PARAMS = HumanModelParams(map=HumanModelMapParams(min_height_px=12))
MAP = build_model_map(CAMERA, params=PARAMS.map)


def through_a_file(state: dict[str, Any], folder: Path) -> dict[str, Any]:
    """As it comes back from a checkpoint."""
    write_checkpoint(folder, Checkpoint({}, {}, state))
    return read_checkpoint(folder / CHECKPOINT).state


def assert_resumes(make: Callable[[], Engine], moments: tuple[int, ...], folder: Path) -> None:
    """Resume a run at each of the moments (frames), in another engine by a checkpoint, then twice in the same engine,
    and compare all that follows, bit for bit."""
    engine = make()
    engine.reset()
    lines, saved = [], {}
    for n, result in enumerate(engine.after(-1)):
        lines.append(repr((result.frame, result.tracks, result.decisions)))
        if n in moments:
            saved[n] = result.frame, engine.state()
    assert any("confirmed" in line for line in lines)
    for n, (frame, memory) in saved.items():
        for again, state in ((make(), through_a_file(memory, folder)), (engine, memory), (engine, memory)):
            again.set_state(state)
            assert [repr((r.frame, r.tracks, r.decisions)) for r in again.after(frame)] == lines[n + 1 :]


def moments(seed: int, first: int, last: int, count: int = 3) -> tuple[int, ...]:
    return tuple(int(n) for n in np.random.default_rng(seed).integers(first, last, count))


@pytest.mark.parametrize("tracker", [JointTracker, TemplateTracker])
def test_a_stereo_engine_resumes(engine, tmp_path, tracker):
    c, setup = engine.config, set_up(engine.recording, engine.config)
    assert_resumes(lambda: engine_of(engine.recording, tracker(), c, setup=setup), moments(1, 8, 35), tmp_path)


@pytest.mark.slow
def test_the_engine_of_two_rigs_resumes(engine, sensors, tmp_path):
    assert_resumes(lambda: open_engine(sensors, config=engine.config), moments(5, 8, 35, 2), tmp_path)


def test_the_engine_of_recorded_maps_resumes(engine, tmp_path):
    log = MapsLog(engine, tmp_path / "maps.h5")
    for result in engine:
        log.frame(result)
    log.close()

    def make():
        return engine_of(MapsRecording(tmp_path / "maps.h5"))

    assert_resumes(make, moments(2, 8, 35), tmp_path)


def test_the_engine_of_one_camera_resumes(tmp_path):
    def make():
        return engine_of(CrossingVideo(), HumanModelTracker(PARAMS, CAMERA, MAP), camera=CAMERA)

    assert_resumes(make, moments(3, 2, 58), tmp_path)


@pytest.mark.parametrize("overview", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_ellipse_engine_of_one_camera_resumes(overview, tmp_path):
    def make():
        return engine_of(CrossingVideo(), EllipseParticleTracker(), study=overview)

    assert_resumes(make, moments(4, 2, 58), tmp_path)


BOXES = Detections.of([np.array([[10.0 + 2 * n, 20.0, 20.0, 60.0, 0.9]]) for n in range(60)])


@pytest.mark.parametrize("tracker", [BoxTracker(BOXES, 0.05), DetectionTracker(BOXES, DetectionParams(), CAMERA)])
def test_the_engine_of_boxes_resumes(tracker, tmp_path):
    assert_resumes(lambda: engine_of(CrossingVideo(), deepcopy(tracker)), moments(6, 2, 58), tmp_path)
