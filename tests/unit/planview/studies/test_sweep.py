"""Sweeps: proposals, jobs, results, studies."""

import math
import shutil
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pandas import MultiIndex, Series

import planview
from calib.errors import InputError
from planview.output.resume import code_version, content_key
from planview.studies import work
from planview.studies.results import JobResult, estimate, ranked, summary_csv, why_no_intervals
from planview.studies.study import Configuration, Range, RecordingEntry, Study, load_study
from planview.studies.work import companion_files


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    for side in ("left", "right"):
        (tmp_path / "a" / side).mkdir(parents=True)
        (tmp_path / "a" / side / "0.png").write_bytes(side.encode())
    (tmp_path / "a" / "rig.toml").write_text("focal = 1")
    return tmp_path / "a"


@pytest.mark.parametrize("change", ["left/0.png", "rig.toml", "left/1.png"])
def test_key_changes_with_the_content(change: str, recording: Path) -> None:
    before = content_key(recording)
    (recording / change).write_text("tfel" if change == "left/0.png" else "focal = 2")
    assert content_key(recording) != before


def test_key_is_that_of_the_content_without_truth_hidden_files_or_results(recording, tmp_path):
    before = content_key(recording)
    (recording / "truth.csv").write_text("frame,id\n")
    (recording / ".cache").write_text("x")
    (recording / "out").mkdir()
    (recording / "out" / "run.json").write_text("{}")
    assert content_key(recording) == before
    assert content_key(Path(shutil.copytree(recording, tmp_path / "b"))) == content_key(recording)
    with pytest.raises(InputError, match="no such file or folder"):
        content_key(tmp_path / "none")


def test_key_takes_each_folder_once_where_links_lead_back(recording: Path) -> None:
    for n in range(12):
        (recording / f"loop{n}").symlink_to(".")
    before = content_key(recording)
    (recording / "left" / "0.png").write_text("tfel")
    assert content_key(recording) != before


def test_key_of_a_large_file_depends_on_its_first_and_last_bytes_and_size(tmp_path: Path) -> None:
    path, size = tmp_path / "left.mp4", 40 * 64 * 1024
    keys = set()
    for place in (None, 0, size - 1, size):
        content = bytearray(size + (place == size))
        if place is not None:
            content[place] = 1
        path.write_bytes(content)
        keys.add(content_key(path))
    assert len(keys) == 4


def test_companion_files_a_video_are_calibrations_and_times(tmp_path: Path) -> None:
    for name in ("a.mp4", "b.mp4", "calib.json", "timestamps.csv", "truth.csv", "study.toml"):
        (tmp_path / name).touch()
    assert [file.name for file in companion_files(tmp_path / "a.mp4")] == ["calib.json", "timestamps.csv"]


def test_version_changes_with_the_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(Path(planview.__file__).parent / "checks", tmp_path / "planview" / "checks")
    monkeypatch.setattr(planview, "__file__", str(tmp_path / "planview" / "__init__.py"))
    before = code_version.__wrapped__()
    with next((tmp_path / "planview").rglob("[a-z]*.py")).open("a") as file:
        file.write("# changed\n")
    assert code_version.__wrapped__() != before


A, B = Configuration(("a.b=1",)), Configuration(("a.b=2",))


def result(configuration: Configuration, recording: str, mota: float | None, seed: int = 0) -> JobResult:
    figures = {} if mota is None else {"mota": mota, "position_error_mean_m": 1 - mota}
    return JobResult(recording, configuration, seed, figures=figures, error="" if figures else "no floor")


@pytest.mark.parametrize(
    ("runs", "objective"),
    [
        ([result(A, "x", 0.5), result(A, "y", 0.7), result(B, "x", 0.9), result(B, "y", 0.5)], "mota"),
        ([result(A, "x", 0.5), result(B, "x", 0.9)], "position_error_mean_m"),
        ([result(A, "x", 0.9), result(A, "y", None), result(B, "x", 0.5), result(B, "y", 0.5)], "mota"),
        ([result(A, "x", None), result(B, "x", 0.5)], "mota"),
    ],
    ids=["the best mean over recordings", "the least error", "complete ones", "those that have the objective"],
)
def test_comes_first(runs, objective):
    ranking = ranked(runs, objective)
    assert [row.configuration for row in ranking] == [B, A]
    if len(runs) == 4:
        means = [row.figures["mota"].mean for row in ranking]
        assert means == pytest.approx([0.7, 0.6] if not ranking[1].failed else [0.5, 0.9])
        assert (ranking[1].runs, ranking[1].failed) in ((2, 0), (1, 1))


