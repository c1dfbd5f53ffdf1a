"""Base of every parameter table."""

from pydantic import BaseModel, ConfigDict


class Params(BaseModel):
    """Frozen, unknown keys refused, values checked; each field's docstring gives meaning, unit and source."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)
