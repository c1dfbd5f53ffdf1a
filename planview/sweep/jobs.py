"""The jobs of a study, with keys that are equal exactly when nothing that decides a result changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product, starmap
from pathlib import Path
from typing import NamedTuple

from calib.errors import InputError
from calib.world import load_rigs
from planview.engine.config import Config, load_config
from planview.engine.open import TrackerName, base_config
from planview.engine.replay import FIXED_MAP_PARAMETERS, FIXED_TABLES
from planview.maps.recording import is_maps
from planview.output.resume import code_version, content_key, key_of
from planview.sweep.results import JobResult
from planview.sweep.study import Configuration, RecordingEntry, Study
from planview.trajectories.formats import truth_file
from stereo.readers import holds_pair
from stereo.readers.open import is_multi_rig, rigs_file

_COMPANIONS = frozenset((".yml", ".yaml", ".json", ".xml", ".conf"))
_TABLES = frozenset(("rig.toml", "world.toml", "camera.toml", "timestamps.csv"))
MAPS_FILE = "maps.h5"


def companion_files(path: Path) -> list[Path]:
    """Files that may belong to a recording of a single file: calibrations, times and poses in its folder."""
    if path.is_dir():
        return []
    files = sorted(path.parent.iterdir()) if path.parent.is_dir() else []
    known = [file for file in files if file.suffix.lower() in _COMPANIONS or file.name in _TABLES]
    return [file for file in known if file.name not in (path.name, "truth.csv", "gt.txt") and file.is_file()]


@dataclass(frozen=True)
class RunJob:
    """One run into a folder of its own, which is there when the run is finished; ``key``: what the result depends on;
    ``version``: the ``code_version`` that must run it."""

    source: RecordingEntry
    config: Config
    tracker: TrackerName
    frames: int
    key: str
    folder: Path
    version: str
    save_maps: bool = False
    report: bool = False


@dataclass(frozen=True)
class StudyJob:
    """A run of a study: a configuration on a recording with a seed; its source is a plan-view recording where ``maps``
    makes one first."""

    name: str
    configuration: Configuration
    seed: int
    run: RunJob
    maps: RunJob | None = None
    truth: Path | None = None
    truth_key: str = ""

    @property
    def key(self) -> str:
        return f"{self.run.key}-{self.truth_key}"


Planned = StudyJob | JobResult
"""A run, or why it cannot begin."""


_Keyed = tuple[Config, str]


def planned(study: Study, out: Path, names: Sequence[str], configurations: Sequence[Configuration]) -> list[Planned]:
    """The jobs of a study (arguments of ``run_study``), configuration by configuration, recording by recording, seed by
    seed. Raises InputError: a setting that is no parameter or out of its range."""
    recordings = [_looked_at(entry, name) for entry, name in zip(study.recordings, names, strict=True)]
    for configuration in configurations:
        load_config(study.config, configuration.settings)

    @cache  # recordings that begin with the same parameters share their configurations: there may be RUNS_MAX runs
    def effective(configuration: Configuration, seed: int, base: Config) -> tuple[_Keyed, _Keyed]:
        """The full configuration of a run, and that which records its plan-view maps."""
        full = load_config(study.config, [*configuration.settings, f"seed={seed}"], base)
        points = points_config(full)
        full_key, points_key = (key_of(config.model_dump(mode="json")) for config in (full, points))
        return (full, full_key), (points, points_key)

    def run_job(source: RecordingEntry, source_key: str, keyed: _Keyed, kind: str) -> RunJob:
        version, (config, config_key), frames = code_version(), keyed, study.frames
        key = key_of(source_key, config_key, study.tracker, frames, version, kind)
        report = study.reports and kind == "jobs"
        return RunJob(source, config, study.tracker, frames, key, out / kind / key, version, kind == "maps", report)

    def job(configuration: Configuration, recording: _Recording, seed: int) -> Planned:
        if recording.error:
            return JobResult(recording.name, configuration, seed, error=recording.error)
        entry, maps = recording.entry, None
        full, points = effective(configuration, seed, recording.base)
        single = is_maps(entry.path) or is_multi_rig(entry.path) or study.tracker == "human-model"
        if study.maps and not single and (study.tracker == "joint" or entry.calibration or holds_pair(entry.path)):
            maps = run_job(entry, recording.key, points, "maps")
        source = RecordingEntry(path=maps.folder / MAPS_FILE) if maps else entry
        run = run_job(source, maps.key if maps else recording.key, full, "jobs")
        return StudyJob(recording.name, configuration, seed, run, maps, recording.truth, recording.truth_key)

    return list(starmap(job, product(configurations, recordings, study.seeds)))


class _Recording(NamedTuple):
    """What all jobs of a recording share; ``error``: why there are none; ``base``: its first configuration."""

    entry: RecordingEntry
    name: str
    error: str = ""
    key: str = ""
    base: Config = Config()
    truth: Path | None = None
    truth_key: str = ""


def _looked_at(entry: RecordingEntry, name: str) -> _Recording:
    path = entry.path
    try:
        # Several heads may lie anywhere, a calibration next to a video.
        if is_maps(path):
            key = content_key(path)
        elif is_multi_rig(path):
            file = rigs_file(path)
            key = key_of(content_key(file), *(content_key(file.parent / rig.folder) for rig in load_rigs(file)))
        else:
            key = key_of(content_key(path), *(content_key(file) for file in companion_files(path)))
        key = key_of(key, *(content_key(file) if file else "" for file in (entry.calibration, entry.camera)))
        truth = entry.truth or truth_file(path.parent if is_maps(path) else path)
        return _Recording(entry, name, "", key, base_config(path), truth, content_key(truth) if truth else "")
    except InputError as error:
        return _Recording(entry, name, str(error))


def points_config(config: Config) -> Config:
    """The configuration that records plan-view maps for a run: all that decides points, of the rest the defaults."""
    defaults = Config()
    maps = defaults.maps.model_copy(update={name: getattr(config.maps, name) for name in FIXED_MAP_PARAMETERS})
    return defaults.model_copy(update={"maps": maps, **{name: getattr(config, name) for name in FIXED_TABLES}})
