"""``planview demo``."""

from __future__ import annotations

from pathlib import Path

from calib.errors import InputError
from planview.commands.evaluate import EvaluateOptions, evaluate
from planview.commands.options import JsonFlag
from planview.commands.run import TrackingOptions, run
from planview.runs.console import PlainConsole
from planview.synthetic.committed import DEMO


def demo(
    *,
    out: Path = Path("out/demo"),
    json_output: JsonFlag = False,
) -> None:
    """Run the committed clip, write all results including run.rrd, and print its metrics.

    Example: planview demo

    Parameters
    ----------
    out
        Folder for the results; results of an earlier demo there are replaced.
    json_output
        Print the metrics as one JSON object.
    """
    if not DEMO.is_dir():
        raise InputError(
            f"{DEMO}: expected the demo clip, found nothing; install planview again, or run it from its repository"
        )
    run(DEMO, out=out, options=TrackingOptions(rrd=True, debug=True, overwrite=True))
    evaluate(out / "tracks.csv", DEMO / "truth.csv", options=EvaluateOptions(json_output=json_output))
    console = PlainConsole(stderr=True, soft_wrap=True, highlight=False)
    console.print(
        f"Next: open {out / 'report.html'}: pictures, plots and settings of this run\n"
        f"      planview view {out}: every frame, and why the tracker decided as it did\n"
        "      planview inspect MY_RECORDING: what a recording of yours holds, and what it lacks"
    )
