"""What is said of values that a parameter table refuses."""

from typing import Any

import pytest
from pydantic import Field, ValidationError, field_validator

from calib.params import Params, first_problem


class Cells(Params):
    cell_m: float = Field(ge=0)
    name: str = "a"

    @field_validator("name")
    @classmethod
    def _one_word(cls, value: str) -> str:
        if " " in value:
            raise ValueError(f"expected one word, found {value!r}")
        return value


class Table(Params):
    maps: Cells


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"cell_m": -1.0}, "maps.cell_m: input should be greater than or equal to 0, found -1.0"),
        ({"cell_m": 1.0, "cel": 2}, "expected only known names, found maps.cel"),
        ({}, "expected maps.cell_m, found none"),
        ({"cell_m": 1.0, "name": "a b"}, "maps.name: expected one word, found 'a b'"),
    ],
)
def test_first_problem_names_the_value_what_was_expected_and_found(values: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValidationError) as refused:
        Table.model_validate({"maps": values})
    assert first_problem(refused.value) == sentence


def test_first_problem_cuts_long_values_short() -> None:
    with pytest.raises(ValidationError) as refused:
        Table.model_validate({"maps": {"cell_m": "x" * 500}})
    assert len(first_problem(refused.value)) < 200