def by_recording_and_seed(values: np.ndarray) -> Series:
    index = MultiIndex.from_product([range(n) for n in values.shape], names=["recording", "seed"])
    return Series(values.ravel(), index)


def test_seeds_of_a_recording_count_together_as_much_as_another_recording() -> None:
    assert estimate(by_recording_and_seed(np.array([[0.0, 0.0], [1.0, math.nan]]))).mean == 0.5


@pytest.mark.parametrize("values", [[[0.4]], [[0.4, 0.5]] * 4, [[0.4]] * 4 + [[math.nan]]])
def test_fewer_than_five_recordings_have_no_interval_and_a_reason(values):
    found = estimate(by_recording_and_seed(np.array(values)))
    assert found.mean == pytest.approx(np.nanmean(values)) and math.isnan(found.low) and math.isnan(found.high)
    why = why_no_intervals([result(A, "x", 0.5), result(A, "y", None)])
    assert why == "no 95% intervals: they need 5 recordings, found 1"
    assert not why_no_intervals([result(A, name, 0.5) for name in "abcde"])


def test_interval_is_that_of_the_mean_and_of_equal_recordings_without_width():
    found = estimate(by_recording_and_seed(np.full((5, 1), 0.25)))
    assert (found.mean, found.low, found.high) == pytest.approx((0.25, 0.25, 0.25))
    values = np.random.default_rng(1).normal(0.0, 1.0, (400, 1))
    found = estimate(by_recording_and_seed(values))
    assert found.high - found.low == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.1)


def test_difference_to_the_first_is_taken_run_by_run() -> None:
    runs = [result(A, name, 0.5 + i / 10) for i, name in enumerate("vwxyz")]
    runs += [result(B, name, 0.4 + i / 10) for i, name in enumerate("vwxyz")]
    behind = ranked(runs, "mota")[1].behind
    assert (behind.mean, behind.low, behind.high) == pytest.approx((-0.1, -0.1, -0.1))


def test_summary_has_a_row_per_run_a_column_per_parameter_and_no_formulas():
    done = JobResult("hall", Configuration(("a.b=1", "c.d=true")), 3, figures={"mota": 0.5})
    header, row = summary_csv([done]).splitlines()
    assert header.startswith("recording,a.b,c.d,seed,state,tracked_from,mota,idf1")
    assert row.startswith("hall,1,true,3,done,recording,0.5,,")
    failed = JobResult('=HYPERLINK("x")', Configuration(("a.b=-1",)), 0, error="no floor")
    row = summary_csv([failed]).splitlines()[1]
    assert row.startswith('"\'=HYPERLINK(""x"")",-1,0,failed') and row.endswith(",no floor")


def write(folder: Path, text: str) -> Path:
    path = folder / "s.toml"
    path.write_text(text)
    return path


def test_study_finds_recordings_by_path_pattern_and_table(tmp_path: Path) -> None:
    for name in ("hall/a", "hall/b", "other"):
        (tmp_path / name).mkdir(parents=True)
    text = 'recordings = ["hall/*", "other", { path = "x.mp4", camera = "camera.toml" }]\n'
    study = load_study(write(tmp_path, text))
    paths = [entry.path.relative_to(tmp_path).as_posix() for entry in study.recordings]
    assert paths == ["hall/a", "hall/b", "other", "x.mp4"]
    assert study.recordings[3].camera == tmp_path / "camera.toml"


def test_study_takes_dotted_and_quoted_parameter_names(tmp_path):
    text = 'recordings = ["a"]\nmethod = "random"\n[parameters]\njoint.stay_s = [0.3]\n'
    text += '"maps.cell_m" = { min = 0.02, max = 0.05 }\n'
    study = load_study(write(tmp_path, text))
    assert study.parameters == {"joint.stay_s": [0.3], "maps.cell_m": Range(min=0.02, max=0.05)}


