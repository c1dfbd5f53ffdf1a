"""The parameters of a run in words, and a scene rendered as a recording."""

from __future__ import annotations

import re
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import partial, reduce
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from typing import TYPE_CHECKING, NamedTuple

from rich.progress import Progress

from calib.errors import InputError
from calib.params import LARGEST, Described, Params, described, tables_of
from planview.api.arguments import in_range
from planview.engine.config import Config
from planview.output.progress import PlainConsole

if TYPE_CHECKING:
    from planview.synthetic.write import Storage


def params(pattern: str = "", *, all: bool = False) -> list[Described]:
    """List the parameters of a run, with default, range and meaning; of one alone, also its reason and source.

    Example: planview params

    Example of those about the floor: planview params floor

    Example of one: planview params joint.stay_s

    Example of what a scene of planview synth may hold: planview params --all synthetic.scene

    Args:
        pattern: Part of a name or of its meaning, or a name with * and ?.
        all: Also parameters of evaluation, counting, calibration, studies and rendered scenes, under their class in
            Python.

    Raises:
        InputError: no parameter has the pattern in its name or meaning.
    """
    defaults = Config()
    tables = [(name, described(cls, inside(defaults, name))) for name, cls in tables_of(Config)]
    tables += [(name, described(cls)) for name, cls in _other_tables()] if all else []
    every = [field._replace(name=f"{table}.{field.name}".lstrip(".")) for table, fields in tables for field in fields]
    found = [field for field in every if field.name == pattern] or [f for f in every if _matches(f, pattern)]
    if not found:
        raise InputError(f"no parameter has {pattern!r} in its name or meaning")
    return found


def unit_of(field: Described) -> str:
    """In which its value is, as its meaning has it in brackets, else its name; empty for plain numbers."""
    found = re.search(r"\[([^\]\d][^\]]*)\]", field.meaning)
    return found[1] if found else next((unit[1:] for unit in LARGEST if field.name.endswith(unit)), "")


def inside(config: Config, table: str) -> Params:
    """A table of a configuration by its dotted name; itself for ""."""
    return reduce(getattr, filter(None, table.split(".")), config)


def _other_tables() -> Iterator[tuple[str, type[Params]]]:
    """Tables that are no part of a run's configuration, by module and class without the package."""
    of_a_run = {cls for _, cls in tables_of(Config)}
    for package in ("calib", "planview"):
        for module in walk_packages(import_module(package).__path__, f"{package}."):
            if not re.search(r"__main__|\.page|commands|\.api", module.name):
                for name, value in vars(import_module(module.name)).items():
                    is_table = isinstance(value, type) and issubclass(value, Params) and value is not Params
                    own = is_table and value.__module__ == module.name and not name.startswith("_")
                    if own and value not in of_a_run:
                        yield f"{module.name.removeprefix('planview.')}.{name}", value


def _matches(field: Described, pattern: str) -> bool:
    if any(c in pattern for c in "*?"):
        return fnmatch(field.name, pattern)
    return pattern.lower() in f"{field.name} {field.meaning}".lower()


class Rendered(NamedTuple):
    """What was written of a scene."""

    frames: int
    truth_rows: int
    folder: Path


def synth(
    scene: Path | str,
    out: Path | str,
    *,
    frames: int | None = None,
    scale: float = 1.0,
    seed: int | None = None,
    video: bool = False,
    jpeg: bool = False,
    opencv: bool = False,
    world: bool = False,
    quiet: bool = False,
) -> Rendered:
    """Render a recording with calibration and exact truth from a TOML scene.

    A scene with [[mount]] tables in the place of [rig] (name, start_s, rig) gives a folder for each sensor and
    rigs.toml with their true poses and clocks.

    Example: planview synth data/synthetic/crossing.toml /tmp/crossing --frames 150

    Args:
        scene: TOML file of the scene.
        out: New or empty folder for the recording.
        frames: Render the first N frames only.
        scale: Factor on the image size, e.g. 0.5.
        seed: In place of the scene's own: other walks and noise.
        video: Write videos instead of PNG images.
        jpeg: Write JPEG instead of PNG images.
        opencv: Also write intrinsics.yml and extrinsics.yml.
        world: Also write world.toml, so that the floor need not be found.
        quiet: Show no progress.

    Raises:
        InputError: a scene that cannot be read, or a folder in use.
    """
    path = Path(out)
    if video and jpeg:
        raise InputError("video and jpeg cannot be combined")
    if frames is not None:
        in_range("frames", frames, 1, 1_000_000)
    in_range("scale", scale, 0.05, 4)
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"{path}: in use; name a new or empty folder for the recording")
    from planview.synthetic.render import SceneRenderer
    from planview.synthetic.scene import load_scene
    from planview.synthetic.write import load_rig_scenes, with_seed, write_recording, write_rigs

    storage: Storage = "video" if video else "jpg" if jpeg else "png"
    sensors = load_rig_scenes(Path(scene))
    if sensors and (opencv or world):
        raise InputError("opencv and world are for one sensor: of several, rigs.toml is always written")
    if sensors:
        written = [*write_rigs(with_seed(sensors, seed), path, scale=scale, frames=frames, storage=storage)]
    else:
        description = load_scene(Path(scene))
        description = description if seed is None else description.model_copy(update={"seed": seed})
        renderer = SceneRenderer(description, scale)
        with Progress(console=PlainConsole(stderr=True, quiet=quiet), transient=True) as progress:
            total = min(renderer.n_frames, frames or renderer.n_frames)
            done = partial(progress.advance, progress.add_task(f"Rendering {Path(scene).name}", total=total))
            extra = {"opencv": opencv, "world": world}
            written = [write_recording(renderer, path, frames=frames, storage=storage, done=done, **extra)]
    return Rendered(sum(part.frames for part in written), sum(part.truth_rows for part in written), path)
