"""The output folder of a run: run.json, what may be overwritten, and the lock of its writer."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path
from typing import IO, Literal, TypeVar

from pydantic import BaseModel, Field, JsonValue, ValidationError

from calib.errors import InputError, WorkError
from calib.io import PART, expecting, reason, write_whole
from calib.params import first_problem
from planview.engine.info import CameraInfo, FloorInfo, InfoPart
from planview.trajectories.formats import FORMATS
from stereo.recording import OpenOptions


class HoldsResultsError(InputError):
    """Results in a folder are in the way of a run; ``resumable``: they are those of an interrupted run."""

    def __init__(self, message: str, resumable: bool = False) -> None:
        super().__init__(message)
        self.resumable = resumable


class SkippedFrame(InfoPart):
    """A frame that could not be used."""

    index: int
    """Frame, from 0."""
    why: str


class RunWarning(InfoPart):
    """A check of the recording that failed before or during the run."""

    name: str
    """As ``planview check`` calls it."""
    value: float | None = None
    """Value found; None when it could not be measured."""
    unit: str = ""
    text: str
    """Sentence on what was expected and found."""


class RunInfo(InfoPart):
    """All of run.json. Every field has a default, so that a page can be made of what there is."""

    input: str = ""
    """The recording as given."""
    recording: str = ""
    """Its absolute path; empty for a camera that runs."""
    opened: OpenOptions = OpenOptions()
    size_px: tuple[int, int] | None = None
    """(width, height) of the images in whose pixels the boxes of tracks.csv are."""
    fps: float | None = None
    """Nominal frames per second."""
    start_s: float | None = None
    end_s: float | None = None
    """Beginning of the first frame and end of the last one, as tracks.csv has times [s]; None before the first."""
    plane: Literal["", "floor", "image"] = ""
    """Plane of people's places: the floor in metres, or the image alone."""
    first_frame: int = 0
    """Frame of the recording that the run began with."""
    tracker: str = ""
    """"joint", "human-model" or "ellipse-particle"."""
    own_parts: dict[str, str] = Field(default_factory=dict)
    """Parts that the user gave (``matcher``, ``tracker``, ``sensor``, ``detections``): their class, with their identity
    where they have one, or their file."""
    state: Literal["", "running", "interrupted", "finished"] = ""
    """"running" while it runs, and after it was killed; "interrupted" when it was stopped or failed."""
    finished: bool = False
    """The run came to its end; false while it runs and when it was interrupted."""
    started_at: str = ""
    """ISO 8601 time with zone."""
    elapsed_s: float = 0.0
    versions: dict[str, str] = Field(default_factory=dict)
    """planview, Python and the libraries that matter."""
    config: dict[str, JsonValue] = Field(default_factory=dict)
    """The full effective configuration, a table per stage."""
    refined: bool = False
    """tracks.csv was refined after the run (``planview refine``); tracks_online.csv holds the online tracks."""
    frames_read: int = 0
    frames_skipped: int = 0
    skipped: list[SkippedFrame] = Field(default_factory=list)
    """The skipped frames (the first 1000) and why."""
    notes: list[str] = Field(default_factory=list)
    """Sentences on what the reader of the recording assumed, repaired or missed, and on the size of people that a
    tracker learned."""
    rig: CameraInfo | None = None
    floor: FloorInfo | None = None
    stages_ms: dict[str, float | None] = Field(default_factory=dict)
    """Median time of every stage per frame [ms], in the order of the pipeline."""
    people: int = 0
    """Ids that were confirmed for at least half a second in all."""
    remark: str = ""
    """Sentence for readers of the results, e.g. why there are none."""
    warnings: list[RunWarning] = Field(default_factory=list)
    """Why the tracks may be wrong although the run finished: checks of the recording that failed."""
    counts: dict[str, JsonValue] = Field(default_factory=dict)
    """Totals per rule when rules were given (the ``rules`` object of ``count --json``)."""


def write_run_info(info: RunInfo, path: Path) -> None:
    """Write run.json (see ``write_result``)."""
    write_result(path, info.model_dump_json(indent=2) + "\n")


def write_result(path: Path, text: str) -> None:
    """Replace a file of results in one step. Raises WorkError: it cannot be written; what was there is kept."""
    with writing(path):
        write_whole(path, text)


@contextmanager
def writing(path: Path, kept: str = "") -> Iterator[None]:
    """Raise WorkError, with the reason and what is kept, where a file or folder cannot be written."""
    try:
        yield
    except OSError as error:
        raise WorkError(f"{path}: cannot be written ({reason(error)}){kept}") from error


def unfinished_note(tracks: Path) -> str:
    """A sentence where tracks are of a run that has not finished; empty elsewhere (errors of ``read_run_info``)."""
    path = tracks.parent / "run.json"
    if tracks.name != "tracks.csv" or not path.is_file():
        return ""
    info = read_run_info(path)
    if info.finished or not info.started_at:
        return ""
    how = "is still running or was killed" if info.state == "running" else "was interrupted"
    return f"{tracks}: the run {how}: only the frames tracked so far are used (resuming the run finishes it)"


Model = TypeVar("Model", bound=BaseModel)


def read_model(path: Path, model: type[Model], what: str) -> Model:
    """Read a JSON file. Raises InputError: unreadable, or a value of another kind."""
    with expecting(path, what, OSError, UnicodeDecodeError):
        try:
            return model.model_validate_json(path.read_text(encoding="utf-8"))
        except ValidationError as error:
            raise InputError(f"{path}: expected {what}: {first_problem(error)}") from error


