import time
from pathlib import Path

import pytest

from calib.errors import InputError
from planview.sweep.study import Range, grid, load_study, random_draws, varied


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


def test_study_takes_dotted_and_quoted_parameter_names(tmp_path: Path) -> None:
    text = 'recordings = ["a"]\nmethod = "random"\n[parameters]\ntemplate.stay_s = [0.3]\n'
    text += '"maps.cell_m" = { min = 0.02, max = 0.05 }\n'
    study = load_study(write(tmp_path, text))
    assert study.parameters == {"template.stay_s": [0.3], "maps.cell_m": Range(min=0.02, max=0.05)}


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


def test_vary_takes_seeds_from_the_parameter_of_that_name() -> None:
    assert varied(["maps.cell_m=0.03,0.04", "seed=1,2"]) == ({"maps.cell_m": [0.03, 0.04]}, [1, 2])


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (f"seeds = {list(range(100_000))}", "found"),
        (f"seeds = {list(range(20_000))}\n[parameters]\n'a.b' = [1, 2, 3]", "60000 .3 configurations x 1 recordings"),
        ("method = 'random'\nsamples = 100_000", "100000"),
        ("[parameters]\n'a.b' = { min = 0.0, max = 1.0, step = 1e-6 }", "1000001"),
        ("a" + ".b" * 60_000 + " = 1", "deeper ones"),
    ],
    ids=["many seeds", "many runs", "many samples", "many steps", "deep key"],
)
def test_study_that_is_too_large_is_refused_at_once(text: str, found: str, tmp_path: Path) -> None:
    path, begin = write(tmp_path, f'recordings = ["a"]\n{text}\n'), time.perf_counter()
    with pytest.raises(InputError, match=f"expected .* found .*{found}|less than or equal to 50000, found {found}"):
        load_study(path)
    assert time.perf_counter() - begin < 1.0


def test_grid_has_all_combinations_the_last_parameter_fastest() -> None:
    found = grid({"maps.cell_m": [0.03, 0.04], "feedback.enabled": [True, False]})
    assert [c.label for c in found] == [
        "maps.cell_m=0.03 feedback.enabled=true",
        "maps.cell_m=0.03 feedback.enabled=false",
        "maps.cell_m=0.04 feedback.enabled=true",
        "maps.cell_m=0.04 feedback.enabled=false",
    ]


def test_grid_without_parameters_is_the_defaults_alone() -> None:
    assert [c.label for c in grid({})] == ["defaults"]


def test_grid_counts_a_range_by_its_steps() -> None:
    assert [c.settings for c in grid({"a.b": Range(min=0.1, max=0.3, step=0.1)})] == [
        ("a.b=0.1",), ("a.b=0.2",), ("a.b=0.3",),
    ]  # fmt: skip


def test_grid_refuses_a_range_without_steps() -> None:
    with pytest.raises(InputError, match="a step for a grid"):
        grid({"a.b": Range(min=0.1, max=0.3)})


def test_random_draws_are_the_same_for_a_seed_and_lie_in_their_ranges() -> None:
    parameters = {"a.x": Range(min=0.5, max=2.0, log=True), "a.n": Range(min=1, max=3), "a.c": ["p", "q"]}
    found = random_draws(parameters, 10, seed=4)
    assert found == random_draws(parameters, 10, seed=4) != random_draws(parameters, 10, seed=5)
    assert len(set(found)) == 10
    assert all(0.5 <= float(c.value("a.x")) <= 2.0 for c in found)
    assert {c.value("a.n") for c in found} <= {"1", "2", "3"}


def test_random_draws_stop_where_the_space_is_exhausted() -> None:
    assert len(random_draws({"a.c": ["p", "q"]}, 10, seed=0)) == 2
