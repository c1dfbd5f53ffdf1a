"""``planview sweep``."""

from __future__ import annotations

from calib.errors import WorkError
from planview.api import sweep as api
from planview.commands.options import say
from planview.commands.shell import JSON, Call, command

FAILED_MAX = 20
"""Failed runs that are printed; summary.csv has them all."""


@command(api.sweep, own=JSON)
def sweep(call: Call) -> None:
    found = call()
    if not call.prints_json(found.to_json()):
        print(found)
        print(found.out / "summary.csv")
    failed = found.failed
    for run in failed[:FAILED_MAX]:
        say(f"failed: {run.recording}, {run.configuration.label}, seed {run.seed}: {run.error}")
    if len(failed) > FAILED_MAX:
        say(f"and {len(failed) - FAILED_MAX} more, in summary.csv")
    if failed:
        raise WorkError(f"{len(failed)} of {len(found.runs)} runs failed; the others are done")
