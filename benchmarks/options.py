"""Options that benchmarks share, and the cache of rendered recordings."""

# No ``from __future__ import annotations``: cyclopts evaluates the annotations of inherited fields in the module of the
# subclass, which does not know these names.

import hashlib
import math
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pandas
from cyclopts import Parameter
from pydantic_core import to_json

from calib.errors import InputError
from calib.io import whole_folder
from planview.engine.config import Config, load_config
from planview.synthetic.render import RENDERER_VERSION, SceneRenderer
from planview.synthetic.scene import Scene
from planview.synthetic.write import write_recording

Flag = Annotated[bool, Parameter(negative="")]
"""A switch that is off without its option."""
Row = dict[str, Any]
"""Figures by the names that head their columns."""
JsonFlag = Annotated[bool, Parameter(name="--json", negative="")]
"""The switch --json: one JSON object on standard output."""


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
        """Where rendered recordings are kept: by default $XDG_CACHE_HOME or ~/.cache, below planview/scenes."""
        base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
        return self.cache or Path(base) / "planview" / "scenes"

    def settings(self) -> Config:
        """The parameters of the engine. Raises InputError: an unknown parameter, or a value out of its range."""
        return load_config(self.config, self.set_)


def scene_files(names: Sequence[str], folder: Path, ending: str = ".toml") -> list[Path]:
    """Files of a folder by their names without the ending; all when none is named. Raises InputError: no such scene."""
    known = {path.name.removesuffix(ending): path for path in sorted(folder.glob(f"*{ending}"))}
    for name in names:
        if name not in known:
            raise InputError(f"--scene: expected one of {', '.join(known) or 'none'} in {folder}, found {name!r}")
    return [known[name] for name in names or known]


def rendered(scene: Scene, name: str, cache: Path, frames: int | None = None) -> Path:
    """The recording of a scene, or of its first frames; rendered unless the cache has it.

    The key is a hash of everything in the scene, the renderer's version and the number of frames; a recording appears
    in the cache only when it is whole. Raises WorkError: the cache cannot be written."""
    text = f"{scene.model_dump_json()} {RENDERER_VERSION} {frames}"
    folder = cache / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    if not folder.is_dir():
        progress(f"rendering {name}")
        with whole_folder(folder) as part:
            write_recording(SceneRenderer(scene), part, frames=frames, storage="jpg")
    return folder


def show(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print rows of figures as a table, however wide: their keys head the columns, "-" stands for an unknown figure."""
    table = pandas.DataFrame([{key.replace("_", " "): _cell(value) for key, value in row.items()} for row in rows])
    names, table = table.columns[0], table.fillna("-")
    width = max(map(len, [names, *table[names]]))
    table = table.assign(**{names: table[names].str.ljust(width)}).rename(columns={names: names.ljust(width)})
    print(table.to_string(index=False), end="\n\n")


def _cell(value: object) -> str:
    if isinstance(value, tuple):  # an interval
        return f"{_cell(value[0])} [{_cell(value[1])}, {_cell(value[2])}]"
    if value is None or value != value:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def figure(name: str, value: float, unit: str, limit: float = math.nan) -> Row:
    """A figure measured against known truth, which is only reported where the limit is NaN."""
    return {"name": name, "value": value, "unit": unit, "limit": limit, "ok": not value > limit}


def report(json_output: bool, **parts: Any) -> None:
    """Print tables of rows, or one JSON object of them and all else by their names."""
    if json_output:
        print(json_text(parts), end="")
        return
    for rows in parts.values():
        if rows and isinstance(rows, list) and isinstance(rows[0], dict):
            show(rows)


def json_text(value: object) -> str:
    """As JSON; numbers that are not finite are null."""
    return to_json(value, indent=2, inf_nan_mode="null").decode() + "\n"


def progress(message: str) -> None:
    """Say on stderr what is being done."""
    print(message, file=sys.stderr, flush=True)
