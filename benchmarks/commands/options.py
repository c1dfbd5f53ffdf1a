"""Options that benches share."""

# No ``from __future__ import annotations``: cyclopts evaluates the annotations of inherited fields in the module of the
# subclass, which does not know these names.

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from benchmarks.accuracy import cache_folder
from planview.engine.config import Config, load_config

Flag = Annotated[bool, Parameter(negative="")]
"""A switch that is off without its option."""
JsonFlag = Annotated[bool, Parameter(name="--json", negative="")]
"""The switch --json: one JSON object on standard output."""


@Parameter(name="*")
@dataclass(frozen=True)
class BenchOptions:
    """How rendered recordings are kept and tracked, and how the scores are printed."""

    cache: Path | None = None
    """Folder for rendered recordings; the user's cache by default."""
    config: Path | None = None
    """TOML file with parameters of the pipeline."""
    set_: Annotated[Sequence[str], Parameter(name="--set", negative="", show_default=False)] = ()
    """One parameter of the pipeline."""
    json_output: JsonFlag = False
    """Print one JSON object."""

    @property
    def cache_folder(self) -> Path:
        """The folder for rendered recordings."""
        return self.cache or cache_folder()

    def settings(self) -> Config:
        """The parameters of the pipeline.

        Raises:
            InputError: an unknown parameter, or a value out of its range.
        """
        return load_config(self.config, self.set_)
