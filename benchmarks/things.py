"""Things that move, by themselves or with somebody: how many are tracked as people, and who is lost to them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks.options import Report, benchmark, cache_folder, scene_files, tables
from benchmarks.passes import score_table
from benchmarks.suite import SuiteJob, score_jobs
from planview.engine.config import Config
from planview.synthetic.assets import SCENES


@benchmark
def things(*, seed: Sequence[int] = (1,), cache: Path | None = None) -> Report:
    """Count the things that are tracked as people, and the people lost to things, in rendered scenes.

    False positives are rows that show a thing, misses are rows of people without a track.

    Example: python -m benchmarks things --seed 1

    Args:
        seed: Seeds of the scenes: those below 100 are for tuning, each of the others judges once.
        cache: Folder for rendered recordings; the user's cache by default.
    """
    folder = cache_folder(cache)
    files = scene_files((), SCENES / "things")
    scores, _ = score_jobs([SuiteJob(path, one, folder, None, Config()) for one in seed for path in files], 1)
    return tables(things=score_table("things", scores["online"]))
