"""The configuration: one file, overrides, and refusals by name."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from calib.errors import InputError
from calib.params import field_docs
from planview.engine.config import Config, load_config


def test_no_file_and_no_override_give_the_defaults() -> None:
    assert load_config() == Config()


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    file.write_text("seed = 3\n[maps]\ncell_m = 0.05\n")
    expected = Config().model_copy(update={"seed": 3, "maps": Config().maps.model_copy(update={"cell_m": 0.05})})
    assert load_config(file) == expected


def test_an_override_beats_the_file(tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    file.write_text("[maps]\ncell_m = 0.05\n")
    assert load_config(file, ["maps.cell_m=0.04", "feedback.enabled=false"]).maps.cell_m == 0.04


def test_an_override_leaves_the_other_defaults_of_its_stage() -> None:
    found = load_config(None, ["single_camera.foreground.beta=9"]).single_camera.foreground
    assert found == Config().single_camera.foreground.model_copy(update={"beta": 9.0})
    assert found.remove_colour_shadows


@pytest.mark.parametrize(
    ("override", "meant"),
    [("maps.cel_m=0.03", "maps.cell_m"), ("cell_m=0.03", "maps.cell_m"), ("foregruond.beta=9", "foreground")],
)
def test_an_unknown_name_is_answered_with_the_one_it_resembles(override: str, meant: str) -> None:
    with pytest.raises(InputError, match=rf"did you mean {meant}\?"):
        load_config(None, [override])


@pytest.mark.parametrize(
    ("override", "named"),
    [
        ("foreground.learning_rat=0.1", "foreground.learning_rat"),
        ("no_such_stage.x=1", "no_such_stage"),
        ("maps.cell_m=-1", "maps.cell_m"),
        ("maps.cell_m=nan", "maps.cell_m"),
        ("maps.cell_m=wide", "maps.cell_m"),
        ("maps=3", "maps"),
        ("seed.deeper.x=1", "seed"),
        ("maps.cell_m", "maps.cell_m"),
        ("maps.cell_m=0.0049", "maps.cell_m"),
        ("floor.max_below_fraction=0.999999", "floor.max_below_fraction"),
        (".=1", ".=1"),
        ("=1", "=1"),
    ],
)
def test_unknown_names_and_bad_values_are_refused_by_name(override: str, named: str) -> None:
    with pytest.raises(InputError) as refused:
        load_config(None, [override])
    assert named in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_bad_value_in_a_file_names_the_file_and_the_key(tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    file.write_text("[maps]\ncell_m = 99\n")
    with pytest.raises(InputError, match=r"c\.toml: maps\.cell_m: .*99"):
        load_config(file)


@pytest.mark.parametrize("content", [b"[maps", b"\xff\xfe", b"x = " + b"[" * 5000])
def test_a_file_that_is_not_toml_is_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "c.toml"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"c\.toml: expected a TOML configuration"):
        load_config(file)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml"):
        load_config(tmp_path / "none.toml")


def test_the_effective_configuration_survives_json() -> None:
    config = load_config(None, ["maps.cell_m=0.04"])
    assert Config.model_validate_json(config.model_dump_json()) == config


@given(st.text(max_size=40))
def test_any_override_is_taken_or_refused_in_one_sentence(override: str) -> None:
    told = ""
    try:
        load_config(None, [override])
    except InputError as error:
        told = str(error)
    assert len(told) < 400


def parameters_of(table: BaseModel, name: str) -> Iterator[tuple[str, str | None]]:
    meanings = field_docs(type(table))
    for key in type(table).model_fields:
        value = getattr(table, key)
        if isinstance(value, BaseModel):
            yield from parameters_of(value, f"{name}.{key}")
        else:
            yield f"{name}.{key}", meanings.get(key)


def test_every_parameter_says_what_it_means() -> None:
    described = dict(parameters_of(Config(), "config"))
    assert len(described) > 50
    assert [name for name, text in described.items() if not text] == []
