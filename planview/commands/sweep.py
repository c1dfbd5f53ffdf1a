"""``planview sweep``."""

from __future__ import annotations

from calib.errors import WorkError
from planview.api import sweep as api
from planview.commands.options import say
from planview.commands.shell import JSON, QUIET, Call, command

FAILED_MAX = 20
"""Failed runs that are printed; summary.csv has them all."""


@command(api.sweep, own=JSON | QUIET)
def sweep(call: Call) -> None:
    """Example: planview sweep STUDY.toml --jobs 4

    Example of STUDY.toml:
        recordings = ["hall/*"]
        seeds = [0, 1]
        [parameters]
        foreground.beta = [6, 12, 24]
        joint.birth_evidence = [4, 8]

    Example without a file: planview sweep rec1 rec2 --out tried --vary foreground.beta=6,12 --vary seed=1,2
    """
    found = call()
    if not call.prints_json(found.to_json()):
        print(found)
        print(found.files[0])
    failed = [run for run in found.value if run.error]
    for run in failed[:FAILED_MAX]:
        say(f"failed: {run.recording}, {run.configuration.label}, seed {run.seed}: {run.error}")
    if len(failed) > FAILED_MAX:
        say(f"and {len(failed) - FAILED_MAX} more, in summary.csv")
    if failed:
        raise WorkError(f"{len(failed)} of {len(found.value)} runs failed; the others are done")
