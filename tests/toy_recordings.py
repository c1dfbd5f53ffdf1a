"""Small recordings on disk: folders of images and videos."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from toy_stereo import toy_rig

from calib.rig import save_rig
from calib.types import U8, AnyArray

W, H = 32, 24


def picture(value: int, colour: bool = False) -> U8:
    """A ramp whose top left pixel is the frame's number."""
    image = np.add.outer(np.arange(H), np.arange(W)).astype(np.uint8)
    image[:8, :8] = value
    return np.dstack([image, image // 2, image]) if colour else image


GREY = picture(90)


def write_images(folder: Path, *names: str, image: AnyArray = GREY) -> Path:
    """Images of these names, made with their folders."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / name), image)
    return folder


def textured(shift_px: int = 0) -> U8:
    """A textured plane of 320 x 240 px, shifted to the left."""
    coarse = np.random.default_rng(3).integers(0, 255, (50, 60), dtype=np.uint8)
    texture = cv2.resize(coarse, (400, 280), interpolation=cv2.INTER_CUBIC)
    return np.ascontiguousarray(texture[20:260, 20 + shift_px : 340 + shift_px])


def write_times(path: Path, times_s: Sequence[object], frames: Sequence[object] | None = None) -> None:
    """A table of the times of frames, counted from 0 unless they are given."""
    rows = zip(range(len(times_s)) if frames is None else frames, times_s, strict=True)
    path.write_text("frame,timestamp_s\n" + "".join(f"{frame},{time}\n" for frame, time in rows))


def folder_recording(
    folder: Path,
    names: Sequence[str] | int = 6,
    images: Sequence[AnyArray] = (),
    colour: bool = False,
    size: tuple[int, int] = (W, H),
) -> Path:
    """Folders left and right of images and a calibration.

    Args:
        names: of the images, or how many are numbered.
        images: pictures of the frame's number when empty.
        size: (width, height) of the calibration [px].
    """
    names = [f"{i:04d}" for i in range(names)] if isinstance(names, int) else names
    for i, name in enumerate(names):
        image = images[i] if len(images) else picture(10 * i, colour)
        write_images(folder, f"left/{name}.png", f"right/{name}.png", image=image)
    save_rig(toy_rig(size, focal_px=30.0), folder / "rig.toml")
    return folder


def write_video(path: Path, count: int, width: int = 64, height: int = 48, colour: bool = False) -> None:
    """A video whose top left corner is the frame's number."""
    rng = np.random.default_rng(0)
    image = cv2.resize(rng.integers(0, 255, (6, 8, 3 if colour else 1), dtype=np.uint8), (width, height))
    frames = np.stack([image] * count)
    frames[:, :16, :16] = (20 * (np.arange(count) % 12)).reshape(-1, *[1] * image.ndim)
    write_frames(path, frames)


def write_frames(path: Path, frames: Sequence[AnyArray] | AnyArray, code: str = "MJPG") -> None:
    """A video of (h, w) or (h, w, 3) uint8 frames at 10 Hz."""
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), 10.0, (width, height))
    assert writer.isOpened()
    for frame in frames:
        writer.write(frame if frame.ndim == 3 else cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    writer.release()


def video_pair(folder: Path, counts: tuple[int, int], width: int = 64, height: int = 48) -> Path:
    """Videos left and right of so many frames, and a calibration."""
    for side, count in zip(("left", "right"), counts, strict=True):
        write_video(folder / f"{side}.avi", count, width, height)
    save_rig(toy_rig((width, height), focal_px=60.0), folder / "rig.toml")
    return folder


def table_file(folder: Path, text: str) -> Path:
    """A file of tracks or truth."""
    path = folder / "table.csv"
    path.write_bytes(text.encode())
    return path
