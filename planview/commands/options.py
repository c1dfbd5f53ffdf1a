"""Command line options checked by the parameter tables they set."""

from __future__ import annotations

from typing import Any, TypeVar

from pydantic import ValidationError

from calib.errors import InputError
from calib.params import Params, first_problem

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
