"""``planview demo``."""

from __future__ import annotations

from pathlib import Path

from calib.errors import InputError
from planview.commands.evaluate import EvaluateOptions, evaluate
from planview.commands.options import JsonFlag
from planview.commands.run import TrackingOptions, run
from planview.runs.console import PlainConsole
from planview.runs.report.moments import busiest_frame
from planview.runs.scene.compose import SceneComposer
from planview.runs.scene.film import write_still
from planview.runs.scene.frames import open_frames
from planview.runs.scene.results import read_results
from planview.synthetic.committed import DEMO


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
    console = PlainConsole(stderr=True, soft_wrap=True, highlight=False)
    picture = _picture(out)
    console.print(
        (f"The scene: {picture}\n" if picture else "")
        + f"Next: open {out / 'report.html'}: pictures, timelines, and why each person was tracked so\n"
        f"      planview view {out} (--web without a display): every frame, with all that the tracker knew\n"
        f"      planview render {out}: the run as a video; planview inspect MY_RECORDING: what one of yours holds"
    )


def _picture(out: Path) -> Path | None:
    """The busiest frame as a picture; None where nobody was tracked."""
    results = read_results(out)
    frame = busiest_frame(results)
    if frame is None:
        return None
    frames = open_frames(results.info)
    write_still(SceneComposer(results, frames), frames, frame, out / "scene.png")
    return out / "scene.png"
