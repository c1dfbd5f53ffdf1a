"""The challenge suite: which scenes a seed gets, what is kept in the cache, and totals."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.options import SUITE
from benchmarks.passes import Pass
from benchmarks.scores import totals
from benchmarks.suite import (
    SuiteJob,
    SuiteOptions,
    chosen_files,
    dealt_files,
    drawn_scene,
    judged_truth,
    run_job,
    suite,
)
from calib.errors import InputError
from planview.engine.config import Config, load_config
from planview.evaluation.significant import poisson_upper
from planview.trajectories.table import positions_table


def test_minutes_choose_whole_scenes_by_the_seed():
    files = sorted(SUITE.glob("*.toml"))
    few, more = chosen_files(files, 1, 2.0), chosen_files(files, 1, 5.0)
    assert set(few) < set(more) < set(files)
    assert chosen_files(files, 2, 2.0) != few
    assert chosen_files(files, 1, 60.0) == files


def test_scenes_are_dealt_out_to_the_seeds_in_turn() -> None:
    paths = [Path(name) for name in ("c", "a", "b")]
    assert dealt_files(paths, [7, 8]) == [(7, Path("a")), (8, Path("b")), (7, Path("c"))]


def test_job_scores_its_scene_and_totals_count_per_ten_minutes(challenge, recording, tmp_path):
    job = SuiteJob(challenge, 3, recording[0], tmp_path, Config())
    result = run_job(job)["online"]
    assert (result.name, result.seed, result.duration_s) == ("tiny", 3, 8.0)
    assert (tmp_path / "tiny-3" / "tracks.csv").is_file()
    whole = totals([result, result])
    assert whole.minutes == pytest.approx(16 / 60)
    assert whole.truth_rows == 2 * result.evaluation.truth_rows > 0
    n = whole.significant["total"]
    assert whole.significant_per_10_min == pytest.approx((37.5 * n, 37.5 * poisson_upper(n)))
    assert whole.strict >= n - whole.significant["swapped"]
    assert whole.to_json()["events_per_10_min"] == 37.5 * whole.events


def test_pass_is_kept_and_gives_refined_and_peer_tracks_of_the_same_scene(challenge, recording, monkeypatch):
    job = SuiteJob(challenge, 3, recording[0], None, Config(), refine=True, peer=True)
    first = run_job(job)
    assert list(first) == ["online", "refined", "peer"]
    monkeypatch.setattr("benchmarks.passes.run", None)
    assert [s.to_json() for s in run_job(job).values()] == [s.to_json() for s in first.values()]


def test_run_of_another_configuration_is_another_run(recording):
    other = load_config(None, ["template.colour_weight=0"])
    assert Pass(recording[1], recording[0], Config()).folder != Pass(recording[1], recording[0], other).folder


def test_challenge_with_a_value_out_of_range_is_refused_naming_file_and_key(challenge, tmp_path):
    path = tmp_path / "dark.toml"
    path.write_text(challenge.read_text().replace("lens_deg = 70", "lens_deg = 170"))
    with pytest.raises(InputError, match=r"dark\.toml: camera\.lens_deg: .* found 170"):
        drawn_scene(path, 1)


def test_heads_of_a_cartwheel_are_judged_at_the_hips_which_go_straight():
    scene = drawn_scene(SUITE / "cartwheel.toml", 1)
    person = next(i for i, p in enumerate(scene.people, 1) if any(step.cartwheel for step in p.steps))
    frames = np.arange(scene.n_frames)
    heads = positions_table(frames, np.full(len(frames), person), np.full((len(frames), 2), 99.0))
    judged = judged_truth(heads, scene)
    turning = judged.x_m != 99.0
    assert 0.5 < turning.sum() / scene.fps < 6.0
    first = np.split(np.flatnonzero(turning), np.flatnonzero(np.diff(np.flatnonzero(turning)) > 1) + 1)[0]
    way = np.column_stack([judged.x_m, judged.y_m])[first]
    along = (way[-1] - way[0]) / np.linalg.norm(way[-1] - way[0])
    assert np.abs((way - way[0]) @ [-along[1], along[0]]).max() < 0.05


def test_truth_of_upright_people_is_judged_as_it_is(recording):
    _, _, scene = recording
    truth = positions_table(np.arange(3), np.ones(3, dtype=np.int64), np.zeros((3, 2)))
    assert judged_truth(truth, scene) is truth


def test_command_reports_scenes_and_seeds_as_json(challenge, recording, tmp_path, capsys):
    options = SuiteOptions(seed=[3], scenes=challenge.parent, cache=recording[0], out=tmp_path, json_output=True)
    suite(options=options)
    captured = capsys.readouterr()
    assert "seeds: 3 (worked on)" in captured.err
    result = json.loads(captured.out)
    (scene,) = result["online"]["scenes"]
    assert (scene["scene"], scene["seed"]) == ("tiny", 3)
    assert result["seeds"] == [3] and result["commit"] and result["date"]
    assert json.loads((tmp_path / "suite.json").read_text())["online"]["totals"]["minutes"] == pytest.approx(8 / 60)


def test_totals_of_nothing_are_unknown():
    assert np.isnan(totals([]).mota)


def test_command_refuses_minutes_that_are_not_positive():
    with pytest.raises(InputError, match="--minutes above 0"):
        suite(options=SuiteOptions(minutes=0))
