"""Sweeps: studies, jobs, results."""

import shutil
import time
from pathlib import Path
from typing import Any

import pytest

import planview
from calib.errors import InputError
from planview.engine.config import Config
from planview.output.resume import code_version, content_key
from planview.studies.results import JobResult, means_of, summary_csv
from planview.studies.study import Configuration, RecordingEntry, Study, load_study
from planview.studies.work import Job, StudyInput, companion_files, do_job


@pytest.fixture
def recording(tmp_path) -> Path:
    for side in ("left", "right"):
        (tmp_path / "a" / side).mkdir(parents=True)
        (tmp_path / "a" / side / "0.png").write_bytes(side.encode())
    (tmp_path / "a" / "rig.toml").write_text("focal = 1")
    return tmp_path / "a"


@pytest.mark.parametrize("change", ["left/0.png", "rig.toml", "left/1.png"])
def test_key_changes_with_the_content(change, recording):
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


def test_key_takes_each_folder_once_where_links_lead_back(recording):
    for n in range(12):
        (recording / f"loop{n}").symlink_to(".")
    before = content_key(recording)
    (recording / "left" / "0.png").write_text("tfel")
    assert content_key(recording) != before


def test_key_of_a_large_file_depends_on_its_ends(tmp_path):
    path, size = tmp_path / "left.mp4", 40 * 64 * 1024
    keys = set()
    for place in (None, 0, size - 1, size):
        content = bytearray(size + (place == size))
        if place is not None:
            content[place] = 1
        path.write_bytes(content)
        keys.add(content_key(path))
    assert len(keys) == 4


def test_companion_files_of_a_video_are_those_that_describe_it(tmp_path):
    for name in ("a.mp4", "b.mp4", "calib.json", "timestamps.csv", "truth.csv", "study.toml"):
        (tmp_path / name).touch()
    assert [file.name for file in companion_files(tmp_path / "a.mp4")] == ["calib.json", "timestamps.csv"]


def test_version_changes_with_the_code(tmp_path, monkeypatch):
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


def test_means_of_a_configuration_are_those_of_its_finished_runs():
    runs = [result(A, "x", 0.5), result(A, "y", 0.7), result(B, "x", 0.9), result(B, "y", None)]
    means = means_of(runs)
    assert means["runs"].to_dict() == {"a.b=1": 2, "a.b=2": 1}
    assert means["mota"].to_dict() == pytest.approx({"a.b=1": 0.6, "a.b=2": 0.9})
    assert "idf1" not in means  # which no run has


def test_configuration_whose_runs_all_fail_has_no_means():
    assert list(means_of([result(A, "x", None), result(B, "x", 0.5)]).index) == ["a.b=2"]


def test_summary_has_a_row_per_run():
    done = JobResult("hall", Configuration(("a.b=1", "c.d=true")), 3, figures={"mota": 0.5})
    header, row = summary_csv([done]).splitlines()
    assert header.startswith("recording,a.b,c.d,seed,state,mota,idf1")
    assert row.startswith("hall,1,true,3,done,0.5,,")


def test_summary_says_why_a_run_failed():
    failed = JobResult("hall", Configuration(("a.b=1",)), 0, error="no floor")
    row = summary_csv([failed]).splitlines()[1]
    assert row.startswith("hall,1,0,failed,")
    assert row.endswith(",no floor")


def write(folder: Path, text: str) -> Path:
    path = folder / "s.toml"
    path.write_text(text)
    return path


def test_study_finds_recordings_by_any_entry(tmp_path):
    for name in ("hall/a", "hall/b", "other"):
        (tmp_path / name).mkdir(parents=True)
    text = 'recordings = ["hall/*", "other", { path = "x.mp4", camera = "camera.toml", fps = 25 }]\n'
    study = load_study(write(tmp_path, text))
    paths = [entry.path.relative_to(tmp_path).as_posix() for entry in study.recordings]
    assert paths == ["hall/a", "hall/b", "other", "x.mp4"]
    assert study.recordings[3].camera == tmp_path / "camera.toml"
    assert study.recordings[3].fps == 25


def test_study_takes_parameter_names_as_toml_allows_them(tmp_path):
    text = 'recordings = ["a"]\n[parameters]\njoint.stay_s = [0.3]\n"maps.cell_m" = [0.02, 0.05]\n'
    study = load_study(write(tmp_path, text))
    assert study.parameters == {"joint.stay_s": [0.3], "maps.cell_m": [0.02, 0.05]}


@pytest.mark.parametrize(
    "text",
    [
        "recordings = []",
        'recordings = ["none/*"]',
        'recordings = ["a"]\nseeds = [1, 1]',
        'recordings = ["a"]\nno_such = 1',
        'recordings = ["a"]\n[parameters]\n"maps.cell_m" = { min = 1, max = 2 }',
        'recordings = ["a"]\n[parameters]\n"maps.cell_m" = 0.03',
        'recordings = ["a"]\n[parameters]\n"maps.cell_m" = []',
        'recordings = ["a"]\n[parameters]\nseed = [1, 2]',
        'recordings = [{ path = "a", fps = "fast" }]',
        "recordings = 3",
        "not toml",
    ],
)
def test_study_that_cannot_be_is_refused_by_its_file(text, tmp_path):
    path = write(tmp_path, text)
    with pytest.raises(InputError) as refused:
        load_study(path)
    assert str(refused.value).startswith(str(path))
    assert "\n" not in str(refused.value)


def study_of(parameters: dict[str, Any], **others: Any) -> Study:
    return Study(recordings=[RecordingEntry(path=Path("a"))], parameters=parameters, **others)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (f"seeds = {list(range(100_000))}", "characters"),
        (f"seeds = {list(range(20_000))}\n[parameters]\n'a.b' = [1, 2, 3]", "60000 .3 configurations x 1 recordings"),
        ("a" + ".b" * 60_000 + " = 1", "nested more than"),
    ],
    ids=["many seeds", "many runs", "deep key"],
)
def test_study_that_is_too_large_is_refused_at_once(text, found, tmp_path):
    path, begin = write(tmp_path, f'recordings = ["a"]\n{text}\n'), time.process_time()
    with pytest.raises(InputError, match=f"expected .* found .*{found}"):
        load_study(path).configurations()
    assert time.process_time() - begin < 2.0


def test_study_has_all_combinations_the_last_parameter_fastest():
    configurations = study_of({"maps.cell_m": [0.03, 0.04], "feedback.enabled": [True, False]}).configurations()
    pairs = [(cell, on) for cell in ("0.03", "0.04") for on in ("true", "false")]
    assert [c.label for c in configurations] == [f"maps.cell_m={cell} feedback.enabled={on}" for cell, on in pairs]


def test_study_without_parameters_runs_the_defaults():
    assert [c.label for c in study_of({}).configurations()] == ["defaults"]


def test_value_that_is_given_twice_runs_once():
    assert [c.label for c in study_of({"a.b": [1, 1]}).configurations()] == ["a.b=1"]


def test_folder_that_lacks_its_run_stays_when_the_new_run_fails(tmp_path):
    (tmp_path / "run").mkdir()
    entry = RecordingEntry(path=tmp_path / "nope")
    source = StudyInput("nope", entry, "", Config(), None, "")
    job = Job(source, A, 0, Config(), "joint", 0, tmp_path / "run", code_version())
    with pytest.raises(InputError, match="nope"):
        do_job(job)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
