"""The jobs of a study: one run each, and the plan-view recordings that several of them track."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from calib.errors import InputError
from calib.world import load_rigs
from planview.engine.config import Config, load_config
from planview.engine.factory import TrackerName, base_config, is_stereo
from planview.engine.maps_pipeline import FIXED_MAP_PARAMETERS, FIXED_TABLES
from planview.maps.recording import is_maps
from planview.sweep.content import content_key, engine_version, files_beside, key_of
from planview.sweep.space import Configuration
from planview.sweep.study import RecordingEntry, Study
from planview.trajectories.pairs import truth_file
from stereo.readers.open import is_heads, rigs_file

MAPS_FILE = "maps.h5"


@dataclass(frozen=True)
class RunJob:
    """One run into a folder of its own.

    Attributes:
        source: the recording with its calibration or camera.
        config: the full effective configuration.
        key: what the result depends on.
        folder: of the results; it is there when the run is finished.
        version: ``engine_version`` that must run it.
        save_maps: write the plan-view recording, too.
    """

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
    """A run of a study: a configuration on a recording with a seed.

    Attributes:
        name: the recording as the study calls it.
        run: what is run; its source is a plan-view recording where ``maps`` makes one first.
        maps: the run that records the plan-view maps, None where the recording itself is tracked.
        truth: file of truth, None where there is none.
        truth_key: content of that file.
    """

    name: str
    configuration: Configuration
    seed: int
    run: RunJob
    maps: RunJob | None = None
    truth: Path | None = None
    truth_key: str = ""

    @property
    def key(self) -> str:
        """Of the run and its scores."""
        return f"{self.run.key}-{self.truth_key}"


@dataclass(frozen=True)
class Refused:
    """A run that cannot begin, and why."""

    name: str
    configuration: Configuration
    seed: int
    error: str


Planned = StudyJob | Refused


class Planner:
    """Makes the jobs of configurations; recordings are looked at once.

    Args:
        study: with absolute paths.
        out: folder of the study.
        names: of the recordings, all different.
    """

    def __init__(self, study: Study, out: Path, names: Sequence[str]) -> None:
        self._study, self._out = study, out
        self._effective: dict[tuple[Configuration, int, str], _Effective] = {}
        self._recordings = [_Recording(entry, name) for entry, name in zip(study.recordings, names, strict=True)]

    def jobs(self, configurations: Sequence[Configuration]) -> list[Planned]:
        """Configuration by configuration, recording by recording, seed by seed.

        Raises:
            InputError: a setting that is no parameter or out of its range.
        """
        for configuration in configurations:
            load_config(self._study.config, configuration.settings)
        return [
            self._job(configuration, recording, seed)
            for configuration in configurations
            for recording in self._recordings
            for seed in self._study.seeds
        ]

    def _job(self, configuration: Configuration, recording: _Recording, seed: int) -> Planned:
        if recording.error:
            return Refused(recording.name, configuration, seed, recording.error)
        entry, study = recording.entry, self._study
        effective = self._effective_of(configuration, seed, recording)
        maps = None
        if study.maps and _records_maps(entry, study.tracker):
            maps = self._run(entry, recording.key, effective.points, "maps")
        source = RecordingEntry(path=maps.folder / MAPS_FILE) if maps else entry
        run = self._run(source, maps.key if maps else recording.key, effective.full, "jobs")
        return StudyJob(recording.name, configuration, seed, run, maps, recording.truth, recording.truth_key)

    def _effective_of(self, configuration: Configuration, seed: int, recording: _Recording) -> _Effective:
        """One object for all recordings that begin with the same parameters: a study may have 100,000 jobs."""
        name = (configuration, seed, recording.base_key)
        if name not in self._effective:
            settings = [*configuration.settings, f"seed={seed}"]
            full = load_config(self._study.config, settings, recording.base)
            self._effective[name] = _Effective(_Keyed.of(full), _Keyed.of(points_config(full)))
        return self._effective[name]

    def _run(self, source: RecordingEntry, source_key: str, config: _Keyed, kind: str) -> RunJob:
        study, version = self._study, engine_version()
        key = key_of(source_key, config.key, study.tracker, study.frames, version, kind)
        report = study.reports and kind == "jobs"
        folder = self._out / kind / key
        return RunJob(source, config.config, study.tracker, study.frames, key, folder, version, kind == "maps", report)


class _Keyed(NamedTuple):
    """A configuration and its key."""

    config: Config
    key: str

    @staticmethod
    def of(config: Config) -> _Keyed:
        return _Keyed(config, key_of(config.model_dump(mode="json")))


class _Effective(NamedTuple):
    """The full configuration of a run, and that which records its plan-view maps."""

    full: _Keyed
    points: _Keyed


class _Recording:
    """What all jobs of a recording share; ``error`` says why there is none."""

    def __init__(self, entry: RecordingEntry, name: str) -> None:
        self.entry, self.name, self.error = entry, name, ""
        self.key, self.truth_key, self.base, self.base_key = "", "", Config(), ""
        self.truth: Path | None = None
        try:
            beside = [content_key(path) if path else "" for path in (entry.calibration, entry.camera)]
            self.key = key_of(_input_key(entry.path), *beside)
            self.base = base_config(entry.path)
            self.base_key = _Keyed.of(self.base).key
            self.truth = entry.truth or truth_file(entry.path.parent if is_maps(entry.path) else entry.path)
            self.truth_key = content_key(self.truth) if self.truth else ""
        except InputError as error:
            self.error = str(error)


def _input_key(path: Path) -> str:
    """Of all that a recording is read from: several heads may lie anywhere, a calibration beside a video."""
    if is_maps(path):
        return content_key(path)
    if is_heads(path):
        file = rigs_file(path)
        return key_of(content_key(file), *(content_key(file.parent / entry.folder) for entry in load_rigs(file)))
    return key_of(content_key(path), *(content_key(file) for file in files_beside(path)))


def points_config(config: Config) -> Config:
    """The configuration that records plan-view maps for a run: all that decides points, of the rest the defaults."""
    defaults = Config()
    maps = defaults.maps.model_copy(update={name: getattr(config.maps, name) for name in FIXED_MAP_PARAMETERS})
    return defaults.model_copy(update={"maps": maps, **{name: getattr(config, name) for name in FIXED_TABLES}})


def _records_maps(entry: RecordingEntry, tracker: TrackerName) -> bool:
    if is_maps(entry.path) or is_heads(entry.path) or tracker == "human-model":
        return False
    return tracker == "template" or is_stereo(entry.path, entry.calibration)
