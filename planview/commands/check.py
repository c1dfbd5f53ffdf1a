"""``planview check``: what a recording holds, and whether it can be trusted."""

from __future__ import annotations

import shlex
from dataclasses import replace

from calib.errors import WorkError
from planview.api import check as api
from planview.api.contents import Contents
from planview.api.result import Result
from planview.commands.options import say, typed
from planview.commands.shell import JSON, Call, command

_OPENS = "calibration", "topics", "fps"
"""Options that a recording is opened with, by every command."""


def _recording_words(call: Call) -> str:
    """The recording as it was typed, with the options that open it."""
    words = [call["recording"]]
    if call["right"] is not None:
        words.append(call["right"])
    for name in _OPENS:
        if call[name] is not None:
            words += [f"--{name}", str(call[name]).removesuffix(".0")]
    return shlex.join(map(str, words))


@command(api.check, own=JSON)
def check(call: Call) -> None:
    """Example: planview check recording --person-height 1.78m --out pictures

    Example of its contents only, without looking at its images: planview check recording.bag --quick
    """
    result = call()
    recording = _recording_words(call)
    if call["quick"]:
        _print_contents(call, result, recording)
        return
    if not call.prints_json(result.to_json()):
        print(result)
    for path in result.files:
        say(f"wrote {path}")
    if call["out"] and not result.files:
        say(f"{call['out']}: no pictures were written, because there is no depth to show")
    rig = call["corrected_rig"]
    correction = result.to_json()["correction"]
    if correction:
        way = f"planview check {recording} --corrected-rig rig.toml writes the corrected calibration"
        say(f"wrote {rig}" if rig else way)
    failed = [check.name for check in result.value if check.failed]
    if failed:
        count = f"{len(failed)} of {len(result.value)} checks failed"
        has_depth = "valid disparity" in {check.name for check in result.value}
        pictures = "; --out FOLDER draws a frame with its depth" * (has_depth and not call["out"])
        raise WorkError(f"{call['recording']}: {count}: {', '.join(failed)}{pictures}")
    if rig and not correction:
        raise WorkError(f"{rig} was not written: there is nothing to correct in the calibration")


def _print_contents(call: Call, result: Result[Contents], recording: str) -> None:
    missing = [typed(error) for error in result.value.missing]
    values = result.to_json() | {"missing": missing}
    if call.prints_json(values):
        return
    if fps := values.get("fps"):
        values |= {"frames": f"{values['frames']} at {fps:.3f} per second", "fps": ""}
    print(replace(result, values=values))
    if not missing:
        print(f"Next: planview run {recording} --out out --rrd")