@pytest.mark.parametrize(
    "text",
    [
        "recordings = []",
        'recordings = ["none/*"]',
        'recordings = ["a"]\nseeds = [1, 1]',
        'recordings = ["a"]\nno_such = 1',
        'recordings = ["a"]\nobjective = "beauty"',
        'recordings = ["a"]\n[parameters]\n"maps.cell_m" = { min = 2, max = 1 }',
        "recordings = 3",
        "not toml",
    ],
)
def test_study_refuses_what_it_does_not_know_and_names_the_file(text: str, tmp_path: Path) -> None:
    path = write(tmp_path, text)
    with pytest.raises(InputError) as refused:
        load_study(path)
    assert str(refused.value).startswith(str(path)) and "\n" not in str(refused.value)


def study_of(parameters: dict[str, Any], **others: Any) -> Study:
    return Study(recordings=[RecordingEntry(path=Path("a"))], parameters=parameters, **others)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (f"seeds = {list(range(100_000))}", "characters"),
        (f"seeds = {list(range(20_000))}\n[parameters]\n'a.b' = [1, 2, 3]", "60000 .3 configurations x 1 recordings"),
        ("method = 'random'\nsamples = 100_000", "100000"),
        ("[parameters]\n'a.b' = { min = 0.0, max = 1.0, step = 1e-6 }", "1000001"),
        ("a" + ".b" * 60_000 + " = 1", "nested more than"),
    ],
    ids=["many seeds", "many runs", "many samples", "many steps", "deep key"],
)
def test_study_that_is_too_large_is_refused_at_once(text: str, found: str, tmp_path: Path) -> None:
    path, begin = write(tmp_path, f'recordings = ["a"]\n{text}\n'), time.process_time()
    with pytest.raises(InputError, match=f"expected .* found .*{found}|less than or equal to 50000, found {found}"):
        load_study(path).configurations()
    assert time.process_time() - begin < 2.0


def test_grid_has_all_combinations_the_last_parameter_fastest_and_ranges_by_their_steps() -> None:
    found = study_of({"maps.cell_m": [0.03, 0.04], "feedback.enabled": [True, False]}).configurations()
    pairs = [(cell, on) for cell in ("0.03", "0.04") for on in ("true", "false")]
    assert [c.label for c in found] == [f"maps.cell_m={cell} feedback.enabled={on}" for cell, on in pairs]
    assert [c.label for c in study_of({}).configurations()] == ["defaults"]
    steps = study_of({"a.b": Range(min=0.1, max=0.3, step=0.1)}).configurations()
    assert [c.settings for c in steps] == [("a.b=0.1",), ("a.b=0.2",), ("a.b=0.3",)]
    with pytest.raises(InputError, match="a step for a grid"):
        study_of({"a.b": Range(min=0.1, max=0.3)}).configurations()


def test_random_draws_are_the_same_for_a_seed_lie_in_their_ranges_and_stop_where_the_space_is_exhausted():
    parameters = {"a.x": Range(min=0.5, max=2.0, log=True), "a.n": Range(min=1, max=3), "a.c": ["p", "q"]}

    def draws(seed: int) -> list[Configuration]:
        return study_of(parameters, method="random", samples=10, search_seed=seed).configurations()

    found = draws(4)
    assert found == draws(4) != draws(5)
    assert len(set(found)) == 10 and all(0.5 <= float(c.value("a.x")) <= 2.0 for c in found)
    assert {c.value("a.n") for c in found} <= {"1", "2", "3"}
    assert len(study_of({"a.c": ["p", "q"]}, method="random", samples=10).configurations()) == 2


def test_finished_run_without_its_maps_stays_when_the_new_one_fails(tmp_path):
    (tmp_path / "run").mkdir()
    source = SimpleNamespace(path=tmp_path / "nope", camera=None, calibration=None, fps=None)
    job = SimpleNamespace(version=code_version(), folder=tmp_path / "run", source=source, tracker="joint", config=None)
    job.is_done = False
    with pytest.raises(InputError, match="nope"):
        work.track(job)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
