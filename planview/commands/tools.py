"""``planview params`` and ``synth``: the parameters of a run in words, and a scene rendered as a recording."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import partial, reduce
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from textwrap import fill
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.table import Column, Table

from calib.errors import InputError
from calib.params import Described, Params, described, tables_of
from planview.commands.options import Flag, JsonFlag, in_range, say
from planview.engine.config import Config
from planview.output.progress import PlainConsole

if TYPE_CHECKING:
    from planview.synthetic.write import Storage, Written


def params(pattern: str = "", /, *, all_: Annotated[Flag, Parameter(name="--all")] = False) -> None:
    """List the parameters of a run, with default, range and meaning; of one alone, also its reason and source.

    Example: planview params

    Example of those about the floor: planview params floor

    Example of one: planview params joint.stay_s

    Example of what a scene of planview synth may hold: planview params --all synthetic.scene

    Parameters
    ----------
    pattern
        Part of a name or of its meaning, or a name with * and ?.
    all_
        Also parameters of evaluation, counting, calibration, studies and rendered scenes, under their class in Python.
    """
    defaults = Config()
    tables = [(name, described(cls, inside(defaults, name))) for name, cls in tables_of(Config)]
    tables += [(name, described(cls)) for name, cls in _other_tables()] if all_ else []
    every = [field._replace(name=f"{table}.{field.name}".lstrip(".")) for table, fields in tables for field in fields]
    found = [field for field in every if field.name == pattern] or [f for f in every if _matches(f, pattern)]
    if not found:
        raise InputError(f"no parameter has {pattern!r} in its name or meaning; planview params lists all")
    console = PlainConsole(soft_wrap=True, highlight=False)
    if len(found) == 1:
        only = found[0]
        bounds = f" ({only.range})" if only.range else ""
        console.print(f"{only.name} = {only.default or 'required'}{bounds}\n{fill(only.meaning, 100)}")
        return
    table = Table(Column("name", no_wrap=True), "default", "range", "meaning", box=None, pad_edge=False)
    for field in found:
        table.add_row(field.name, field.default or "required", field.range, field.sentence)
    PlainConsole(highlight=False).print(table)


def inside(config: Config, table: str) -> Params:
    """A table of a configuration by its dotted name; itself for ""."""
    return reduce(getattr, filter(None, table.split(".")), config)


def _other_tables() -> Iterator[tuple[str, type[Params]]]:
    """Tables that are no part of a run's configuration, by module and class without the package."""
    of_a_run = {cls for _, cls in tables_of(Config)}
    for package in ("calib", "planview"):
        for module in walk_packages(import_module(package).__path__, f"{package}."):
            if not re.search(r"__main__|\.page|commands", module.name):
                for name, value in vars(import_module(module.name)).items():
                    is_table = isinstance(value, type) and issubclass(value, Params) and value is not Params
                    own = is_table and value.__module__ == module.name and not name.startswith("_")
                    if own and value not in of_a_run:
                        yield f"{module.name.removeprefix('planview.')}.{name}", value


def _matches(field: Described, pattern: str) -> bool:
    if any(c in pattern for c in "*?"):
        return fnmatch(field.name, pattern)
    return pattern.lower() in f"{field.name} {field.meaning}".lower()


def config_toml(config: Config) -> str:
    """All parameters as the TOML file that ``--config`` takes; those without a value are comments."""
    lines = []
    for table, _ in tables_of(Config):
        values = config.model_dump()
        for key in filter(None, table.split(".")):
            values = values[key]
        own = {name: value for name, value in values.items() if not isinstance(value, dict)}
        if own:
            lines += [f"\n[{table}]"] if table else []
            lines += [f"# {n} is not set" if v is None else f"{n} = {json.dumps(v)}" for n, v in own.items()]
    return "\n".join(lines)


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
