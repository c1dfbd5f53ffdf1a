"""The challenge suite, and scores of real recordings."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.passes import Pass, together
from benchmarks.random_scenes.generator import SUITE, random_scene
from benchmarks.real import (
    WALKER_PATH,
    ahead_of_heads,
    recordings_with_truth,
    score_pets,
    score_real,
    spread,
    truth_of,
)
from benchmarks.suite import SuiteJob, SuiteOptions, chosen_files, run_job, suite
from calib.errors import InputError
from planview.engine.config import Config, load_config
from planview.trajectories.table import Trajectories, positions_table, read_tracks


def test_minutes_choose_whole_scenes_by_the_seed():
    files = sorted(SUITE.glob("*.toml"))
    few, more = chosen_files(files, 1, 2.0), chosen_files(files, 1, 5.0)
    assert set(few) < set(more) < set(files) and chosen_files(files, 2, 2.0) != few
    assert chosen_files(files, 1, 60.0) == files


def test_job_scores_its_scene_and_totals_count_per_ten_minutes(challenge, recording, tmp_path):
    job = SuiteJob(challenge, 3, recording[0], tmp_path, Config())
    result = run_job(job)["online"]
    assert (result.name, result.seed, result.duration_s) == ("tiny", 3, 8.0)
    assert (tmp_path / "tiny-3" / "tracks.csv").is_file()
    whole = together([result, result])
    assert whole.duration_s == 16.0
    assert whole.sequence.truth_rows == 2 * result.evaluation.sequence.truth_rows > 0
    assert whole.to_json()["events_per_10_min"] == 37.5 * whole.events


def test_pass_is_kept_and_gives_refined_tracks_of_the_same_scene(challenge, recording, monkeypatch):
    job = SuiteJob(challenge, 3, recording[0], None, Config(), refine=True)
    first = run_job(job)
    assert list(first) == ["online", "refined"]
    monkeypatch.setattr("benchmarks.passes.run", None)
    assert [s.to_json() for s in run_job(job).values()] == [s.to_json() for s in first.values()]


def test_run_of_another_configuration_is_another_run(recording):
    other = load_config(None, ["joint.colour_weight=0"])
    assert Pass(recording[1], recording[0], Config()).folder != Pass(recording[1], recording[0], other).folder


def test_challenge_with_a_value_out_of_range_is_refused_naming_file_and_key(challenge, tmp_path):
    path = tmp_path / "dark.toml"
    path.write_text(challenge.read_text().replace("lens_deg = 70", "lens_deg = 170"))
    with pytest.raises(InputError, match=r"dark\.toml: camera\.lens_deg: .* found 170"):
        random_scene("suite", 1, path)


def test_command_reports_scenes_and_seeds_as_json(challenge, recording, tmp_path, capsys):
    options = SuiteOptions(seed=[3], scenes=challenge.parent, cache=recording[0], out=tmp_path, json_output=True)
    suite(options=options)
    captured = capsys.readouterr()
    assert "seeds: 3 (tuned on)" in captured.err
    result = json.loads(captured.out)
    (scene,) = result["online"]["scenes"]
    assert (scene["scene"], scene["seed"]) == ("tiny", 3)
    assert result["seeds"] == [3] and result["commit"] and result["date"]
    assert json.loads((tmp_path / "suite.json").read_text())["online"]["totals"]["duration_s"] == 8.0


def test_minutes_must_be_positive():
    with pytest.raises(InputError, match="--minutes above 0"):
        suite(options=SuiteOptions(minutes=0))


def table(*rows: tuple[int, int, float, float]) -> Trajectories:
    """Of frame, id, x [m] and visible."""
    frame, ids, x, visible = (np.array(column) for column in zip(*rows, strict=True))
    return positions_table(frame, ids, np.column_stack([x, 0 * x]), timestamp_s=frame / 10, visible=visible * 1.0)


def test_doubtful_people_are_neither_asked_for_nor_wrong_and_only_judged_frames_count():
    truth = table((0, 1, 0.0, 1), (1, 1, 0.0, 1), (1, 2, 3.0, 0), (2, 1, 0.0, 1), (2, 2, 3.0, 0))
    tracks = table((0, 7, 0.0, 1), (1, 7, 0.1, 1), (2, 7, 0.1, 1), (2, 8, 3.0, 1), (3, 7, 0.0, 1))
    score = score_real(tracks, truth, np.arange(4))
    # Right in frames 0 to 2, in the last of which the doubtful one is found; nobody is there in frame 3.
    assert score == {"right_number": 0.75, "ids": 2, "people": 1, "judged": 3, "positions": 5}
    score = score_real(table((0, 7, 0.0, 1), (5, 9, 3.0, 1)), table((0, 1, 0.0, 1)), np.array([0]))
    assert (score["right_number"], score["ids"]) == (1.0, 1)


def test_places_ahead_of_heads_are_told_from_a_camera_that_is_registered_beside() -> None:
    frame = np.arange(40)
    walks = [(k, who, way * k / 10 - way * 2.0, 1.0) for k in frame for who, way in ((1, 1.0), (2, -1.0))]
    truth = table(*walks)
    # Five centimetres ahead of whoever walks there at 1 m/s, and two to the right of both.
    found = replace(truth, x_m=truth.x_m + np.where(truth.track_id == 1, 0.05, -0.05) + 0.02)
    assert ahead_of_heads(found, truth, 0.1) == pytest.approx((5.0, 5.0, 5.0))
    assert np.isnan(ahead_of_heads(truth, table(*((k, 1, 0.0, 1.0) for k in frame)), 0.1)).all()


def test_walkers_path_has_a_second_person_to_the_right_once_both_stand(tmp_path: Path) -> None:
    (tmp_path / WALKER_PATH).write_text("frame,x_m,z_m,height_m\n0,0.5,1,1.7\n31,0.65,0.7,1.8\n31,0.0,0.6,1.7\n")
    truth = truth_of(tmp_path)
    assert list(zip(truth.frame, truth.track_id, truth.visible, strict=True)) == [(0, 1, 1), (31, 1, 0), (31, 2, 0)]
    assert truth.x_m.tolist() == [0.5, 0.0, 0.65]


def test_recordings_are_found_by_their_truth(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"truth\.csv"):
        recordings_with_truth(tmp_path)
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "truth.csv").touch()
    assert recordings_with_truth(tmp_path) == [tmp_path / "room"]
    with pytest.raises(InputError, match="found 'attic'"):
        recordings_with_truth(tmp_path, ["attic"])


ROWS = "frame,timestamp_s,id,x_m,y_m,left_px,top_px,width_px,height_px,state\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Truth of one person in ten frames; seed n misses the last n of them."""
    (tmp_path / "gt.txt").write_text("".join(f"{i + 1},1,10,10,20,50,1,0,0,0\n" for i in range(10)))
    (tmp_path / "view001.mp4").write_bytes(b"")

    def run(_video, *, config, watch, **_options) -> Trajectories:
        for frame in range(10):
            watch(SimpleNamespace(frame=frame))
        path = tmp_path / f"tracks{config.seed}.csv"
        path.write_text(ROWS + "".join(f"{i},{i / 7:.3f},5,,,9,9,20,50,confirmed\n" for i in range(10 - config.seed)))
        return read_tracks(path)

    monkeypatch.setattr("benchmarks.real.run", run)
    return tmp_path


def test_spread_is_that_of_every_seed(folder):
    runs = score_pets("ellipse-particle", folder, None, seeds=3)
    assert [run.boxes.clear.mota for run in runs] == pytest.approx([1.0, 0.9, 0.8])
    (found,) = spread(runs)
    assert found["mota_range"] == pytest.approx(0.2)
    assert found["mota_deviation"] == pytest.approx(0.1 * (2 / 3) ** 0.5)
    assert found["idf1_mean"] == pytest.approx((1 + 18 / 19 + 16 / 18) / 3)


def test_folder_without_the_sequence_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"gt\.txt"):
        score_pets("ellipse-particle", tmp_path, None)
