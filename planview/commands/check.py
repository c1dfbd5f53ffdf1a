"""``planview check``: what a recording holds, and whether it can be trusted."""

from __future__ import annotations

import shlex

from calib.errors import WorkError
from planview.api import check as api
from planview.commands.options import say, typed
from planview.commands.shell import JSON, Call, command
from planview.output.progress import PlainConsole

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
    result = call()
    recording = _recording_words(call)
    if isinstance(result, api.RecordingContents):
        result.found["missing"] = [typed(error) for error in result.missing]
    if not call.prints_json(result.to_json()):
        PlainConsole(soft_wrap=not call["quick"], highlight=False).print(result)
        if call["quick"] and not result.missing:
            PlainConsole(highlight=False).print(
                f"next         planview run {recording} --out out --rrd", soft_wrap=True
            )
    if isinstance(result, api.RecordingContents):
        return
    for path in result.files:
        say(f"wrote {path}")
    if call["out"] and not result.files:
        say(f"{call['out']}: no pictures were written, because there is no depth to show")
    rig = call["corrected_rig"]
    if result.correction:
        way = f"planview check {recording} --corrected-rig rig.toml writes the corrected calibration"
        say(f"wrote {rig}" if rig else way)
    if failed := [check.name for check in result.checks if check.failed]:
        count = f"{len(failed)} of {len(result.checks)} checks failed"
        has_depth = "valid disparity" in {check.name for check in result.checks}
        pictures = "; --out FOLDER draws a frame with its depth" * (has_depth and not call["out"])
        raise WorkError(f"{call['recording']}: {count}: {', '.join(failed)}{pictures}")
    if rig and not result.correction:
        raise WorkError(f"{rig} was not written: there is nothing to correct in the calibration")
