"""The parameters of a run in words, and a scene rendered as a recording."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import reduce
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from typing import TYPE_CHECKING

from calib.errors import InputError
from calib.params import Described, Params, descriptions, tables_of
from planview.api.arguments import in_range
from planview.api.result import Result
from planview.engine.config import Config
from planview.progress import Progress, unseen

if TYPE_CHECKING:
    from planview.synthetic.write import Storage

log = logging.getLogger(__name__)


def params(pattern: str = "", *, everything: bool = False) -> list[Described]:
    """List the parameters of a run.

    Each has its default, range and meaning; of one alone, also its reason and source.

    ```python
    planview.params("joint.stay_s")[0].meaning
    planview.params("synthetic.scene", everything=True)  # what a scene may hold
    ```

    Args:
        pattern: Part of a name or of its meaning, or a name with * and ?.
        everything: Also parameters of evaluation, counting, calibration, studies and rendered scenes, under their
            class in Python.

    Raises:
        InputError: no parameter has the pattern in its name or meaning.
    """
    defaults = Config()
    tables = [(name, descriptions(cls, inside(defaults, name))) for name, cls in tables_of(Config)]
    tables += [(name, descriptions(cls)) for name, cls in _other_tables()] if everything else []
    every = [field._replace(name=f"{table}.{field.name}".lstrip(".")) for table, fields in tables for field in fields]
    found = [field for field in every if field.name == pattern] or [f for f in every if _matches(f, pattern)]
    if not found:
        raise InputError(f"no parameter has {pattern!r} in its name or meaning")
    return found


def inside(config: Config, table: str) -> Params:
    """A table of a configuration by its dotted name; itself for ""."""
    return reduce(getattr, filter(None, table.split(".")), config)


def _other_tables() -> Iterator[tuple[str, type[Params]]]:
    """Tables outside a run's configuration, by module and class without the package."""
    known = {Params, *(cls for _, cls in tables_of(Config))}
    for package in ("calib", "planview"):
        for module in walk_packages(import_module(package).__path__, f"{package}."):
            if not re.search(r"__main__|\.page|commands|\.api", module.name):
                for name, value in vars(import_module(module.name)).items():
                    is_table = isinstance(value, type) and issubclass(value, Params) and value not in known
                    if is_table and value.__module__ == module.name and not name.startswith("_"):
                        yield f"{module.name.removeprefix('planview.')}.{name}", value


def _matches(field: Described, pattern: str) -> bool:
    return fnmatch(field.name, pattern) or pattern.lower() in f"{field.name} {field.meaning}".lower()


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
    progress: Progress = unseen,
) -> Result[Path]:
    """Render a recording with exact truth from a TOML scene.

    A scene with [[mount]] tables in the place of [rig] (name, start_s, rig) gives a folder for each sensor and
    rigs.toml with their true poses and clocks.

    ```python
    planview.synth("data/synthetic/crossing.toml", "crossing", frames=150)
    ```

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
        progress: Called after every frame.

    Returns:
        The folder of the recording.

    Raises:
        InputError: a scene that cannot be read, or a folder in use.
    """
    if video and jpeg:
        raise InputError("video and jpeg cannot be combined")
    if frames is not None:
        in_range("frames", frames, 1, 1_000_000)
    in_range("scale", scale, 0.05, 4)
    from planview.synthetic.write import render_scene  # the renderer takes half a second

    folder = Path(out)
    storage: Storage = "video" if video else "jpg" if jpeg else "png"
    log.debug("rendering %s", Path(scene).name)
    written = render_scene(
        Path(scene), folder, frames=frames, scale=scale, seed=seed, storage=storage, opencv=opencv, world=world,
        progress=progress,
    )  # fmt: skip
    return Result(folder, {"frames": written.frames, "truth_rows": written.truth_rows, "folder": str(folder)})
