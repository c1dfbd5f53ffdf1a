"""``STUDY.toml``: what is tracked, with which parameters, and which figure decides."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, ValidationError, field_validator, model_validator

from calib.errors import InputError
from calib.io import load_toml
from calib.params import Params, first_problem
from planview.engine.open import TrackerName
from planview.output.folder import RunInfo

FigureName = Literal[
    "mota", "idf1", "hota", "significant_errors", "switches", "position_error_mean_m", "height_error_mean_m",
    "people", "elapsed_s",
]  # fmt: skip
RUNS_MAX = 50_000
"""Runs of a study: more take weeks on a cluster, and are a slip of the hand."""


class Figure(NamedTuple):
    """How a figure is called, printed and judged; ``better`` is +1 where more is better, -1 where less is."""

    label: str
    digits: int
    better: int


FIGURES: dict[FigureName, Figure] = {
    "mota": Figure("MOTA", 3, 1), "idf1": Figure("IDF1", 3, 1), "hota": Figure("HOTA", 3, 1),
    "significant_errors": Figure("significant errors", 2, -1), "switches": Figure("switches", 2, -1),
    "position_error_mean_m": Figure("position error [m]", 3, -1),
    "height_error_mean_m": Figure("height error [m]", 3, -1),
    "people": Figure("people", 1, 1), "elapsed_s": Figure("tracking time [s]", 1, -1),
}  # fmt: skip


def run_figures(info: RunInfo, scores: dict[str, Any]) -> dict[str, float]:
    """Figures of a run from its scores (``Evaluation.to_json``; empty without truth); those that the data cannot give
    are left out."""
    found = {name: scores.get(name) for name in FIGURES} | {"people": info.people, "elapsed_s": info.elapsed_s}
    found["significant_errors"] = scores.get("significant_errors", {}).get("total")
    return {name: float(value) for name, value in found.items() if value is not None}


class Range(Params):
    """Numbers from min to max; whole ones where all of min, max and step are."""

    min: int | float
    max: int | float
    step: int | float | None = None
    """Only min, min + step, ...; not together with log."""
    log: bool = False
    """Values are even in the logarithm."""

    @model_validator(mode="after")
    def _ordered(self) -> Range:
        if not self.min < self.max:
            raise ValueError(f"expected min below max, found {self.min} and {self.max}")
        if self.step is not None and (self.log or self.step <= 0):
            raise ValueError(f"expected a step above 0 and without log, found {self.step}")
        if self.log and self.min <= 0:
            raise ValueError(f"expected min above 0 with log, found {self.min}")
        return self

    @property
    def steps(self) -> int:
        """Number of values of a range with a step."""
        return int(min((self.max - self.min) / (self.step or 1), 1e9) + 1e-9) + 1

    def nth(self, number: int) -> int | float:
        """A value of a range with a step."""
        value = self.min + (self.step or 1) * number
        return float(f"{value:.9g}") if isinstance(value, float) else value

    def at(self, fraction: float) -> int | float:
        """The value a fraction (0 to below 1) of the way through the range."""
        if self.step is not None:
            return self.nth(int(fraction * self.steps))
        is_whole = isinstance(self.min, int) and isinstance(self.max, int)
        if is_whole and not self.log:
            return int(self.min + math.floor(fraction * (self.max - self.min + 1)))
        low, high = (math.log(self.min), math.log(self.max)) if self.log else (self.min, self.max)
        value = low + fraction * (high - low)
        value = math.exp(value) if self.log else value
        return min(self.max, round(value)) if is_whole else float(f"{value:.6g}")


Choices = Annotated[list[Any], Field(min_length=1)]
Space = Choices | Range


@dataclass(frozen=True)
class Configuration:
    """Values of the varied parameters, as texts like ``joint.stay_s=0.4`` in the order of the study."""

    settings: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        return " ".join(self.settings) or "defaults"

    def value(self, name: str) -> str:
        """The text of a parameter's value; empty where it is not varied."""
        return next((s.partition("=")[2] for s in self.settings if s.partition("=")[0] == name), "")


class RecordingEntry(Params):
    """A recording with files that do not lie in it."""

    path: Path
    """Recording as ``planview run`` takes it, or maps.h5; relative to the study file."""
    calibration: Path | None = None
    """Calibration of the stereo pair, when it does not lie in the recording."""
    camera: Path | None = None
    """camera.toml of a single camera."""
    fps: float | None = Field(None, ge=0.01, le=10_000)
    """Frames per second, where times are missing or wrong."""
    truth: Path | None = None
    """Truth, when it is not truth.csv, gt.txt or gt/gt.txt in the recording (or in the folder of maps.h5)."""


