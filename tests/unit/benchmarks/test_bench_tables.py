"""The bench of long tables on short ones."""

from pathlib import Path

from benchmarks.tables import walkers, write_run
from planview.counting.rules import load_rules
from planview.output.folder import read_run_info
from planview.trajectories.table import read_tracks, read_truth


def test_walkers_are_as_many_rows_as_asked_for_and_one_per_person_and_frame() -> None:
    truth = walkers(5000, 8.0, seed=0)
    assert len(truth) == 5000
    assert len(set(zip(truth.frame.tolist(), truth.track_id.tolist(), strict=True))) == 5000


def test_the_folder_written_is_that_of_a_finished_run(tmp_path: Path) -> None:
    write_run(tmp_path, 1000, 5.0, seed=0)
    tracks, truth = read_tracks(tmp_path / "tracks.csv"), read_truth(tmp_path / "truth.csv")
    assert 900 < len(tracks) < len(truth) == 1000
    assert read_run_info(tmp_path / "run.json").finished
    assert load_rules(tmp_path / "rules.toml").names == ["across", "door", "till", "waiting"]
