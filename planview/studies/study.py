"""``STUDY.toml``: what is tracked, and with which parameters."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from glob import glob, has_magic
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, field_validator

from calib.errors import InputError
from calib.io import load_toml, parse_toml
from calib.params import Params, first_problem
from planview.engine.open import TrackerName

RUNS_MAX = 50_000
"""Runs of a study: more take weeks on a cluster, and are a slip of the hand."""


@dataclass(frozen=True)
class Configuration:
    """Values of the varied parameters, as texts like ``joint.stay_s=0.4`` in the order of the study."""

    settings: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """All settings in one line."""
        return " ".join(self.settings) or "defaults"

    @property
    def values(self) -> dict[str, str]:
        """The text of each parameter's value."""
        parts = [setting.partition("=") for setting in self.settings]
        return {name: value for name, _, value in parts}


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
    parameters: dict[str, Annotated[list[Any], Field(min_length=1)]] = Field(default_factory=dict)
    """A list of values per parameter, e.g. "joint.stay_s" = [0.4, 0.5]; all combinations run."""

    @field_validator("seeds")
    @classmethod
    def _refuse_equal_seeds(cls, seeds: list[int]) -> list[int]:
        if len(set(seeds)) < len(seeds) or min(seeds) < 0:
            raise ValueError(f"expected different seeds from 0, found {str(seeds)[:80]}")
        return seeds

    @field_validator("parameters")
    @classmethod
    def _refuse_seed(cls, parameters: dict[str, list[Any]]) -> dict[str, list[Any]]:
        if "seed" in parameters:
            raise ValueError("expected the seeds of a study under seeds, found a parameter seed")
        return parameters

    def configurations(self) -> list[Configuration]:
        """All combinations of values, the last parameter fastest. Raises InputError: more than RUNS_MAX runs."""
        count = math.prod(len(values) for values in self.parameters.values())
        runs = count * len(self.recordings) * len(self.seeds)
        if runs > RUNS_MAX:
            raise InputError(
                f"expected a study of up to {RUNS_MAX} runs, found {runs} "
                f"({count} configurations x {len(self.recordings)} recordings x {len(self.seeds)} seeds)"
            )
        settings = [[f"{name}={json.dumps(value)}" for value in values] for name, values in self.parameters.items()]
        return list(dict.fromkeys(map(Configuration, itertools.product(*settings))))


def load_study(path: Path) -> Study:
    """Read a study file. Raises InputError: a value that does not belong, or a pattern that matches nothing."""
    tables = load_toml(path, "a study in TOML")
    try:
        tables["recordings"] = _list_recordings(tables.get("recordings", []), path.parent)
        tables["parameters"] = _flatten(tables.get("parameters", {}))
        if "config" in tables:
            tables["config"] = path.parent / str(tables["config"])
        return Study.model_validate(tables)
    except ValidationError as error:
        raise InputError(f"{path}: {first_problem(error)}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _list_recordings(items: Any, folder: Path) -> list[dict[str, Any]]:
    """Recordings of a study file, each with its files; a pattern stands for all paths that match."""
    if not isinstance(items, list):
        raise InputError(f"expected a list of recordings, found {str(items)[:80]!r}")
    entries: list[dict[str, Any]] = []
    for item in items:
        if isinstance(item, dict):
            entries.append({key: folder / value if isinstance(value, str) else value for key, value in item.items()})
            continue
        matches = [str(item)]
        if has_magic(matches[0]):
            matches = sorted(glob(matches[0], root_dir=folder, recursive=True))
        if not matches:
            raise InputError(f"no recordings match {item!r}")
        entries += [{"path": folder / match} for match in matches]
    return entries


def _flatten(tables: Any, prefix: str = "") -> dict[str, Any]:
    """Lists of values by dotted name: TOML reads ``joint.stay_s = [...]`` as a table in a table."""
    if not isinstance(tables, dict):
        name = prefix.rstrip(".") or "parameters"
        raise InputError(f"{name}: expected a list of values, found {str(tables)[:80]!r}")
    flat: dict[str, Any] = {}
    for key, value in tables.items():
        if isinstance(value, list):
            flat[prefix + key] = value
        else:
            flat |= _flatten(value, f"{prefix}{key}.")
    return flat


def study_of(
    sources: Sequence[Path], out: Path | None, vary: Sequence[str], config: Path | None
) -> tuple[Study, list[str], Path]:
    """The study with absolute paths, since workers may have another current folder; names of its recordings, and the
    folder for results."""
    if len(sources) == 1 and sources[0].suffix == ".toml":
        if vary or config:
            raise InputError(f"vary and config cannot be combined with a study file; write them into {sources[0]}")
        file = sources[0].absolute()
        study = load_study(file)
        folder = file.parent
        out = out or file.with_suffix("")
    else:
        if out is None:
            raise InputError("recordings without a study file need a folder for the results", argument="out")
        parameters, seeds = parse_variations(vary)
        entries = [RecordingEntry(path=path.absolute()) for path in sources]
        try:
            study = Study(recordings=entries, config=config and config.absolute(), parameters=parameters, seeds=seeds)
        except ValidationError as error:
            raise InputError(first_problem(error), argument="vary") from error
        folder = Path.cwd()
    names = [str(entry.path).removeprefix(f"{folder}/") for entry in study.recordings]
    if len({*names}) < len(names):
        raise InputError(f"expected every recording once, found {' and '.join(names)}")
    return study, names, out.absolute()


def parse_variations(options: Sequence[str]) -> tuple[dict[str, list[Any]], list[Any]]:
    """Values per parameter, and the seeds where the parameter is ``seed``."""
    parameters: dict[str, list[Any]] = {}
    for text in options:
        name, _, values = text.partition("=")
        listed = [_value(value) for value in values.split(",")]
        if not values or name in parameters or len({*map(repr, listed)}) < len(listed):
            raise InputError(f"expected table.key=value,value, all different, found {text!r}", argument="vary")
        parameters[name.strip()] = listed
    return parameters, parameters.pop("seed", [0])


def _value(text: str) -> Any:
    try:
        return parse_toml(f"value = {text}")["value"]
    except ValueError:
        return text.strip()
