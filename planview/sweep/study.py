"""``STUDY.toml``: what is tracked, with which parameters, and what decides."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, field_validator

from calib.errors import InputError
from calib.io import reason
from calib.params import Params, first_problem
from planview.engine.factory import TrackerName
from planview.sweep.figures import FigureName
from planview.sweep.space import Space

SIZE_MAX = 1_000_000
"""Largest study file [bytes]."""


class RecordingEntry(Params):
    """A recording with files that do not lie in it."""

    path: Path
    """Recording as ``planview run`` takes it, or maps.h5; relative to the study file."""
    calibration: Path | None = None
    """Calibration of the stereo pair, when it does not lie in the recording."""
    camera: Path | None = None
    """camera.toml of a single camera."""
    truth: Path | None = None
    """Truth, when it is not truth.csv, gt.txt or gt/gt.txt in the recording (or beside maps.h5)."""


class Study(Params):
    """All of a study file. Relative paths are relative to its folder."""

    recordings: list[RecordingEntry] = Field(min_length=1)
    """Paths, patterns such as "hall/*", or tables with path, calibration, camera and truth."""
    config: Path | None = None
    """TOML file with parameters that all runs share."""
    tracker: TrackerName = "template"
    """The tracker of all runs."""
    frames: int = Field(0, ge=0)
    """Stop each run after so many frames; 0 for all."""
    seeds: list[int] = Field([0], min_length=1)
    """Seeds of the random generators: every configuration runs once with each."""
    method: Literal["grid", "random", "optuna"] = "grid"
    """All combinations; so many drawn independently; or so many that Optuna proposes from the results so far."""
    samples: int = Field(20, ge=1, le=100_000)
    """Configurations that "random" and "optuna" try."""
    search_seed: int = Field(0, ge=0)
    """Seed of the draws of "random" and "optuna"."""
    objective: FigureName = "mota"
    """The figure that ranks configurations and that Optuna improves."""
    maps: bool = True
    """Record the plan-view maps once per recording and set of parameters that decide them, with the default tracker,
    and track these: much faster. Runs with another tracker are then an approximation, since the recording's tracker
    gave the feedback to its foreground. False runs everything from the images."""
    reports: bool = False
    """Write report.html of every single run, too."""
    parameters: dict[str, Space] = Field(default_factory=dict)
    """A list of values, or a table with min and max (and log, step), per parameter, e.g. "template.width_m"."""

    @field_validator("seeds")
    @classmethod
    def _different(cls, seeds: list[int]) -> list[int]:
        if len(set(seeds)) < len(seeds) or min(seeds) < 0:
            raise ValueError(f"expected different seeds from 0, found {seeds}")
        return seeds


def load_study(path: Path) -> Study:
    """Read a study file.

    Raises:
        InputError: unreadable, an unknown key, a value out of range, or a pattern that matches nothing.
    """
    try:
        if path.stat().st_size > SIZE_MAX:
            raise InputError(f"{path}: expected a study of up to {SIZE_MAX} bytes, found {path.stat().st_size}")
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected a study in TOML, found {reason(error)}") from error
    try:
        tables["recordings"] = _entries(tables.get("recordings", []), path.parent)
        tables["parameters"] = _flat(tables.get("parameters", {}))
        if "config" in tables:
            tables["config"] = path.parent / str(tables["config"])
        return Study.model_validate(tables)
    except ValidationError as error:
        raise InputError(f"{path}: {first_problem(error)}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


@dataclass(frozen=True)
class Varied:
    """``--vary`` options: values per parameter, and the seeds where the parameter is ``seed``."""

    parameters: dict[str, Space]
    seeds: list[int]


def varied(options: Sequence[str]) -> Varied:
    """Parse ``table.key=value,value``.

    Raises:
        InputError: another text, or a value that is there twice.
    """
    parameters: dict[str, Space] = {}
    for text in options:
        name, equals, values = text.partition("=")
        listed = [_value(value) for value in values.split(",")]
        if not equals or not values:
            raise InputError(f"--vary: expected table.key=value,value, found {text!r}")
        if len(set(map(repr, listed))) < len(listed) or name in parameters:
            raise InputError(f"--vary: expected different settings for every run, found one twice in {text!r}")
        parameters[name.strip()] = listed
    seeds = parameters.pop("seed", [0])
    assert isinstance(seeds, list)
    if not all(isinstance(seed, int) and seed >= 0 for seed in seeds):
        raise InputError(f"--vary: expected whole numbers from 0 for seed, found {seeds}")
    return Varied(parameters, seeds)


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text.strip()


def _entries(listed: Any, folder: Path) -> list[dict[str, Any]]:
    if not isinstance(listed, list):
        raise InputError(f"expected a list of recordings, found {str(listed)[:80]!r}")
    return [entry for item in listed for entry in _entry(item, folder)]


def _entry(item: Any, folder: Path) -> list[dict[str, Any]]:
    if isinstance(item, dict):
        return [{key: folder / str(value) for key, value in item.items()}]
    text = str(item)
    if not any(sign in text for sign in "*?["):
        return [{"path": folder / text}]
    root, pattern = (Path("/"), text.lstrip("/")) if text.startswith("/") else (folder, text)
    found = sorted(root.glob(pattern))
    if not found:
        raise InputError(f"expected recordings matching {text!r}, found none")
    return [{"path": path} for path in found]


def _flat(tables: Any, prefix: str = "") -> dict[str, Any]:
    """Dotted names: TOML reads ``template.width_m = [...]`` as a table in a table."""
    if not isinstance(tables, dict):
        raise InputError(f"expected a table of parameters, found {str(tables)[:80]!r}")
    flat: dict[str, Any] = {}
    for key, value in tables.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict) and not {"min", "max"} <= value.keys():
            flat |= _flat(value, f"{name}.")
        else:
            flat[name] = value
    return flat
