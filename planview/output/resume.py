"""``planview run --resume``: from where an interrupted run goes on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from calib.errors import InputError
from planview.output.checkpoint.file import Checkpoint, checkpoints_in, read_checkpoint
from planview.output.checkpoint.identity import difference
from planview.output.folder import finished_run, products_in
from planview.output.frame_file import FilePosition, holds
from planview.output.info import read_run_info


def checkpoint_of(folder: Path, identity: dict[str, Any], tell: Callable[[str], None]) -> Checkpoint | None:
    """The last checkpoint in a folder that can be gone on from; None where a run begins anew.

    A damaged checkpoint, or one whose tables were changed, gives way to the one before it. A run that was interrupted
    before its first checkpoint begins anew.

    Args:
        identity: of the run that is to go on.
        tell: takes sentences about what could not be used.
    Raises:
        InputError: the checkpoint is another run's, or the folder holds results of another run.
    """
    for path in checkpoints_in(folder):
        try:
            checkpoint = read_checkpoint(path)
        except ValueError as error:
            tell(f"{path}: the checkpoint is damaged ({error}); the one before is tried")
            continue
        other = difference(checkpoint.identity, identity)
        if other:
            raise InputError(
                f"{path}: expected a checkpoint of this run, found one of {other}; add --overwrite instead of --resume "
                "to begin anew"
            )
        changed = [name for name, at in checkpoint.written["tables"].items() if not holds(folder / name, _position(at))]
        if not changed:
            return checkpoint
        tell(f"{folder / changed[0]}: changed since {path.name} was written; the checkpoint before is tried")
    _refuse_other_run(folder, identity)
    if products_in(folder):
        tell(f"{folder}: holds no checkpoint to go on from; the run begins anew")
    return None


def is_finished(folder: Path) -> bool:
    """Whether nothing is left to go on with."""
    return folder.is_dir() and finished_run(folder) is not None


def _position(values: list[int]) -> FilePosition:
    return FilePosition(*values)


def _refuse_other_run(folder: Path, identity: dict[str, Any]) -> None:
    """What lies in a folder without a checkpoint is replaced only where it is this run's beginning."""
    if not products_in(folder):
        return
    path = folder / "run.json"
    info = read_run_info(path) if path.is_file() else None
    if info is None or info.config != identity["configuration"] or info.tracker != identity["settings"]["tracker"]:
        raise InputError(f"{folder}: expected the beginning of this run, found another; --overwrite replaces it")
