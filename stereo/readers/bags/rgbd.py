"""An image topic and a depth topic as a recording."""

from __future__ import annotations

import re
from collections.abc import Generator, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from calib.camera import Camera
from calib.errors import InputError
from calib.formats.rgbd import load_rgbd
from calib.formats.ros import camera_from
from calib.length import size_text
from calib.rgbd import IDENTITY, RgbdRig
from calib.types import I64, AnyArray
from stereo.readers.bags.cameras import info_of, is_rectified, pose_between, rectified_camera, static_poses
from stereo.readers.bags.source import TopicFrames, TopicImages, bits_in, stored_at
from stereo.readers.bags.storage import Bag
from stereo.readers.bits import bits_note
from stereo.readers.depth_files import UNITS_PER_M, metres
from stereo.readers.depth_mates import depth_note, nearest_mates
from stereo.readers.paired import both
from stereo.readers.reader import OpenOptions, Stream
from stereo.readers.rgbd_layout import RgbdLayout, Size
from stereo.readers.source import Decoded, DecodedDepth
from stereo.readers.time_pairs import pair_stamps
from stereo.readers.timed_files import own_times, pixel_text, times_of

_REGISTERED = re.compile(r"registered|aligned|depth_to_(rgb|colou?r)", re.IGNORECASE)


class TopicDepth:
    """The images of a depth topic in the order of the recording: 16UC1 in millimetres, 32FC1 in metres (REP 118).

    Raises:
        InputError: the topic's images are no depth.
    """

    def __init__(self, images: TopicImages, places: I64, sample: Sequence[AnyArray], units_per_m: float) -> None:
        """Args: places in the topic by frame index, -1 where there is none; a few of its images."""
        if not sample or sample[0].ndim != 2 or sample[0].dtype not in (np.uint16, np.float32, np.float64):
            raise InputError(
                f"{images.bag.path}: expected depth in {images.topic.name} (16UC1, 32FC1, compressedDepth), found none"
            )
        self._images, self._places, self._sample, self._units = images, places, sample, units_per_m
        self.size = sample[0].shape[1], sample[0].shape[0]

    def __iter__(self) -> Iterator[DecodedDepth]:
        return self.at(range(len(self._places)))

    def at(self, indices: Iterable[int]) -> Iterator[DecodedDepth]:
        """Only these frames."""
        for index, stored in stored_at(self._images, self._places, indices):
            if self._places[index] < 0:
                yield DecodedDepth(index, None, None, "image is missing")
            elif stored is None or stored.shape != self._sample[0].shape:
                why = f"a message of {self._images.topic.name} is no depth of {size_text(self.size)}"
                yield DecodedDepth(index, None, None, why)
            else:
                yield DecodedDepth(index, None, metres(stored, self._units))

    def scaled(self, units_per_m: float) -> TopicDepth:
        """The same topic with another scale."""
        return TopicDepth(self._images, self._places, self._sample, units_per_m)


def rgbd_layout(
    path: Path, bag: Bag, topics: tuple[TopicImages, TopicImages], stamps: tuple[I64, I64], options: OpenOptions,
    notes: Sequence[str],
) -> RgbdLayout:  # fmt: skip
    """Pair an image topic with a depth topic by their times.

    Args:
        topics: of the image and of its depth.
        stamps: (n,) and (m,) int64 [ns], when each was taken.
    Raises:
        InputError: no image has a depth image, or the topics hold something else.
    """
    names = topics[0].topic.name, topics[1].topic.name
    frames = pair_stamps(stamps[0], stamps[0], (names[0], names[0]))
    mates = _mates(*stamps)
    depth_places = np.where(frames.left >= 0, mates[frames.left], -1)
    if not (depth_places >= 0).any():
        raise InputError(f"{path}: expected images and depth of the same times, found none")
    samples = [topic.sample() for topic in topics]
    bits = bits_in(samples[:1])
    images = TopicFrames(topics[0], frames.left, samples[0], bits)
    depths = TopicDepth(topics[1], depth_places, samples[1], UNITS_PER_M)
    registered, assumed = _is_registered(bag, names)
    kinds = pixel_text(images.is_grey, bits), "depth"
    streams = tuple(
        Stream(name, size, len(own), own_times(own), kind)
        for name, size, own, kind in zip(names, (images.size, depths.size), stamps, kinds, strict=True)
    )
    times, fps = times_of(frames, options)
    rig = partial(_rig, bag, names, options.calibration, (images.size, depths.size), registered)
    return RgbdLayout(
        path, path if path.is_dir() else path.parent, partial(_pairs, images, depths), (streams[0], streams[1]),
        len(frames.left), fps, times, rig,
        (*notes, *frames.notes, *depth_note(depth_places), *bits_note(bits), *assumed),
        unpaired=int(np.count_nonzero(depth_places < 0)),
    )  # fmt: skip