class Study(Params):
    """All of a study file. Relative paths are relative to its folder."""

    recordings: list[RecordingEntry] = Field(min_length=1)
    """Paths, patterns such as "hall/*", or tables with path, calibration, camera, fps and truth."""
    config: Path | None = None
    """TOML file with parameters that all runs share."""
    tracker: TrackerName = "joint"
    """The tracker of all runs."""
    frames: int = Field(0, ge=0)
    """Stop each run after this many frames; 0 for all."""
    seeds: list[int] = Field([0], min_length=1)
    """Seeds of the random generators: every configuration runs once with each."""
    method: Literal["grid", "random"] = "grid"
    """All combinations; or ``samples`` random ones."""
    samples: int = Field(20, ge=1, le=RUNS_MAX)
    """Configurations that "random" tries."""
    search_seed: int = Field(0, ge=0)
    """Seed of the draws of "random"."""
    objective: FigureName = "mota"
    """The figure that ranks configurations."""
    maps: bool = True
    """Record the plan-view maps once per recording and set of parameters that decide them, with the default tracker,
    and track these: much faster. Runs with another tracker are then an approximation, since the recording's tracker
    gave the feedback to its foreground. False runs everything from the images."""
    reports: bool = False
    """Write report.html of every single run, too."""
    parameters: dict[str, Space] = Field(default_factory=dict)
    """A list of values, or a table with min and max (and log, step), per parameter, e.g. "joint.stay_s"."""

    @field_validator("seeds")
    @classmethod
    def _different(cls, seeds: list[int]) -> list[int]:
        if len(set(seeds)) < len(seeds) or min(seeds) < 0:
            raise ValueError(f"expected different seeds from 0, found {str(seeds)[:80]}")
        return seeds

    def configurations(self) -> list[Configuration]:
        """All combinations, the last parameter fastest; or independent draws, each once, fewer where there are fewer.
        Raises InputError: a grid over a range without step, or more than RUNS_MAX runs."""
        count = self.samples if self.method == "random" else self._combinations()
        runs = count * len(self.recordings) * len(self.seeds)
        if runs > RUNS_MAX:
            raise InputError(
                f"expected a study of up to {RUNS_MAX} runs, found {runs} "
                f"({count} configurations x {len(self.recordings)} recordings x {len(self.seeds)} seeds)"
            )
        found: dict[Configuration, None] = {}
        for values in self._draws() if self.method == "random" else self._grid():
            settings = (f"{name}={json.dumps(value)}" for name, value in zip(self.parameters, values, strict=True))
            found[Configuration(tuple(settings))] = None
            if len(found) == count:
                break
        return list(found)

    def _combinations(self) -> int:
        """Number of all combinations of a grid."""
        for name, space in self.parameters.items():
            if isinstance(space, Range) and space.step is None:
                raise InputError(f"parameters.{name}: expected a list or a step for a grid, found a range without step")
        return math.prod(len(space) if isinstance(space, list) else space.steps for space in self.parameters.values())

    def _grid(self) -> Iterator[tuple[Any, ...]]:
        spaces = self.parameters.values()
        return itertools.product(*(s if isinstance(s, list) else map(s.nth, range(s.steps)) for s in spaces))

    def _draws(self) -> Iterator[tuple[Any, ...]]:
        """Many more than are needed, since some are equal."""
        generator = np.random.default_rng(self.search_seed)
        for _ in range(20 * self.samples):
            sampled = [(space, float(generator.random())) for space in self.parameters.values()]
            yield tuple(s.at(at) if isinstance(s, Range) else s[int(at * len(s))] for s, at in sampled)


def load_study(path: Path) -> Study:
    """Read a study file. Raises InputError: a value that does not belong, or a pattern that matches nothing."""
    tables = load_toml(path, "a study in TOML")
    try:
        if not isinstance(listed := tables.get("recordings", []), list):
            raise InputError(f"expected a list of recordings, found {str(listed)[:80]!r}")
        tables["recordings"] = [entry for item in listed for entry in _entry(item, path.parent)]
        tables["parameters"] = _flat(tables.get("parameters", {}))
        if "config" in tables:
            tables["config"] = path.parent / str(tables["config"])
        return Study.model_validate(tables)
    except ValidationError as error:
        raise InputError(f"{path}: {first_problem(error)}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _entry(item: Any, folder: Path) -> list[dict[str, Any]]:
    """A recording of the study file with its files, or all that a pattern matches."""
    if isinstance(item, dict):
        return [{key: folder / str(value) for key, value in item.items()}]
    text = str(item)
    if not any(sign in text for sign in "*?["):
        return [{"path": folder / text}]
    found = sorted(Path("/").glob(text.lstrip("/")) if text.startswith("/") else folder.glob(text))
    if not found:
        raise InputError(f"no recordings match {text!r}")
    return [{"path": path} for path in found]


def _flat(tables: Any, prefix: str = "") -> dict[str, Any]:
    """Dotted names: TOML reads ``joint.stay_s = [...]`` as a table in a table."""
    if not isinstance(tables, dict):
        raise InputError(f"expected a table of parameters, found {str(tables)[:80]!r}")
    flat: dict[str, Any] = {}
    for key, value in tables.items():
        is_space = not isinstance(value, dict) or {"min", "max"} <= value.keys()
        flat |= {prefix + key: value} if is_space else _flat(value, f"{prefix}{key}.")
    return flat
