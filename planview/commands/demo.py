"""``planview demo``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.errors import InputError
from planview.commands.evaluate import EvaluateOptions, evaluate
from planview.commands.options import JsonFlag
from planview.commands.render import RenderOptions, render
from planview.commands.run import TrackingOptions, run
from planview.output.progress import PlainConsole
from planview.synthetic.committed import DEMO
from planview.trajectories.table import read_tracks


def demo(
    *,
    out: Path = Path("out/demo"),
    json_output: JsonFlag = False,
) -> None:
    """Run the committed clip, write all results with a picture of the scene and run.rrd, and print its metrics.

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
    _draw(out)
    PlainConsole(stderr=True, soft_wrap=True, highlight=False).print(
        f"Next: open {out / 'report.html'}: pictures, plots and settings of this run\n"
        f"      planview view {out}: every frame, and why the tracker decided as it did\n"
        "      planview inspect MY_RECORDING: what a recording of yours holds, and what it lacks"
    )


def _draw(out: Path) -> None:
    """A picture of the scene when most people are in it."""
    tracks = read_tracks(out / "tracks.csv")
    frames = tracks.frame[tracks.state == "confirmed"]
    busiest = int(np.bincount(frames).argmax()) if len(frames) else 0
    render(out, options=RenderOptions(frame=busiest, png=out / "scene.png"))