def _mates(images: I64, depths: I64) -> I64:
    """Place of each image's depth, -1 without one, whatever the order of recording."""
    order, depth_order = np.argsort(images, kind="stable"), np.argsort(depths, kind="stable")
    found = nearest_mates(images[order], depths[depth_order])
    mates = np.full(len(images), -1)
    mates[order] = np.where(found >= 0, depth_order[found], -1)
    return mates


def _pairs(
    images: TopicFrames, depths: TopicDepth, units_per_m: float | None, indices: Sequence[int] | None
) -> Generator[tuple[Decoded, DecodedDepth], None, None]:
    return both(images, depths if units_per_m is None else depths.scaled(units_per_m), indices)


def _is_registered(bag: Bag, names: tuple[str, str]) -> tuple[bool, tuple[str, ...]]:
    """Whether depth lies in the image's own pixels, and what is assumed where the bag does not say."""
    if _REGISTERED.search(names[1]):
        return True, ()
    try:
        frames = [info_of(bag, name).frame for name in names]
    except InputError:
        return False, ()
    if frames[0] == frames[1] or pose_between(static_poses(bag), *frames) is not None:
        return False, ()
    note = f"no transform from {frames[1]} to {frames[0]} in /tf_static: both are taken to be in one place"
    return False, (f"{note} (--calibration FILE says otherwise)",)


def _rig(
    bag: Bag, names: tuple[str, str], calibration: Path | None, sizes: tuple[Size, Size], registered: bool
) -> RgbdRig:
    if calibration is not None:
        return load_rgbd(calibration, *sizes)
    image, source = info_of(bag, names[0]), f"camera_info of {bag.path.name}"
    camera = _camera(image.fields, names[0])
    if registered:
        return _fitted(RgbdRig(camera, source=source), bag, sizes)
    depth = info_of(bag, names[1])
    pose = IDENTITY if image.frame == depth.frame else pose_between(static_poses(bag), image.frame, depth.frame)
    depth_camera = _camera(depth.fields, names[1])
    return _fitted(RgbdRig(camera, depth_camera, pose or IDENTITY, source=source), bag, sizes)


def _fitted(rig: RgbdRig, bag: Bag, sizes: tuple[Size, Size]) -> RgbdRig:
    for one, size in ((rig.camera, sizes[0]), (rig.depth_camera, sizes[1])):
        if one is not None and one.width * size[1] != one.height * size[0]:
            found = size_text(one.size)
            raise InputError(f"{bag.path}: expected camera_info for images of {size_text(size)}, found {found}")
    same = rig.camera.size == sizes[0] and (rig.depth_camera is None or rig.depth_camera.size == sizes[1])
    return rig if same else rig.scaled(*sizes)


def _camera(fields: dict[str, object], topic: str) -> Camera:
    try:
        return rectified_camera(fields, topic)[0] if is_rectified(topic) else camera_from(fields, topic)[0]
    except ValueError as error:
        raise InputError(f"{topic}: {error}: --calibration FILE gives another") from error
