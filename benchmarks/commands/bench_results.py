"""``python -m benchmarks results``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
from rich.console import Console

from benchmarks.failure_picture import FailedRun, failure_picture
from benchmarks.results import Failure, failures, load_report, results_page, shown
from calib.errors import InputError, WorkError
from calib.io import reason, write_whole
from planview.evaluation.significant import SignificantError
from planview.trajectories.table import read_tracks, read_truth

QUALITY = 70
"""Quality of the JPEG pictures [%]: about 30 kB each."""


def bench_results(
    suite: Path, *, ablation: Path | None = None, out: Path = Path("docs/results.md"), pictures: int = 24
) -> None:
    """Write the page of results from what suite and ablation measured, with pictures of the failures.

    Run `python -m benchmarks suite --seed ... --refine --peer --out DIR` and `python -m benchmarks ablation ...
    --out FILE` first;
    their recordings and runs must still be in the cache.

    Example: python -m benchmarks results suite/suite.json --ablation ablation.json

    Parameters
    ----------
    suite
        suite.json of `python -m benchmarks suite --out`.
    ablation
        JSON of `python -m benchmarks ablation --out`; none by default.
    out
        The page; pictures go into a folder of its name beside it.
    pictures
        At most so many pictures, of every kind of failure in turn the longest.
    """
    if pictures < 0:
        raise InputError(f"--pictures: expected 0 or more, found {pictures}")
    measured = load_report(suite, "online")
    compared = load_report(ablation, "variants") if ablation else None
    found = _pictured(failures(measured), out.with_suffix(""), pictures)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(out, results_page(measured, compared, found))
    except OSError as error:
        raise WorkError(f"{out}: cannot be written: {reason(error)}") from error
    Console(stderr=True, markup=False).print(f"{out}: {len(found)} failures")


def _pictured(found: Sequence[Failure], folder: Path, limit: int) -> list[Failure]:
    """The failures, some of them with pictures, which replace those of an earlier page."""
    chosen, result = shown(found, limit), []
    for old in folder.glob("*.jpg"):
        old.unlink()
    for failure in found:
        if any(failure is one for one in chosen):
            e = failure.error
            name = f"{failure.scene['scene']}-{failure.scene['seed']}-{e['frame']:04d}-{e['kind']}-{e['truth_id']}.jpg"
            folder.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / name), _picture(failure), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
            failure = replace(failure, picture=name)
        result.append(failure)
    return result


def _picture(failure: Failure) -> cv2.typing.MatLike:
    scene = failure.scene
    recording, folder = Path(scene["recording"]), Path(scene["out"])
    run = FailedRun(recording, folder, read_tracks(folder / "tracks.csv"), read_truth(recording / "truth.csv"))
    return failure_picture(run, SignificantError(**failure.error), scene["frames"] / scene["duration_s"])
