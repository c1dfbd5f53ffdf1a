"""``planview bench trackers``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from calib.errors import WorkError
from planview.bench.accuracy import RenderOptions, cache_folder, rendered, scene_files
from planview.bench.trackers import TrackerScore, check_truth, compare, page
from planview.pipeline.config import load_config
from planview.synthetic.committed import DEMO
from planview.synthetic.scene import load_scene
from planview.trajectories.table import read_truth
from stereo.readers import open_recording


def bench_trackers(
    *,
    recording: Annotated[Sequence[Path], Parameter(negative="")] = (),
    scene: Annotated[Sequence[str], Parameter(negative="")] = (),
    frames: int | None = None,
    out: Path = Path("docs/trackers.md"),
    config: Path | None = None,
    set_: Annotated[Sequence[str], Parameter(name="--set")] = (),
    cache: Path | None = None,
    json_output: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> None:
    """Run the three trackers on the same recordings and write the page that compares them.

    Example: planview bench trackers --scene crossing --scene group --out docs/trackers.md

    Parameters
    ----------
    recording
        Stereo recordings with truth.csv; the committed clip when neither these nor scenes are given.
    scene
        Scenes of data/synthetic, rendered once.
    frames
        Render at most so many frames of each scene.
    out
        The page.
    config
        Configuration file.
    set_
        Single settings, e.g. ellipse_particle.filter.particles=500.
    cache
        Where rendered scenes are kept.
    json_output
        Print one JSON object.
    """
    settings = load_config(config, set_)
    messages = Console(stderr=True, markup=False)

    def tell(text: str) -> None:
        messages.print(text, highlight=False)

    options = RenderOptions(cache or cache_folder(), frames=frames)
    folders = [(path.name, path) for path in recording]
    folders += [
        (path.stem, rendered(load_scene(path), path.stem, options, tell)) for path in scene_files(scene) if scene
    ]
    folders = folders or [("demo", DEMO)]
    scores: list[TrackerScore] = []
    for name, path in folders:
        check_truth(path)
        scores += compare(open_recording(path), name, read_truth(path / "truth.csv"), settings, tell)
    _write(out, page(scores, _command(recording, scene, frames)))
    tell(f"wrote {out}")
    if json_output:
        rows = [
            {"tracker": s.way, "recording": s.recording, "track_ms": s.track_ms, "frames_per_s": s.frames_per_s}
            | s.evaluation.to_json()
            for s in scores
        ]
        print(json.dumps({"scores": rows}, indent=2))


def _command(recording: Sequence[Path], scene: Sequence[str], frames: int | None) -> str:
    words = ["planview bench trackers"]
    words += [f"--recording {path.name}" for path in recording] + [f"--scene {name}" for name in scene]
    return " ".join(words + ([f"--frames {frames}"] if frames else []))


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise WorkError(f"{path}: the page cannot be written: {error.strerror}") from error
