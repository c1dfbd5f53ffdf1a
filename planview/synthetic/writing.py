"""A rendered scene on disk: a recording folder with calibration and truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal

import cv2

from calib.errors import InputError, WorkError
from calib.ground_camera import save_ground_camera
from calib.images import as_colour, encode_image
from calib.io import reason
from calib.rig import Floor, save_rig
from calib.types import U8
from calib.world import save_world
from planview.synthetic.rendering import SceneRenderer
from planview.synthetic.truth import TruthRow

Storage = Literal["png", "jpg", "video"]
TRUTH_HEADER = "frame,id,x_m,y_m,height_m,visible"
BOX_HEADER = ",left_px,top_px,width_px,height_px,full_left_px,full_top_px,full_width_px,full_height_px"


@dataclass(frozen=True)
class Written:
    """What was written: frames, truth rows and the folder."""

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
    done: Callable[[], None] = lambda: None,
) -> Written:
    """Render a scene into a new folder: ``left/`` and ``right/``, or the images of a single camera in it.

    Args:
        renderer: the scene.
        folder: made here; refused when it exists and is not empty.
        frames: at most so many frames.
        storage: images losslessly, as JPEG, or as video.
        opencv: also write intrinsics.yml and extrinsics.yml.
        world: also write world.toml, so that the floor need not be found.
        done: called after each frame.
    Raises:
        InputError: the folder is in use.
        WorkError: it cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: expected a new or empty folder for the recording, found one in use")
    count = min(renderer.n_frames, frames or renderer.n_frames)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _write_calibration(renderer, folder, opencv=opencv, world=world)
        with (folder / "truth.csv").open("w") as truth, (folder / "timestamps.csv").open("w") as times:
            rows = _write_frames(renderer, folder, count, storage, truth, times, done)
    except OSError as error:
        raise WorkError(f"{folder}: the recording could not be written: {reason(error)}") from error
    return Written(count, rows, folder)


def _write_frames(renderer: SceneRenderer, folder: Path, count: int, storage: Storage, truth: IO[str],
                  times: IO[str], done: Callable[[], None]) -> int:  # fmt: skip
    single = renderer.rig is None
    truth.write(TRUTH_HEADER + (BOX_HEADER if single else "") + "\n")
    times.write("frame,timestamp_s\n")
    sides = [""] if single else ["left", "right"]
    sinks = [_sink(folder, side, storage, renderer) for side in sides]
    rows = 0
    try:
        for index in range(count):
            frame = renderer.frame(index)
            for sink, image in zip(sinks, (frame.left, frame.right), strict=False):
                if image is not None:
                    sink.write(image)
            times.write(f"{index},{frame.timestamp_s:.6f}\n")
            truth.writelines(truth_line(index, row, boxes=single) for row in frame.truth)
            rows += len(frame.truth)
            done()
    finally:
        for sink in sinks:
            sink.close()
    return rows


def truth_line(frame: int, row: TruthRow, *, boxes: bool) -> str:
    """One line of truth.csv."""
    cells = [str(frame), str(row.person), f"{row.x_m:.4f}", f"{row.y_m:.4f}", f"{row.height_m:.4f}"]
    cells.append(f"{row.visible:.3f}")
    if boxes:
        cells += ["" if math.isnan(v) else f"{v:.1f}" for v in (*row.box_px, *row.full_box_px)]
    return ",".join(cells) + "\n"


class _Images:
    """Numbered image files."""

    def __init__(self, folder: Path, ending: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._ending, self._next = folder, ending, 0

    def write(self, image: U8) -> None:
        content = encode_image(image, f".{self._ending}", quality=95)
        (self._folder / f"{self._next:06d}.{self._ending}").write_bytes(content)
        self._next += 1

    def close(self) -> None:
        """Nothing is open between images."""


class _Video:
    """One video file."""

    def __init__(self, path: Path, fps: float, size: tuple[int, int]) -> None:
        self._writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, size)
        if not self._writer.isOpened():
            raise OSError(f"{path.name}: this OpenCV cannot write the video")

    def write(self, image: U8) -> None:
        self._writer.write(as_colour(image))

    def close(self) -> None:
        self._writer.release()


def _sink(folder: Path, side: str, storage: Storage, renderer: SceneRenderer) -> _Images | _Video:
    if storage != "video":
        return _Images(folder / side, storage)
    return _Video(folder / f"{side or 'video'}.mp4", renderer.scene.fps, renderer.size)


def _write_calibration(renderer: SceneRenderer, folder: Path, *, opencv: bool, world: bool) -> None:
    if renderer.rig is not None:
        save_rig(renderer.rig, folder / "rig.toml")
    if renderer.ground_camera is not None:
        save_ground_camera(renderer.ground_camera, folder / "camera.toml")
    if opencv and renderer.rig is not None:
        _write_opencv(renderer, folder)
    if world and renderer.world_SE3_left is not None:
        save_world(Floor(renderer.world_SE3_left), folder / "world.toml")


def _write_opencv(renderer: SceneRenderer, folder: Path) -> None:
    """intrinsics.yml and extrinsics.yml as OpenCV's stereo_calib sample writes them."""
    rig = renderer.rig
    assert rig is not None  # the caller has looked
    inner = cv2.FileStorage(str(folder / "intrinsics.yml"), cv2.FILE_STORAGE_WRITE)
    for name, camera in (("1", rig.left), ("2", rig.right)):
        inner.write(f"M{name}", camera.matrix)
        inner.write(f"D{name}", camera.coefficients.reshape(1, -1))
    inner.release()
    outer = cv2.FileStorage(str(folder / "extrinsics.yml"), cv2.FILE_STORAGE_WRITE)
    outer.write("R", rig.right_SE3_left.rotation)
    outer.write("T", rig.right_SE3_left.translation.reshape(3, 1))
    outer.release()
