"""``planview synth``: a scene rendered as a recording with exact truth."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from cyclopts import Parameter

from calib.errors import InputError
from planview.commands.options import Flag, JsonFlag, in_range, say

if TYPE_CHECKING:
    from planview.synthetic.write import Storage, Written


@Parameter(name="*")
@dataclass(frozen=True)
class SynthOptions:
    """What is rendered, and which files are written."""

    frames: int | None = None
    """Render the first N frames only."""
    scale: float = 1.0
    """Factor on the image size, e.g. 0.5."""
    seed: int | None = None
    """In place of the scene's own: other walks and noise."""
    video: Flag = False
    """Write videos instead of PNG images."""
    jpeg: Flag = False
    """Write JPEG instead of PNG images."""
    opencv: Flag = False
    """Also write intrinsics.yml and extrinsics.yml."""
    world: Flag = False
    """Also write world.toml, so that the floor need not be found."""
    json_output: JsonFlag = False


def synth(scene: Path, out: Path, /, *, options: SynthOptions = SynthOptions()) -> None:
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
    if options.video and options.jpeg:
        raise InputError("--video and --jpeg cannot be combined")
    if options.frames is not None and options.frames < 1:
        raise InputError(f"--frames: expected at least 1, found {options.frames}")
    in_range("--scale", options.scale, 0.05, 4)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: in use; name a new or empty folder for the recording")
    written = _rendered(scene, out, options)
    n_frames, rows = sum(part.frames for part in written), sum(part.truth_rows for part in written)
    say(f"{n_frames} frames, {rows} truth rows in {out}")
    if options.json_output:
        print(json.dumps({"frames": n_frames, "truth_rows": rows, "folder": str(out)}))


def _rendered(scene: Path, out: Path, options: SynthOptions) -> list[Written]:
    """What was written of each head."""
    from rich.progress import Progress

    from planview.output.progress import PlainConsole
    from planview.synthetic.render import SceneRenderer
    from planview.synthetic.scene import load_scene
    from planview.synthetic.write import load_rig_scenes, with_seed, write_recording, write_rigs

    storage: Storage = "video" if options.video else "jpg" if options.jpeg else "png"
    heads, frames = load_rig_scenes(scene), options.frames
    if heads and (options.opencv or options.world):
        raise InputError("--opencv and --world are for one head: of several, rigs.toml is always written")
    if heads:
        heads = with_seed(heads, options.seed)
        return [*write_rigs(heads, out, scale=options.scale, frames=frames, storage=storage)]
    description = load_scene(scene)
    if options.seed is not None:
        description = description.model_copy(update={"seed": options.seed})
    renderer = SceneRenderer(description, options.scale)
    with Progress(console=PlainConsole(stderr=True), transient=True) as progress:
        total = min(renderer.n_frames, frames or renderer.n_frames)
        done = partial(progress.advance, progress.add_task(f"Rendering {scene.name}", total=total))
        extra = {"opencv": options.opencv, "world": options.world}
        return [write_recording(renderer, out, frames=frames, storage=storage, done=done, **extra)]
