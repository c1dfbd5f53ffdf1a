import pytest

from calib.errors import InputError
from planview.sweep.study import Range, grid, random_draws


def test_grid_has_all_combinations_the_last_parameter_fastest() -> None:
    found = grid({"maps.cell_m": [0.03, 0.04], "template.identity.enabled": [True, False]})
    assert [c.label for c in found] == [
        "maps.cell_m=0.03 template.identity.enabled=true",
        "maps.cell_m=0.03 template.identity.enabled=false",
        "maps.cell_m=0.04 template.identity.enabled=true",
        "maps.cell_m=0.04 template.identity.enabled=false",
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
