"""planview synth"""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from calib.errors import InputError
from planview.commands.options import JsonFlag, in_range

if TYPE_CHECKING:
    from planview.synthetic.write import Storage


def synth(
    scene: Path,
    out: Path,
    /,
    *,
    frames: Annotated[int | None, Parameter(help="Render the first N frames only.")] = None,
    scale: Annotated[float, Parameter(help="Factor on the image size, e.g. 0.5.")] = 1.0,
    seed: Annotated[int | None, Parameter(help="In place of the scene's own: other walks and noise.")] = None,
    video: Annotated[bool, Parameter(help="Write videos instead of PNG images.")] = False,
    jpeg: Annotated[bool, Parameter(help="Write JPEG instead of PNG images.")] = False,
    opencv: Annotated[bool, Parameter(help="Also write intrinsics.yml and extrinsics.yml.")] = False,
    world: Annotated[bool, Parameter(help="Also write world.toml, so that the floor need not be found.")] = False,
    json_output: JsonFlag = False,
) -> None:
    """Render a recording with calibration and exact truth from a TOML scene.

    A scene with [[head]] tables in the place of [rig] (name, start_s, rig) gives a folder for each head and rigs.toml
    with their true poses and clocks.

    Example: planview synth data/synthetic/crossing.toml /tmp/crossing --frames 150

    Parameters
    ----------
    scene
        TOML file of the scene.
    out
        New or empty folder for the recording.
    """
    from rich.progress import Progress

    from planview.output.progress import PlainConsole
    from planview.synthetic.render import SceneRenderer
    from planview.synthetic.scene import load_scene
    from planview.synthetic.write import load_rig_scenes, with_seed, write_recording, write_rigs

    if video and jpeg:
        raise InputError("--video and --jpeg cannot be combined")
    if frames is not None and frames < 1:
        raise InputError(f"--frames: expected at least 1, found {frames}")
    in_range("--scale", scale, 0.05, 4)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: expected a new or empty folder for the recording, found one in use")
    storage: Storage = "video" if video else "jpg" if jpeg else "png"
    heads = load_rig_scenes(scene)
    if heads and (opencv or world):
        raise InputError("expected neither --opencv nor --world for several heads: rigs.toml is always written")
    if heads:
        written = write_rigs(with_seed(heads, seed), out, scale=scale, frames=frames, storage=storage)
    else:
        description = load_scene(scene)
        if seed is not None:
            description = description.model_copy(update={"seed": seed})
        renderer = SceneRenderer(description, scale)
        with Progress(console=PlainConsole(stderr=True), transient=True) as progress:
            total = min(renderer.n_frames, frames or renderer.n_frames)
            done = partial(progress.advance, progress.add_task(f"Rendering {scene.name}", total=total))
            one = write_recording(renderer, out, frames=frames, storage=storage, opencv=opencv, world=world, done=done)
        written = [one]
    n_frames, rows = sum(part.frames for part in written), sum(part.truth_rows for part in written)
    print(f"{n_frames} frames, {rows} truth rows in {out}", file=sys.stderr)
    if json_output:
        print(json.dumps({"frames": n_frames, "truth_rows": rows, "folder": str(out)}))
