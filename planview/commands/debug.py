"""``planview debug``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from calib.errors import InputError, WorkError
from calib.images import write_image
from planview.engine.config import config_of, load_config
from planview.output.progress import FrameProgress, PlainConsole
from planview.output.replay import difference_picture, difference_text, track_again
from planview.output.results import SceneFrames, open_frames, read_results


def debug(
    folder: Path,
    *,
    frame: int,
    set_: Annotated[Sequence[str], Parameter(name="--set", negative="")] = (),
    png: Path | None = None,
) -> None:
    """Track a run again up to a frame with a parameter changed, and show both: a picture, and what differs in words.

    Tracking begins at the nearest checkpoint, where the run was interrupted and kept one; else with the first frame, of
    the run's maps.h5 (planview run --save-maps) where the parameter does not concern what comes before the maps: that
    takes a tenth of the time.

    Example: planview debug out --frame 310 --set template.match.score_max=1.2

    Parameters
    ----------
    folder
        Output folder of a run.
    frame
        The frame to look at.
    set_
        Parameter to change, as of planview run; may be given several times. Without one the run is repeated as it was.
    png
        Picture to write; debug-N.png in the folder when not given.
    """
    results = read_results(folder)
    if not 0 <= frame < results.n_frames:
        raise InputError(f"--frame: expected a frame from 0 to {results.n_frames - 1}, found {frame}")
    config = load_config(None, set_, config_of(results.info.config, str(folder / "run.json")))
    console = PlainConsole(stderr=True, soft_wrap=True, highlight=False)
    with FrameProgress(console, frame + 1) as progress:
        again = track_again(results, config, frame, progress)
    console.print(f"tracked from {again.begun_from}")
    for line in difference_text(results, again, frame):
        PlainConsole(soft_wrap=True, highlight=False).print(line)
    frames: SceneFrames | None = None
    try:
        frames = open_frames(results.info)
    except (InputError, WorkError) as error:
        console.print(f"the floor alone is drawn: {error}")
    path = png or folder / f"debug-{frame}.png"
    write_image(path, difference_picture(results, again, frames, frame, ", ".join(set_) or "again"))
    console.print(str(path))
