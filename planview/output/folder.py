"""The output folder of a run: files that are valid up to the last finished frame, whatever happens."""

from __future__ import annotations

from fnmatch import fnmatch
from pathlib import Path

from calib.errors import InputError, WorkError
from calib.io import PART, reason
from planview.output.info import RunInfo, read_run_info
from planview.output.lock import check_unlocked, folder_lock

_NAMES = (
    "tracks.csv", "tracks_online.csv", "tracks_before.csv", "edits.json", "refinement.csv", "events.csv",
    "decisions.csv", "counts.json",
    "run.json", "run.rrd", "run-[0-9]*.rrd", "maps.h5", "maps-[0-9]*.h5", "report.html", "scene.png",
    "checkpoint.npz", "checkpoint.previous.npz",
)  # fmt: skip
_UNFINISHED = "an unfinished run; go on with --resume"
PRODUCTS = (*_NAMES, *(name + PART for name in _NAMES))
"""Names and patterns of everything that a run may leave in its folder."""


def check_folder(folder: Path, overwrite: bool, recording: Path | None = None) -> None:
    """Whether results may go to a folder; to be asked before any work is done.

    Args:
        recording: the input, which must not be among the files that are replaced.

    Raises:
        InputError: another process writes into the folder, it holds results and ``overwrite`` is not set, it holds the
            input, or it is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder for the results, found a file")
    if recording is not None and _is_product(recording) and recording.resolve().parent == folder.resolve():
        raise InputError(f"{folder}: expected another folder than that of the input, found {recording} in it")
    check_unlocked(folder)
    if not overwrite:
        _refuse_results(folder)


def prepare_folder(folder: Path, overwrite: bool) -> None:
    """Make an empty place for a run; files that are not named as a run's are never touched.

    Raises:
        InputError: as ``check_folder``.
        WorkError: it cannot be made.
    """
    check_folder(folder, overwrite)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with folder_lock(folder):
            for path in products_in(folder):
                path.unlink(missing_ok=True)
    except OSError as error:
        raise WorkError(f"{folder}: cannot be written ({reason(error)})") from error


def products_in(folder: Path) -> list[Path]:
    """Files of a folder that are named as those of a run."""
    return sorted(path for pattern in PRODUCTS for path in folder.glob(pattern))


def _is_product(path: Path) -> bool:
    return any(fnmatch(path.name, pattern) for pattern in PRODUCTS)


def _refuse_results(folder: Path) -> None:
    """Results of any kind are worth keeping: of a run, finished or not, and of others who use the same names."""
    found = products_in(folder)
    if not found:
        return
    if folder / "run.json" not in found:
        names = ", ".join(path.name for path in found[:4])
        raise InputError(
            f"{folder}: holds {names}, which is no planview run's (there is no run.json); "
            "choose another folder or add --overwrite"
        )
    raise InputError(f"{folder}: holds {_run_in(folder)} or add --overwrite")


def _run_in(folder: Path) -> str:
    try:
        return _UNFINISHED if finished_run(folder) is None else "a finished run; choose another folder"
    except InputError:
        return "a run of another version; choose another folder"


def finished_run(folder: Path) -> RunInfo | None:
    """The run.json of a folder that holds a finished run, else None.

    Raises:
        InputError: there is a run.json that cannot be read.
    """
    path = folder / "run.json"
    if not path.is_file():
        return None
    info = read_run_info(path)
    return info if info.finished else None
