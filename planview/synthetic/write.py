"""Rendered scenes on disk: recording folders with calibration and truth, one per stereo rig."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Literal

import cv2
from pydantic import Field, ValidationError

from calib.errors import InputError, WorkError
from calib.formats import write_rig
from calib.ground_camera import save_ground_camera
from calib.images import as_colour, encode_image
from calib.io import load_toml, reason
from calib.params import Params, first_problem
from calib.rig import Floor, save_rig
from calib.world import RIGS_FILE, RigEntry, save_rigs, save_world
from planview.progress import Progress, unseen
from planview.synthetic.render import SceneRenderer
from planview.synthetic.scene import Rig, Scene, load_scene

Storage = Literal["png", "jpg", "video"]
TRUTH_HEADER = "frame,id,x_m,y_m,height_m,visible,facing_deg"
BOX_HEADER = ",left_px,top_px,width_px,height_px,full_left_px,full_top_px,full_width_px,full_height_px"


@dataclass(frozen=True)
class Written:
    """Result of writing: frames, truth rows and the folder."""

    frames: int
    truth_rows: int
    folder: Path


def write_recording(
    renderer: SceneRenderer,
    folder: Path,
    *,
    frames: int | None = None,
    storage: Storage = "png",
    opencv: bool = False,
    world: bool = False,
    progress: Progress = unseen,
) -> Written:
    """Render a scene into a new folder: ``left/`` and ``right/``, or the images of a single camera in it. Raises
    InputError: the folder is in use. WorkError: it cannot be written.

    Args:
        storage: images losslessly, as JPEG, or as video.
        opencv, world: also write intrinsics.yml and extrinsics.yml, or world.toml, so that the floor need not be found.
        progress: called after each frame.
    """
    _refuse_used(folder)
    count = min(renderer.n_frames, frames or renderer.n_frames)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        rig = renderer.rig
        if renderer.ground_camera is not None:
            save_ground_camera(renderer.ground_camera, folder / "camera.toml")
        if rig is not None:
            save_rig(rig, folder / "rig.toml")
        if world and renderer.world_SE3_left is not None:
            save_world(Floor(renderer.world_SE3_left), folder / "world.toml")
        if opencv and rig is not None:
            write_rig(rig, folder, "opencv")
        with (folder / "truth.csv").open("w") as truth, (folder / "timestamps.csv").open("w") as times:
            rows = _write_frames(renderer, folder, count, storage, truth, times, progress)
    except OSError as error:
        raise WorkError(f"{folder}: the recording could not be written: {reason(error)}") from error
    return Written(count, rows, folder)


def _refuse_used(folder: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: in use; name a new or empty folder for the recording")


def _write_frames(renderer: SceneRenderer, folder: Path, count: int, storage: Storage, truth: IO[str],
                  times: IO[str], progress: Progress) -> int:  # fmt: skip
    single = renderer.rig is None
    truth.write(TRUTH_HEADER + (BOX_HEADER if single else "") + "\n")
    times.write("frame,timestamp_s\n")
    sides = [""] if single else ["left", "right"]
    videos: list[cv2.VideoWriter] = []
    rows = 0
    for side in sides:
        if storage == "video":
            path = folder / f"{side or 'video'}.mp4"
            fps = renderer.scene.fps
            videos.append(cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, renderer.size))
            if not videos[-1].isOpened():
                raise OSError(f"{path.name}: this OpenCV cannot write the video")
        else:
            (folder / side).mkdir(parents=True, exist_ok=True)
    try:
        for index in range(count):
            frame = renderer.frame(index)
            images = [image for image in (frame.left, frame.right) if image is not None]
            for video, image in zip(videos, images, strict=False):
                video.write(as_colour(image))
            if not videos:
                for side, image in zip(sides, images, strict=True):
                    content = encode_image(image, f".{storage}", quality=95)
                    (folder / side / f"{index:06d}.{storage}").write_bytes(content)
            times.write(f"{index},{frame.timestamp_s:.6f}\n")
            for row in frame.truth:
                cells = [str(index), str(row.person), f"{row.x_m:.4f}", f"{row.y_m:.4f}", f"{row.height_m:.4f}"]
                boxes = (*row.box_px, *row.full_box_px) if single else ()
                cells += [f"{row.visible:.3f}", f"{row.facing_deg:.1f}"]
                cells += ["" if math.isnan(v) else f"{v:.1f}" for v in boxes]
                truth.write(",".join(cells) + "\n")
            rows += len(frame.truth)
            progress(index + 1, count)
    finally:
        for video in videos:
            video.release()
    return rows


class RigMount(Params):
    """A stereo sensor of a scene: ``[[mount]]`` in its TOML."""

    name: str = Field(pattern=r"^[A-Za-z0-9_-]{1,40}$")
    """Folder of its recording."""
    start_s: float = Field(0.0, ge=0, le=600)
    """When its first frame is taken, on the clock of the scene [s]."""
    rig: Rig


@dataclass(frozen=True, eq=False)
class RigScene:
    """A sensor and the scene as it records it."""

    mount: RigMount
    scene: Scene

    def renderer(self, scale: float = 1.0) -> SceneRenderer:
        """Renders the recording of this sensor."""
        return SceneRenderer(self.scene, scale, self.mount.start_s)


def rigs_of(table: dict[str, Any], source: str) -> tuple[RigScene, ...]:
    """The sensors of a scene's table, which has ``[[mount]]`` in the place of ``[rig]``. Raises InputError: an unknown
    key, a value out of range, or two sensors of one name."""
    rest = {key: value for key, value in table.items() if key != "mount"}
    try:
        mounts = [RigMount.model_validate(entry) for entry in table["mount"]]
        sensors = tuple(RigScene(m, Scene.model_validate(rest | {"rig": m.rig})) for m in mounts)
    except ValidationError as error:
        raise InputError(f"{source}: {first_problem(error)}") from error
    if len({m.name for m in mounts}) != len(mounts) or not mounts:
        raise InputError(f"{source}: expected sensors with a name of their own, found {[m.name for m in mounts]}")
    return sensors


def load_rig_scenes(path: Path) -> tuple[RigScene, ...]:
    """Read a scene with ``[[mount]]`` tables; empty for a scene with one rig or camera. Raises InputError: unreadable,
    or not TOML, and as ``rigs_of``."""
    table = load_toml(path, "a scene in TOML")
    if "head" in table:  # as older scenes call it
        table["mount"] = table.pop("head")
    return rigs_of(table, str(path)) if "mount" in table else ()


def write_rigs(
    sensors: tuple[RigScene, ...],
    folder: Path,
    *,
    scale: float = 1.0,
    frames: int | None = None,
    storage: Storage = "png",
) -> list[Written]:
    """Render every sensor into a folder of its name, and write the true ``rigs.toml`` next to them.

    The common world is that of the first sensor. Arguments and errors are those of ``write_recording``.
    """
    written = []
    entries = []
    common_SE3_room = None
    for sensor in sensors:
        renderer = sensor.renderer(scale)
        name = sensor.mount.name
        written.append(write_recording(renderer, folder / name, frames=frames, storage=storage))
        room_SE3_world = renderer.world_SE3_room.inverse()
        common_SE3_room = common_SE3_room or renderer.world_SE3_room
        world_SE3_left = renderer.world_SE3_left
        assert world_SE3_left is not None  # sensors are rigs
        pose = common_SE3_room @ room_SE3_world @ world_SE3_left
        entries.append(RigEntry(name, pose, sensor.mount.start_s - sensors[0].mount.start_s))
    save_rigs(entries, folder / RIGS_FILE, "true poses and clocks of a rendered scene")
    return written


def render_scene(
    path: Path,
    folder: Path,
    *,
    frames: int | None = None,
    scale: float = 1.0,
    seed: int | None = None,
    storage: Storage = "png",
    opencv: bool = False,
    world: bool = False,
    progress: Progress = unseen,
) -> Written:
    """Render the scene of a file, of one with ``[[mount]]`` tables every sensor (see ``write_recording``); ``seed`` in
    place of the scene's own."""
    _refuse_used(folder)
    other = {} if seed is None else {"seed": seed}
    sensors = load_rig_scenes(path)
    if sensors and (opencv or world):
        raise InputError("opencv and world are for one sensor: of several, rigs.toml is always written")
    if sensors:
        scenes = tuple(RigScene(sensor.mount, sensor.scene.model_copy(update=other)) for sensor in sensors)
        parts = write_rigs(scenes, folder, scale=scale, frames=frames, storage=storage)
        return Written(sum(part.frames for part in parts), sum(part.truth_rows for part in parts), folder)
    renderer = SceneRenderer(load_scene(path).model_copy(update=other), scale)
    return write_recording(
        renderer, folder, frames=frames, storage=storage, opencv=opencv, world=world, progress=progress
    )
