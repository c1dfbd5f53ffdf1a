"""``planview run``, ``demo`` and ``replay``: a recording tracked, and tracked again."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from calib.errors import InputError, WorkError
from planview.api import run as api
from planview.api.arguments import settings
from planview.api.results import render
from planview.commands.console import PlainConsole, compile_notice, summary
from planview.commands.options import say
from planview.commands.shell import JSON, QUIET, Call, Flag, command
from planview.commands.tools import config_toml
from planview.engine.open import TrackerName, base_config
from planview.output.folder import HoldsResultsError
from planview.output.report.snapshots import busiest_frame
from planview.output.run_folder import RunFolder
from planview.output.viewer import LiveViewer
from planview.synthetic.assets import DEMO

GROUPS = {
    "Input": "calibration topics fps strict frames",
    "Tracking": "tracker detections config set refine rules print_config",
    "Output": "out rrd maps view quiet json overwrite resume",
}
OWN = JSON | {
    "quiet": "Print nothing but errors.",
    "print_config": "Print all parameters that the run would have as a file for --config, and end.",
}
HIDDEN = Parameter(show=False)
"""Of what few need: the documents have it."""


@command(
    api.run,
    types={
        "calibration": Annotated[Path | None, Parameter(name=["--calibration", "--camera"])],
        "tracker": TrackerName,
        "detections": Path | None,
        "checkpoint_every": Annotated[float, HIDDEN],
        "rrd_every": Annotated[int, HIDDEN],
    },
    groups=GROUPS,
    own=OWN,
)
def run(call: Call) -> None:
    """Example: planview run my_recording --out out --rrd

    Example of two videos, or two folders of images: planview run left.mp4 right.mp4 --calibration rig.toml --out out

    Example of saving the plan-view maps and tracking them again:
        planview run my_recording --out out --maps
        planview run out/maps.h5 --out again --tracker template

    Example of watching it while it runs: planview run my_recording --out out --view

    Example with one camera: planview run street.mp4 --tracker human-model --calibration camera.toml --out out

    Example without any calibration: planview run street.mp4 --tracker ellipse-particle --out out

    Example with a detector's boxes: planview run street.mp4 --detections det.txt --calibration camera.toml --out out
    """
    out = call["out"]
    recording = call["recording"]
    if call.own["print_config"]:
        print(config_toml(settings(call["config"], base_config(recording))))
        return
    if out is None:
        raise InputError("run needs --out FOLDER for the results")
    live = LiveViewer()
    call.bound.arguments["view"] = live if call["view"] else False
    try:
        with compile_notice():
            call()
    except InputError as error:
        if not isinstance(cause := error.__cause__, HoldsResultsError):
            raise
        way = f"choose another folder, or add {'--resume or ' * cause.resumable}--overwrite"
        again = "--overwrite instead of --resume starts again"
        raise InputError(f"{cause}; {again if call['resume'] else way}") from error
    except WorkError as error:
        if not error.in_pictures:
            raise
        raise WorkError(
            f"{error}; planview check {recording} --out pictures draws its rows, depth and floor"
        ) from error
    info = RunFolder(out).info
    console = PlainConsole(stderr=True, quiet=call.own["quiet"])
    summary(console, info, out)
    if info.counts:
        from planview.api.scores import counts_text  # brings scipy

        console.print(counts_text(info.counts))
    call.prints_json({"out": str(out), **info.model_dump(mode="json", exclude={"config"})})
    if live.viewer is not None and live.viewer.page:
        console.print("the page is served until Ctrl-C")
        with suppress(KeyboardInterrupt):
            live.viewer.wait()


@command(api.replay, options=["frame"], own=QUIET)
def replay(call: Call) -> None:
    """Example: planview replay out --frame 310 --set joint.patch_m=0.15"""
    found = call()
    say(f"tracked from {found.values['source']}")
    print(found)
    say(found.files[0])


def demo(*, out: Path = Path("out/demo"), json: Flag = False) -> None:
    """Track the clip that comes with the package and print its scores.

    All results are written, with a picture and run.rrd.

    Example: planview demo

    Args:
        out: Folder for the results; results of an earlier demo there are replaced.
        json: Print one JSON object to standard output.
    """
    from planview.commands.scores import evaluate  # brings scipy

    if not DEMO.is_dir():
        remedy = "install planview again, or run it from its repository"
        raise InputError(f"{DEMO}: expected the demo clip, found nothing; {remedy}")
    run(DEMO, out=out, rrd=True, overwrite=True)
    evaluate(out / "tracks.csv", DEMO / "truth.csv", json=json)
    say(render(out, frame=busiest_frame(RunFolder(out)) or 0, out=out / "scene.png"))
    say(
        f"Next: open {out / 'report.html'}: pictures, plots and settings of this run\n"
        f"      planview view {out}: every frame, and why the tracker decided as it did\n"
        "      planview check MY_RECORDING --quick: what a recording of yours holds, and what it lacks"
    )
