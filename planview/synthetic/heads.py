"""Scenes with several stereo heads: one room, one set of people, a recording per head."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from calib.errors import InputError
from calib.io import reason
from calib.params import Params, first_problem
from calib.world import RIGS_FILE, RigEntry, save_rigs
from planview.synthetic.rendering import SceneRenderer
from planview.synthetic.scene import Rig, Scene
from planview.synthetic.writing import Storage, Written, write_recording


class HeadMount(Params):
    """A stereo head of a scene: ``[[head]]`` in its TOML."""

    name: str = Field(pattern=r"^[A-Za-z0-9_-]{1,40}$")
    """Folder of its recording."""
    start_s: float = Field(0.0, ge=0, le=600)
    """When its first frame is taken, on the clock of the scene [s]."""
    rig: Rig


@dataclass(frozen=True, eq=False)
class SceneHead:
    """A head and the scene as it records it."""

    mount: HeadMount
    scene: Scene

    def renderer(self, scale: float = 1.0) -> SceneRenderer:
        """Renders the recording of this head."""
        return SceneRenderer(self.scene, scale, self.mount.start_s)


def is_heads_table(table: dict[str, Any]) -> bool:
    """Whether a scene's table lists heads instead of one rig or camera."""
    return "head" in table


def heads_of(table: dict[str, Any], source: str) -> tuple[SceneHead, ...]:
    """The heads of a scene's table, which has ``[[head]]`` in the place of ``[rig]``.

    Raises:
        InputError: an unknown key, a value out of range, or two heads of one name.
    """
    rest = {key: value for key, value in table.items() if key != "head"}
    try:
        mounts = [HeadMount.model_validate(entry) for entry in table["head"]]
        heads = tuple(SceneHead(m, Scene.model_validate(rest | {"rig": m.rig})) for m in mounts)
    except ValidationError as error:
        raise InputError(f"{source}: {first_problem(error)}") from error
    if len({m.name for m in mounts}) != len(mounts) or not mounts:
        raise InputError(f"{source}: expected heads with a name of their own, found {[m.name for m in mounts]}")
    return heads


def load_heads(path: Path) -> tuple[SceneHead, ...]:
    """Read a scene with ``[[head]]`` tables; empty for a scene with one rig or camera.

    Raises:
        InputError: unreadable, or not TOML, and as ``heads_of``.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: expected a scene in TOML, found {reason(error)}") from error
    return heads_of(table, str(path)) if is_heads_table(table) else ()


def with_seed(heads: tuple[SceneHead, ...], seed: int | None) -> tuple[SceneHead, ...]:
    """The heads of the same scene with another seed; unchanged without one."""
    if seed is None:
        return heads
    return tuple(SceneHead(h.mount, h.scene.model_copy(update={"seed": seed})) for h in heads)


def write_heads(
    heads: tuple[SceneHead, ...],
    folder: Path,
    *,
    scale: float = 1.0,
    frames: int | None = None,
    storage: Storage = "png",
    done: Callable[[], None] = lambda: None,
) -> list[Written]:
    """Render every head into a folder of its name, and write the true ``rigs.toml`` beside them.

    The common world is that of the first head. Arguments and errors are those of ``write_recording``.
    """
    written, entries = [], []
    common_SE3_room = None
    for head in heads:
        renderer = head.renderer(scale)
        name = head.mount.name
        written.append(write_recording(renderer, folder / name, frames=frames, storage=storage, done=done))
        room_SE3_world = renderer.world_SE3_room.inverse()
        common_SE3_room = common_SE3_room or renderer.world_SE3_room
        world_SE3_left = renderer.world_SE3_left
        assert world_SE3_left is not None  # heads are rigs
        pose = common_SE3_room @ room_SE3_world @ world_SE3_left
        entries.append(RigEntry(name, pose, head.mount.start_s - heads[0].mount.start_s))
    save_rigs(entries, folder / RIGS_FILE, "true poses and clocks of a rendered scene")
    return written
