"""Kinds of options that commands share, and options checked by the parameter tables they set."""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

from cyclopts import Parameter
from pydantic import ValidationError

from calib.errors import InputError
from calib.params import Params, first_problem

Flag = Annotated[bool, Parameter(negative="")]
"""A switch that is off unless it is given; there is no --no-... of it."""
JsonFlag = Annotated[bool, Parameter(name="--json", negative="")]
"""The switch --json: one JSON object on standard output."""

_Table = TypeVar("_Table", bound=Params)


def checked(table: type[_Table], **values: Any) -> _Table:
    """A parameter table from options.

    Raises:
        InputError: a value out of its range; names the parameter and the value found.
    """
    try:
        return table(**values)
    except ValidationError as error:
        raise InputError(first_problem(error)) from error
