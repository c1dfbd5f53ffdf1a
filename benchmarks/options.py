"""Options that benchmarks share, and the cache of rendered recordings."""

# No ``from __future__ import annotations``: cyclopts evaluates the annotations of inherited fields in the module of the
# subclass, which does not know these names.

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from calib.errors import InputError, WorkError
from calib.io import reason
from planview.engine.config import Config, load_config
from planview.synthetic.assets import SCENES
from planview.synthetic.render import RENDERER_VERSION, SceneRenderer
from planview.synthetic.scene import Scene
from planview.synthetic.write import write_recording

SUITE = SCENES / "suite"
"""The committed challenges."""
Progress = Callable[[str], None]
"""Takes a message that says what is being done."""
Flag = Annotated[bool, Parameter(negative="")]
"""A switch that is off without its option."""
JsonFlag = Annotated[bool, Parameter(name="--json", negative="")]
"""The switch --json: one JSON object on standard output."""


def cache_folder() -> Path:
    """Where rendered recordings are kept: $XDG_CACHE_HOME or ~/.cache, below planview/scenes."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "planview" / "scenes"


@Parameter(name="*")
@dataclass(frozen=True)
class BenchOptions:
    """How rendered recordings are kept and tracked, and how the scores are printed."""

    cache: Path | None = None
    """Folder for rendered recordings; the user's cache by default."""
    config: Path | None = None
    """TOML file with parameters of the engine."""
    set_: Annotated[Sequence[str], Parameter(name="--set", negative="", show_default=False)] = ()
    """One parameter of the engine."""
    json_output: JsonFlag = False
    """Print one JSON object."""

    @property
    def cache_folder(self) -> Path:
        """The folder for rendered recordings."""
        return self.cache or cache_folder()

    def settings(self) -> Config:
        """The parameters of the engine. Raises InputError: an unknown parameter, or a value out of its range."""
        return load_config(self.config, self.set_)


@Parameter(name="*")
@dataclass(frozen=True)
class ChallengeOptions(BenchOptions):
    """Which challenges are drawn."""

    seed: Annotated[Sequence[int], Parameter(negative="")] = ()
    """Seeds to draw: of the suite a new one from the clock by default, so that no work was done on it; of the ablation
    1, and none where --recording is given."""
    minutes: float = 10.0
    """Length of the challenges of each seed together [min]; the seed decides which. The whole suite is longer than ten
    minutes."""
    scene: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Only these challenges, by name."""
    jobs: int = 1
    """Recordings worked on at the same time, each in a process of its own."""
    scenes: Path = SUITE
    """Folder with challenges."""

    def files(self) -> list[Path]:
        """The challenges named. Raises InputError: there is none of a name, or a number out of its range."""
        if self.jobs < 1 or not 0 < self.minutes <= 1000 or any(s < 0 for s in self.seed):
            raise InputError(
                f"expected --jobs from 1, --minutes above 0, --seed from 0, "
                f"found {self.jobs}, {self.minutes:g}, {self.seed}"
            )
        return scene_files(self.scene, self.scenes)


@dataclass(frozen=True)
class Rendering:
    """How scenes are rendered: where they are kept, factor on the image size, at most so many frames."""

    cache: Path
    scale: float = 1.0
    frames: int | None = None


def scene_files(names: Sequence[str] = (), folder: Path = SCENES, ending: str = ".toml") -> list[Path]:
    """Files of a folder by their names without the ending; all when none is named. Raises InputError: no such scene."""
    known = {path.name.removesuffix(ending): path for path in sorted(folder.glob(f"*{ending}"))}
    for name in names:
        if name not in known:
            raise InputError(f"--scene: expected one of {', '.join(known) or 'none'} in {folder}, found {name!r}")
    return [known[name] for name in names or known]


def rendered(scene: Scene, name: str, options: Rendering, progress: Progress) -> Path:
    """The recording of a scene, rendered unless the cache has it.

    The key is a hash of everything in the scene, the renderer's version and the size; a recording appears in the cache
    only when it is whole.

    Raises:
        WorkError: the cache cannot be written.
    """
    without = {"capture"} if scene.capture is None else None
    text = f"{scene.model_dump_json(exclude=without)} {RENDERER_VERSION} {options.scale} {options.frames}"
    folder = options.cache / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    if folder.is_dir():
        return folder
    progress(f"rendering {name}")
    part = new_folder(options.cache, name)
    try:
        write_recording(SceneRenderer(scene, options.scale), part, frames=options.frames, storage="jpg")
        if not folder.is_dir():
            part.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return folder


def new_folder(parent: Path, name: str) -> Path:
    """An empty folder in which something is written before it gets its place in the cache. Raises WorkError: the cache
    cannot be written."""
    try:
        parent.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=f".{name}-", dir=parent))
    except OSError as error:
        raise WorkError(f"{parent}: the cache cannot be written: {reason(error)}") from error


def number(value: float | None, factor: float = 1.0, digits: int = 3, sign: str = "") -> str:
    """A figure of a table; "-" where there is none."""
    return "-" if value is None or value != value else f"{factor * value:{sign}.{digits}f}"


def show(rows: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print rows of figures as a table: their keys head the columns, and "-" stands for a figure that is not known."""
    table = Table(*(key.replace("_", " ") for key in rows[0]), box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for column in table.columns:
        column.overflow, column.justify = "fold", "left" if column is table.columns[0] else "right"
    for row in rows:
        cells = ("-" if v is None or v != v else f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values())
        table.add_row(*cells)
    console.print(table)
