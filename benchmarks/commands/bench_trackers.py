"""``python -m benchmarks trackers``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from benchmarks.accuracy import RenderOptions, cache_folder, rendered, scene_files
from benchmarks.commands.options import JsonFlag
from benchmarks.trackers import TrackerScore, check_truth, compare, page
from calib.errors import WorkError
from calib.io import reason, write_whole
from planview.engine.config import load_config
from planview.synthetic.assets import DEMO
from planview.synthetic.scene import load_scene
from planview.trajectories.table import read_truth
from stereo.readers import open_recording


@Parameter(name="*")
@dataclass(frozen=True)
class ComparisonOptions:
    """Which recordings are tracked, and with which parameters."""

    recording: Annotated[Sequence[Path], Parameter(negative="")] = ()
    """Stereo recordings with truth.csv; the committed clip when neither these nor scenes are given."""
    scene: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Scenes of data/synthetic, rendered once."""
    frames: int | None = None
    """Render at most so many frames of each scene."""
    out: Path = Path("docs/trackers.md")
    """The page."""
    config: Path | None = None
    """Configuration file."""
    set_: Annotated[Sequence[str], Parameter(name="--set")] = ()
    """Single settings, e.g. ellipse_particle.filter.particles=500."""
    cache: Path | None = None
    """Where rendered scenes are kept."""
    json_output: JsonFlag = False
    """Print one JSON object."""


def bench_trackers(*, options: ComparisonOptions | None = None) -> None:
    """Run the three trackers on the same recordings and write the page that compares them.

    Example: python -m benchmarks trackers --scene crossing --scene group --out docs/trackers.md
    """
    options = options or ComparisonOptions()
    settings = load_config(options.config, options.set_)
    messages = Console(stderr=True, markup=False)

    def tell(text: str) -> None:
        messages.print(text, highlight=False)

    rendering = RenderOptions(options.cache or cache_folder(), frames=options.frames)
    folders = [(path.name, path) for path in options.recording]
    folders += [
        (path.stem, rendered(load_scene(path), path.stem, rendering, tell))
        for path in scene_files(options.scene)
        if options.scene
    ]
    folders = folders or [("demo", DEMO)]
    scores: list[TrackerScore] = []
    for name, path in folders:
        check_truth(path)
        scores += compare(open_recording(path), name, read_truth(path / "truth.csv"), settings, tell)
    _write(options.out, page(scores, _command(options.recording, options.scene, options.frames)))
    tell(f"wrote {options.out}")
    if options.json_output:
        rows = [
            {"tracker": s.way, "recording": s.recording, "track_ms": s.track_ms, "frames_per_s": s.frames_per_s}
            | s.evaluation.to_json()
            for s in scores
        ]
        print(json.dumps({"scores": rows}, indent=2))


def _command(recording: Sequence[Path], scene: Sequence[str], frames: int | None) -> str:
    words = ["python -m benchmarks trackers"]
    words += [f"--recording {path.name}" for path in recording] + [f"--scene {name}" for name in scene]
    return " ".join(words + ([f"--frames {frames}"] if frames else []))


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text)
    except OSError as error:
        raise WorkError(f"{path}: the page cannot be written: {reason(error)}") from error
