"""Options and output of benchmarks, and the cache of rendered recordings."""

from __future__ import annotations

import hashlib
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas
from pydantic_core import to_json

from calib.errors import InputError
from calib.io import whole_folder
from planview.commands.shell import JSON, Call, command
from planview.synthetic.render import RENDERER_VERSION, SceneRenderer
from planview.synthetic.scene import Scene
from planview.synthetic.write import write_recording

Row = dict[str, Any]
"""Figures by the names that head their columns."""


class Report(NamedTuple):
    """Result of a benchmark.

    Attributes:
        values: all of it by name, as JSON has it.
        tables: what is printed of it.
        notes: lines below the tables.
    """

    values: dict[str, Any]
    tables: Sequence[Sequence[Row]]
    notes: Sequence[str] = ()


def tables(**parts: list[Row]) -> Report:
    """A report that consists of tables."""
    return Report(dict(parts), list(parts.values()))


def benchmark(function: Callable[..., Report]) -> Callable[..., None]:
    """Make a command of a function: its signature and docstring give the options and their help."""
    return command(function, own=JSON)(_print_report)


def _print_report(call: Call) -> None:
    result = call()
    if call.own["json"]:
        print(json_text(result.values), end="")
        return
    for rows in result.tables:
        if rows:
            show(rows)
    for note in result.notes:
        print(note)


def cache_folder(cache: Path | None) -> Path:
    """Folder of rendered recordings: by default $XDG_CACHE_HOME or ~/.cache, below planview/scenes."""
    if cache is not None:
        return cache
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "planview" / "scenes"


def scene_files(names: Sequence[str], folder: Path, ending: str = ".toml") -> list[Path]:
    """Files of a folder by their names without the ending; all when none is named. Raises InputError: no scene, or no
    such scene."""
    by_name = {path.name.removesuffix(ending): path for path in sorted(folder.glob(f"*{ending}"))}
    if not by_name:
        raise InputError(f"expected scenes (*{ending}) in {folder}, found none", argument="scene")
    for name in names:
        if name not in by_name:
            choices = ", ".join(by_name) or "none"
            raise InputError(f"expected one of {choices} in {folder}, found {name!r}", argument="scene")
    return [by_name[name] for name in names or by_name]


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
    cells = []
    for row in rows:
        cells.append({key.replace("_", " "): _cell(value) for key, value in row.items()})
    table = pandas.DataFrame(cells).fillna("-")
    first = table.columns[0]
    width = max(map(len, [first, *table[first]]))
    table[first] = table[first].str.ljust(width)
    table = table.rename(columns={first: first.ljust(width)})
    print(table.to_string(index=False), end="\n\n")


def _cell(value: object) -> str:
    if isinstance(value, tuple):  # a figure with its interval
        figure, low, high = map(_cell, value)
        return f"{figure} [{low}, {high}]"
    if value is None or value != value:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def figure(name: str, value: float, unit: str, limit: float = math.nan) -> Row:
    """A figure measured against known truth, which is only reported where the limit is NaN."""
    return {"name": name, "value": value, "unit": unit, "limit": limit, "ok": not value > limit}


def json_text(value: object) -> str:
    """As JSON; numbers that are not finite are null."""
    return to_json(value, indent=2, inf_nan_mode="null").decode() + "\n"


def progress(message: str) -> None:
    """Say on stderr what is being done."""
    print(message, file=sys.stderr, flush=True)
