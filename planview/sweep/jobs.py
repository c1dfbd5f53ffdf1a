"""The jobs of a study, and keys: short texts that are equal exactly when nothing that decides a result changed."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

import calib
import planview
import stereo
from calib.errors import InputError
from calib.io import reason
from calib.world import load_rigs
from planview.engine.config import Config, load_config
from planview.engine.open import TrackerName, base_config, is_stereo
from planview.engine.replay import FIXED_MAP_PARAMETERS, FIXED_TABLES
from planview.maps.recording import is_maps
from planview.sweep.study import Configuration, RecordingEntry, Study
from planview.trajectories.formats import truth_file
from stereo.readers.open import is_multi_rig, rigs_file

WHOLE_MAX = 256 * 1024
"""Files up to this size are hashed whole [bytes]."""
BLOCK_BYTES = 64 * 1024
BLOCKS = 16
"""Of larger files so many blocks are hashed, evenly spread, the first and the last among them."""
FILES_MAX = 64
"""Of so many image files at most the content is hashed; of all others name and size."""
DECIDING_ROOMS = ("foreground", "maps", "trajectories", "tracking", "checks", "engine", "evaluation")
"""Rooms of planview whose code decides tracks (what the checks find of a camera's steadiness, too) or their scores."""
_IMAGES = frozenset((".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".tif", ".tiff", ".webp", ".bin", ".raw"))
_TRUTH = frozenset(("truth.csv", "gt.txt"))
_BESIDE = frozenset((".yml", ".yaml", ".json", ".xml", ".conf"))
_TABLES = frozenset(("rig.toml", "world.toml", "camera.toml", "timestamps.csv"))
_OUTPUTS = ("run.json", "study.json")
MAPS_FILE = "maps.h5"


def key_of(*parts: object) -> str:
    """32 hexadecimal digits for JSON values."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:32]


def content_key(path: Path) -> str:
    """Of a recording's file or folder: names, sizes and sampled content, not its place or times.

    Truth, hidden files and folders with results are left out: they do not change what is tracked. Small files count
    whole; of larger ones BLOCKS blocks, of folders with more than FILES_MAX images every n-th image. A change that
    keeps every size and lies between all samples is not noticed.

    Raises:
        InputError: no such file, or it cannot be read.
    """
    try:
        if path.is_file():
            return key_of(_file_digest(path))
        if not path.is_dir():
            raise InputError(f"{path}: expected a recording, found no such file or folder")
        files = sorted(_files(path), key=lambda file: file.relative_to(path).as_posix())
        images = [file for file in files if file.suffix.lower() in _IMAGES]
        hashed = set(files) - set(images) | set(images[:: max(1, -(-len(images) // FILES_MAX))])
        listed = [
            [
                os.fsencode(file.relative_to(path)).hex(),
                file.stat().st_size,
                _file_digest(file) if file in hashed else "",
            ]
            for file in files
        ]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({reason(error)})") from error
    return key_of(listed)


def files_beside(path: Path) -> list[Path]:
    """Files that may belong to a recording of a single file: calibrations, times and poses in its folder."""
    if path.is_dir():
        return []
    files = sorted(path.parent.iterdir()) if path.parent.is_dir() else []
    known = [file for file in files if file.suffix.lower() in _BESIDE or file.name in _TABLES]
    return [file for file in known if file.name not in (path.name, *_TRUTH) and file.is_file()]


@cache
def engine_version() -> str:
    """Version of the package and a digest of the code that decides tracks and scores."""
    roots = [Path(package.__file__ or "").parent for package in (calib, stereo)]
    roots += [Path(planview.__file__ or "").parent / room for room in DECIDING_ROOMS]
    digest = hashlib.sha256()
    for root in roots:
        for file in sorted(root.rglob("*.py")):
            digest.update(file.relative_to(root.parent).as_posix().encode() + file.read_bytes())
    try:
        number = version("planview")
    except PackageNotFoundError:
        number = "source"
    return f"{number}-{digest.hexdigest()[:16]}"


def _files(folder: Path) -> Iterator[Path]:
    for parent, folders, names in os.walk(folder):
        folders[:] = [
            name for name in folders
            if not name.startswith(".") and not any(Path(parent, name, file).is_file() for file in _OUTPUTS)
        ]  # fmt: skip
        for name in names:
            if not name.startswith(".") and name not in _TRUTH and Path(parent, name).is_file():
                yield Path(parent, name)


def _file_digest(path: Path) -> str:
    size = path.stat().st_size
    digest = hashlib.sha256(str(size).encode())
    with path.open("rb") as file:
        if size <= WHOLE_MAX:
            digest.update(file.read(WHOLE_MAX))
        else:
            for block in range(BLOCKS):
                file.seek((size - BLOCK_BYTES) * block // (BLOCKS - 1))
                digest.update(file.read(BLOCK_BYTES))
    return digest.hexdigest()


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
        self._recordings = [_looked_at(entry, name) for entry, name in zip(study.recordings, names, strict=True)]
        # Recordings that begin with the same parameters share their configurations: a study may have RUNS_MAX runs.
        self._effective = cache(self._effective_of)

    def jobs(self, configurations: Sequence[Configuration]) -> list[Planned]:
        """Configuration by configuration, recording by recording, seed by seed. Raises InputError: a setting that is no
        parameter or out of its range."""
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
        entry, study, maps = recording.entry, self._study, None
        full, points = self._effective(configuration, seed, recording.base)
        single = is_maps(entry.path) or is_multi_rig(entry.path) or study.tracker == "human-model"
        if study.maps and not single and (study.tracker == "template" or is_stereo(entry.path, entry.calibration)):
            maps = self._run(entry, recording.key, points, "maps")
        source = RecordingEntry(path=maps.folder / MAPS_FILE) if maps else entry
        run = self._run(source, maps.key if maps else recording.key, full, "jobs")
        return StudyJob(recording.name, configuration, seed, run, maps, recording.truth, recording.truth_key)

    def _effective_of(self, configuration: Configuration, seed: int, base: Config) -> tuple[_Keyed, _Keyed]:
        """The full configuration of a run, and that which records its plan-view maps; ``base`` is the recording's."""
        settings = [*configuration.settings, f"seed={seed}"]
        full = load_config(self._study.config, settings, base)
        return _keyed(full), _keyed(points_config(full))

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


def _keyed(config: Config) -> _Keyed:
    return _Keyed(config, key_of(config.model_dump(mode="json")))


class _Recording(NamedTuple):
    """What all jobs of a recording share; ``error`` says why there is none, ``base`` its first configuration."""

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
        # Several heads may lie anywhere, a calibration beside a video.
        if is_maps(path):
            key = content_key(path)
        elif is_multi_rig(path):
            file = rigs_file(path)
            key = key_of(content_key(file), *(content_key(file.parent / rig.folder) for rig in load_rigs(file)))
        else:
            key = key_of(content_key(path), *(content_key(file) for file in files_beside(path)))
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