def read_run_info(path: Path) -> RunInfo:
    """Read run.json (errors of ``read_model``)."""
    return read_model(path, RunInfo, "a run.json")


LOCK_NAME = "run.lock"


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold a folder, made if need be, until the block ends: it belongs to this call alone, not to the whole process.

    The system's lock on ``run.lock`` ends with its process. Raises InputError: another call holds the folder, in this
    process or in another one. WorkError: the lock file cannot be written.
    """
    place = folder.resolve()
    with writing(folder):
        place.mkdir(parents=True, exist_ok=True)
        file = _open_lock(place / LOCK_NAME)
    with file:
        try:
            yield
        finally:
            (place / LOCK_NAME).unlink(missing_ok=True)


def refuse_held(folder: Path) -> None:
    """Raise InputError for a folder that another call holds."""
    if (folder / LOCK_NAME).is_file():
        with folder_lock(folder):
            pass


def _open_lock(path: Path) -> IO[str]:
    """Lock the file, and write our name into it."""
    while True:
        file = path.open("a+", encoding="utf-8", errors="replace")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.seek(0)
            owner = file.read(1000).strip() or "another process"
            file.close()
            raise InputError(
                f"{path.parent}: {owner} is writing into it; wait for it or choose another folder"
            ) from error
        # Its owner may have removed it after we opened it: then the lock is on a file that nobody else sees.
        if path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat()):
            file.truncate(0)
            file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
            file.flush()
            return file
        file.close()


_NAMES = (
    "tracks.csv", "tracks_online.csv", "tracks_before.csv", "edits.json", "refinement.csv", "events.csv",
    "decisions.csv", "counts.json",
    "run.json", "run.rrd", "run-[0-9]*.rrd", "maps.h5", "maps-[0-9]*.h5", "report.html", "scene.png",
    "checkpoint.npz",
)  # fmt: skip
PRODUCTS = (*_NAMES, *(name + PART for name in _NAMES))
"""Names and patterns of everything that a run may leave in its folder."""
_VIEWS = (
    "plot.png", "scene.webm", "frame-[0-9]*.png", "replay-[0-9]*.png", "evaluation.json",
    *(f"tracks*_{name}{form.suffix}" for name, form in FORMATS.items()),
)  # fmt: skip
"""Default names of pictures and exports of a run."""


def check_folder(folder: Path, overwrite: bool, recording: Path | None = None) -> None:
    """Check that results can go to a folder, before any work is done; the input ``recording`` must not be replaced.

    Raises:
        HoldsResultsError: it holds results and ``overwrite`` is not set.
        InputError: the folder holds the input, it is a file, or what is named as a file of a run in it is none (a pipe
            could wait for ever).
        WorkError: files cannot be written there.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder for the results, found a file")
    try:  # a file without a name where the folder is or will be
        place = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        why = "files cannot be created there" if error.errno == errno.ENOENT else reason(error)
        raise WorkError(f"{folder}: cannot be written ({why})") from error
    name = ""
    if recording is not None and recording.resolve().parent == folder.resolve():
        name = recording.name
    if any(fnmatch(name, pattern) for pattern in PRODUCTS):
        raise InputError(f"{folder}: expected another folder than that of the input, found {recording} in it")
    products = products_in(folder)
    for path in [*products, *folder.glob(LOCK_NAME)]:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: expected a file of a run, found a folder, a pipe or a device")
    if overwrite or not products:
        return
    # Results of any kind are worth keeping: of a run, finished or not, and of others who use the same names.
    if folder / "run.json" not in products:
        names = ", ".join(path.name for path in products[:4])
        raise HoldsResultsError(f"{folder}: contains {names} but no run.json, so it was not written by planview")
    try:
        resumable = finished_run(folder) is None
    except InputError:
        raise HoldsResultsError(f"{folder}: contains a run of another version of planview") from None
    raise HoldsResultsError(f"{folder}: contains {'an unfinished' if resumable else 'a finished'} run", resumable)


def prepare_folder(folder: Path, overwrite: bool, recording: Path | None = None) -> None:
    """Make an empty place for a run in a folder that the caller holds, without anything of an earlier run; other files
    are never touched (errors of ``check_folder``)."""
    check_folder(folder, overwrite, recording)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for path in [*_views_in(folder, recording), *products_in(folder)]:
            path.unlink(missing_ok=True)


def _views_in(folder: Path, recording: Path | None) -> list[Path]:
    """Files that were drawn and exported of the run in a folder; none where a recording lies in the folder, whose
    images may have such names."""
    try:
        earlier = read_run_info(folder / "run.json")
    except InputError:
        return []  # no run, or one of another version
    place = folder.resolve()
    for path in (recording, Path(earlier.recording or earlier.input)):
        if path is not None and path.resolve().is_relative_to(place):
            return []
    return [path for pattern in _VIEWS for path in folder.glob(pattern) if path.is_file()]


def products_in(folder: Path) -> list[Path]:
    """Files of a folder that are named as those of a run."""
    return sorted(path for pattern in PRODUCTS for path in folder.glob(pattern))


def rrd_parts(path: Path) -> list[Path]:
    """A recording's files in their order: a long run has several, a resumed one too."""
    later = sorted(path.parent.glob(f"{path.stem}-[0-9]*.rrd"), key=lambda part: int(part.stem.rpartition("-")[2]))
    return [path, *later]


def finished_run(folder: Path) -> RunInfo | None:
    """The run.json of a finished run, else None. Raises InputError: a run.json that cannot be read."""
    path = folder / "run.json"
    if not path.is_file():
        return None
    info = read_run_info(path)
    return info if info.finished else None
