"""Images with depth: depth files, their rate, the recording they open to, and folders of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from calib.errors import InputError
from calib.formats.rgbd import load_rgbd
from calib.io import entries, size_text
from calib.rig import DepthSensor, RgbdRig
from stereo.depth import Depths
from stereo.readers.base import Layout, Reader, clock_of, rate_of, together, world_pose
from stereo.readers.images import Colour, Images, Size, Stream, image_files, images_of
from stereo.readers.pairing import Pair, depth_note, nearest_mates, pair_files
from stereo.readers.times import stamps_of
from stereo.recording import FrameClock, OpenOptions, RgbdRecording

SENSOR_OF_SIZE: dict[Size, DepthSensor] = {
    (512, 424): "time-of-flight",  # Kinect 2
    (640, 576): "time-of-flight",  # Azure Kinect, narrow and wide, binned or not
    (320, 288): "time-of-flight",
    (512, 512): "time-of-flight",
    (1024, 1024): "time-of-flight",
    (1024, 768): "time-of-flight",  # RealSense L515
    (848, 480): "stereo",  # RealSense D400
    (1280, 720): "stereo",
    (480, 270): "stereo",
    (1280, 800): "stereo",  # OAK-D
    (640, 400): "stereo",
}
"""Sizes of depth images that only one kind of sensor has; all others count as structured light, 640x480 and 320x240
being those of Kinect, Xtion and Astra."""


def rgbd_layout(
    path: Path,
    images: Images,
    depths: Images,
    streams: tuple[Stream, ...],
    clock: FrameClock,
    rig: Callable[[], RgbdRig],
    notes: Iterable[str] = (),
    *,
    unpaired: int = 0,
) -> Layout:
    """Images and depth whose frames are paired; ``rig`` reads the calibration, or raises InputError."""
    remarks = (*clock.notes, *notes)

    def opened() -> RgbdRecording:
        from stereo.rgbd import DepthRegistration  # its kernels: only images with depth need numba here

        found, depth, own = rig(), depths.size, list(remarks)
        if found.depth_camera is None and images.size != depth:
            own.append(f"depth of {size_text(depth)} without a calibration of its own counts as registered")
            found = replace(found, depth_camera=found.camera.scaled(*depth))
        sensor = found.sensor or SENSOR_OF_SIZE.get(depth, "structured-light")
        if isinstance(depths.pixels, Depths) and found.units_per_m is not None:
            depths.pixels.units_per_m = found.units_per_m
        folder = path if path.is_dir() else path.parent
        return RgbdRecording(
            path, together(images, depths), images.n_frames, clock, own, found.camera, found.source, sensor,
            DepthRegistration(found), world_pose(folder), depths.pixels if isinstance(depths.pixels, Depths) else None,
        )  # fmt: skip

    return Layout("rgbd", streams, images.n_frames, clock, remarks, unpaired, opened)


_COLOUR = re.compile(r"(?<![a-z])(rgb|colou?r|image|images|img|left)(?![a-z])|^(rgb|colou?r)", re.IGNORECASE)
_DEPTH = re.compile(r"depth", re.IGNORECASE)
_REGISTERED = re.compile(r"registered|aligned|depth_?(to|2|in)_?(rgb|colou?r)", re.IGNORECASE)


def _sides(path: Path) -> tuple[list[Path], list[Path]] | None:
    """Images and depth at a path: in two folders, or side by side in one, distinguished by their names."""
    if not path.is_dir():
        return None
    folders = [f for f in entries(path) if f.is_dir()]
    colour = [f for f in folders if _COLOUR.search(f.name) and not _DEPTH.search(f.name)]
    depth = [f for f in folders if _DEPTH.search(f.name)]
    if len(depth) > 1:  # depth in the pixels of its image
        depth = [f for f in depth if _REGISTERED.search(f.name)]
    if len(colour) == 1 and len(depth) == 1:
        return image_files(colour[0]), image_files(depth[0])
    files = image_files(path)
    of_depth = [f for f in files if _DEPTH.search(f.stem)]
    of_colour = [f for f in files if not _DEPTH.search(f.stem)]
    if not of_depth:  # 0001.jpg and 0001.png
        kinds = {suffix: [f for f in files if f.suffix == suffix] for suffix in {f.suffix for f in files}}
        deep = {suffix for suffix, own in kinds.items() if _is_deep(own[0])}
        if len(kinds) == 2 and len(deep) == 1:
            (of_depth,) = (kinds[suffix] for suffix in deep)
            (of_colour,) = (kinds[suffix] for suffix in kinds.keys() - deep)
    return (of_colour, of_depth) if of_colour and of_depth else None


def _is_deep(file: Path) -> bool:
    """Whether an image has one channel of more than 8 bits, by its header."""
    with suppress(Exception), Image.open(file) as header:  # libraries raise whatever a damaged file provokes
        return header.mode.startswith(("I", "F"))
    return False


def _fits(path: Path) -> bool:
    sides = _sides(path)
    return sides is not None and all(sides)


def _find(path: Path, options: OpenOptions) -> Layout:
    sides = _sides(path)
    if sides is None:
        raise InputError(f"{path}: expected images and depth, found neither")
    timed = None if (path / "timestamps.csv").is_file() else _timed(*sides, path)
    pairs = timed[0] if timed else pair_files(*sides)
    clock = timed[1] if timed and options.fps is None else clock_of(path, options, len(pairs))
    images, depths = images_of([pair[0] for pair in pairs], Colour()), images_of([pair[1] for pair in pairs], Depths())
    streams = (
        images.stream("image", len(sides[0]), clock.times_s),
        depths.stream("depth", len(sides[1]), clock.times_s),
    )
    rig = partial(load_rgbd, options.calibration or path, images.size, depths.size)
    return rgbd_layout(path, images, depths, streams, clock, rig)


def _timed(images: list[Path], depths: list[Path], folder: Path) -> tuple[list[Pair], FrameClock] | None:
    """Images with the depth of their time, by files of times or the names; None where these number the frames."""
    stamps, depth_stamps = (stamps_of(files, files[0].parent, folder) for files in (images, depths))
    if stamps is None or depth_stamps is None:
        return None
    order = np.argsort(stamps.ns)
    ns, mates = stamps.ns[order], nearest_mates(stamps.ns[order], depth_stamps.ns)
    if not (mates >= 0).any():
        return None
    times = np.asarray((ns - ns[0]) / 1e9, dtype=np.float64)
    pairs = [(images[i], depths[mate] if mate >= 0 else None) for i, mate in zip(order, mates, strict=True)]
    return list(pairs), FrameClock(rate_of(times), times, tuple(depth_note(mates)))


READER = Reader("rgbd", "images with depth", _fits, _find)
