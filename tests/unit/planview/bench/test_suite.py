"""The challenge suite: which scenes a seed gets, what is kept in the cache, and totals."""

import json

import pytest

from calib.errors import InputError
from planview.bench.commands.bench_suite import ChallengeOptions, bench_suite
from planview.bench.suite import (
    SUITE,
    SuiteJob,
    chosen_files,
    drawn_scene,
    is_whole,
    run_job,
    suite_recording,
    suite_totals,
)
from planview.pipeline.config import load_config

CHALLENGE = """description = "one crosses"
covers = ["320x240"]
fps = 10
duration_s = 8
[camera]
width = 160
height = 120
lens_deg = 70
baseline_m = 0.3
[[choreography]]
kind = "cross"
start_s = 0.0
duration_s = 1
speed_mps = 1.5
"""


@pytest.fixture(scope="module")
def challenge(tmp_path_factory):
    path = tmp_path_factory.mktemp("suite") / "tiny.toml"
    path.write_text(CHALLENGE)
    return path


@pytest.fixture(scope="module")
def recording(challenge, tmp_path_factory):
    cache = tmp_path_factory.mktemp("cache")
    folder, scene = suite_recording(challenge, 3, cache)
    return cache, folder, scene


def test_minutes_choose_whole_scenes_by_the_seed():
    files = sorted(SUITE.glob("*.toml"))
    few, more = chosen_files(files, 1, 2.0), chosen_files(files, 1, 5.0)
    assert set(few) < set(more) < set(files)
    assert chosen_files(files, 2, 2.0) != few
    assert chosen_files(files, 1, 60.0) == files


def test_recording_has_a_pair_of_images_for_every_frame(recording):
    _, folder, scene = recording
    assert scene.n_frames == 80
    assert is_whole(folder, 80)
    assert not is_whole(folder, 81)


def test_recording_that_was_cut_off_is_rendered_again(challenge, recording):
    cache, folder, _ = recording
    image = sorted((folder / "right").iterdir())[-1]
    whole = image.read_bytes()
    image.write_bytes(b"")
    again, _ = suite_recording(challenge, 3, cache)
    assert again == folder
    assert image.read_bytes() == whole


def test_job_scores_its_scene_and_totals_count_per_ten_minutes(challenge, recording, tmp_path):
    job = SuiteJob(challenge, 3, recording[0], tmp_path, load_config(None, ()))
    result = run_job(job)
    assert (result.score.name, result.score.seed, result.duration_s) == ("tiny", 3, 8.0)
    assert (tmp_path / "tiny-3" / "tracks.csv").is_file()
    whole = suite_totals([result, result])
    assert whole.minutes == pytest.approx(16 / 60)
    assert whole.truth_rows == 2 * result.score.evaluation.truth_rows > 0
    assert whole.significant_per_10_min == pytest.approx(37.5 * whole.significant["total"])
    assert whole.strict >= whole.significant["total"] - whole.significant["swapped"]


def test_challenge_with_a_value_out_of_range_is_refused_naming_file_and_key(challenge, tmp_path):
    path = tmp_path / "dark.toml"
    path.write_text(CHALLENGE.replace("lens_deg = 70", "lens_deg = 170"))
    with pytest.raises(InputError, match=r"dark\.toml: camera\.lens_deg: .* found 170"):
        drawn_scene(path, 1)


def test_command_reports_scenes_and_seeds_as_json(challenge, recording, tmp_path, capsys):
    options = ChallengeOptions(seed=[3], scenes=challenge.parent, cache=recording[0], out=tmp_path, json_output=True)
    bench_suite(options=options)
    captured = capsys.readouterr()
    assert "seeds: 3 (worked on)" in captured.err
    (scene,) = json.loads(captured.out)["scenes"]
    assert (scene["scene"], scene["seed"]) == ("tiny", 3)
    assert json.loads((tmp_path / "suite.json").read_text())["totals"]["minutes"] == pytest.approx(8 / 60)


def test_command_refuses_minutes_that_are_not_positive():
    with pytest.raises(InputError, match="--minutes above 0"):
        bench_suite(options=ChallengeOptions(minutes=0))
