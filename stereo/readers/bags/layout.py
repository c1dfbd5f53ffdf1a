"""Bags as recordings: their calibration, pairs of cameras, and images with depth."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from calib.camera import Camera
from calib.errors import InputError
from calib.formats import load_rig, refuse_strange_camera
from calib.formats.base import camera as camera_of
from calib.formats.rgbd import load_rgbd
from calib.formats.ros import camera_from
from calib.io import size_text
from calib.pose import SE3
from calib.rig import IDENTITY, RgbdRig, StereoRig
from calib.types import I64
from stereo.readers.bags.messages import camera_fields, frame_id, transforms
from stereo.readers.bags.storage import Bag, McapFile, RosBag, error_text
from stereo.readers.bags.topics import TopicDepth, TopicFrames, TopicImages, choose_topics, info_topic
from stereo.readers.base import (
    Layout,
    OpenOptions,
    Reader,
    Stream,
    both,
    check_paired,
    clock_of_pairs,
    own_times,
    pixel_text,
    same_size,
    stereo_layout,
)
from stereo.readers.images import Size, bits_note, true_bits
from stereo.readers.pairing import depth_note, nearest_mates, pair_stamps
from stereo.readers.rgbd import rgbd_layout

MAX_TRANSFORMS = 2000
"""Messages of tf_static that are read: drivers send some dozens (our choice)."""


def rig_of(bag: Bag, topics: tuple[str, str], size: tuple[int, int]) -> StereoRig:
    """The rig from the camera_info of two image topics.

    Topics whose names say that their images are rectified take the rectified camera P instead of K and D.

    Raises:
        InputError: no camera_info, one that is not calibrated, or no baseline.
    """
    found = [info_of(bag, topic) for topic in topics]
    source = f"camera_info of {bag.path.name}"
    try:
        if all(is_rectified(topic) for topic in topics):
            (left, left_shift), (right, right_shift) = (rectified_camera(fields, name) for name, fields, _ in found)
            pose = SE3(np.eye(3), right_shift - left_shift)
        else:
            (left, rect_SE3_left), (right, rect_SE3_right) = (camera_from(fields, name) for name, fields, _ in found)
            pose = rect_SE3_right.inverse() @ rect_SE3_left
        for camera, name in ((left, "left"), (right, "right")):
            refuse_strange_camera(camera, name)
    except ValueError as error:
        raise InputError(f"{bag.path}: {error}: --calibration FILE gives another") from error
    if np.linalg.norm(pose.translation) == 0:
        pose, source = _from_tf(bag, found[0][2], found[1][2]), source + " and tf_static"
    rig = StereoRig(left, right, pose, source)
    return _fitted_pair(rig, bag, size).check(f"{bag.path} (camera_info)")


def is_rectified(topic: str) -> bool:
    """Whether the name of an image topic says that its images are rectified (REP 104 and image_proc: image_rect...)."""
    return re.search(r"(?<![a-z])rect", topic) is not None


def rectified_camera(fields: Mapping[str, Any], name: str) -> tuple[Camera, Any]:
    """The camera of rectified images, and where the rectified left frame's origin lies in its frame [m].

    Raises:
        ValueError: P is no projection.
    """
    projection = np.array(fields["P"], dtype=np.float64).reshape(3, 4)
    one = camera_of(
        (fields["width"], fields["height"]), projection[:, :3].ravel(), np.empty(0), "brown", f"P of {name}"
    )
    return one, np.linalg.solve(projection[:, :3], projection[:, 3])


class CameraMessage(NamedTuple):
    """The first camera_info of an image topic.

    Attributes:
        topic: its own name.
        fields: as ``calib.formats.ros.camera_from`` takes them.
        frame: of reference.
    """

    topic: str
    fields: dict[str, Any]
    frame: str


def info_of(bag: Bag, topic: str) -> CameraMessage:
    """The camera_info of an image topic.

    Raises:
        InputError: there is none, or of a camera that is not calibrated.
    """
    name = info_topic(bag.topics, topic)
    try:
        message = next(bag.messages(name), None) if name else None
        decoded = message.decode(message.data) if message else None
        fields, frame = (camera_fields(decoded), frame_id(decoded)) if message else ({}, "")
    except Exception as error:  # libraries raise whatever a damaged file provokes
        raise InputError(
            f"{bag.path}: expected a camera_info in {name}, found {error_text(error)}: --calibration FILE gives one"
        ) from error
    if name is None or message is None:
        raise InputError(
            f"{bag.path}: expected a camera_info of {topic} in the bag, found none: --calibration FILE gives one"
        )
    if not any(fields["K"]):
        raise InputError(
            f"{bag.path}: expected a calibrated camera in {name}, found K of zeros: --calibration FILE gives one"
        )
    return CameraMessage(name, fields, frame.lstrip("/"))


def _from_tf(bag: Bag, left: str, right: str) -> SE3:
    """right_SE3_left of two frames, from the static transforms."""
    poses = static_poses(bag)
    found = pose_between(poses, right, left)
    if found is None:
        raise InputError(
            f"{bag.path}: expected a baseline, found none in P and no transform from {left} to {right} in /tf_static: "
            "--calibration FILE gives one"
        )
    return found


def static_poses(bag: Bag) -> dict[str, tuple[str, SE3]]:
    """Parent frame and parent_SE3_child by child frame."""
    poses: dict[str, tuple[str, SE3]] = {}
    for topic in (t.name for t in bag.topics if t.kind == "tf" and "static" in t.name):
        # A type that the library does not know, or a damaged message, leaves the frames that were read before.
        with suppress(Exception):
            for message in islice(bag.messages(topic), MAX_TRANSFORMS):
                for parent, child, pose in transforms(message.decode(message.data)):
                    poses[child] = parent, pose
    return poses


def pose_between(poses: Mapping[str, tuple[str, SE3]], target: str, source: str) -> SE3 | None:
    """target_SE3_source over their common ancestor; None when they have none."""
    up_source, up_target = _chain(poses, source), _chain(poses, target)
    common = next((frame for frame in up_source if frame in up_target), None)
    return None if common is None else up_target[common].inverse() @ up_source[common]


def _chain(poses: Mapping[str, tuple[str, SE3]], frame: str) -> dict[str, SE3]:
    """ancestor_SE3_frame by ancestor, the frame itself first; a loop ends it."""
    chain = {frame: SE3.identity()}
    at = frame
    while at in poses and poses[at][0] not in chain:
        parent, pose = poses[at]
        chain[parent] = pose @ chain[at]
        at = parent
    return chain


def _fitted_pair(rig: StereoRig, bag: Bag, size: tuple[int, int]) -> StereoRig:
    if rig.left.size == rig.right.size == size:
        return rig
    (width, height), (w, h) = size, rig.left.size
    if rig.left.size != rig.right.size or width * h != height * w:
        raise InputError(f"{bag.path}: expected camera_info for images of {width}x{height}, found {w}x{h}")
    scaled = rig.scaled(*size)
    return StereoRig(scaled.left, scaled.right, rig.right_SE3_left, f"{rig.source} (scaled from {w}x{h})")


_REGISTERED = re.compile(r"registered|aligned|depth_to_(rgb|colou?r)", re.IGNORECASE)


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


def _rgbd_rig(
    bag: Bag, names: tuple[str, str], calibration: Path | None, sizes: tuple[Size, Size], registered: bool
) -> RgbdRig:
    if calibration is not None:
        return load_rgbd(calibration, *sizes)
    image, source = info_of(bag, names[0]), f"camera_info of {bag.path.name}"
    camera = _camera_of_topic(image.fields, names[0])
    if registered:
        return _fitted_rgbd(RgbdRig(camera, source=source), bag, sizes)
    depth = info_of(bag, names[1])
    pose = IDENTITY if image.frame == depth.frame else pose_between(static_poses(bag), image.frame, depth.frame)
    depth_camera = _camera_of_topic(depth.fields, names[1])
    return _fitted_rgbd(RgbdRig(camera, depth_camera, pose or IDENTITY, source=source), bag, sizes)


def _fitted_rgbd(rig: RgbdRig, bag: Bag, sizes: tuple[Size, Size]) -> RgbdRig:
    for one, size in ((rig.camera, sizes[0]), (rig.depth_camera, sizes[1])):
        if one is not None and one.width * size[1] != one.height * size[0]:
            found = size_text(one.size)
            raise InputError(f"{bag.path}: expected camera_info for images of {size_text(size)}, found {found}")
    same = rig.camera.size == sizes[0] and (rig.depth_camera is None or rig.depth_camera.size == sizes[1])
    return rig if same else rig.scaled(*sizes)


def _camera_of_topic(fields: dict[str, object], topic: str) -> Camera:
    try:
        camera = rectified_camera(fields, topic)[0] if is_rectified(topic) else camera_from(fields, topic)[0]
        refuse_strange_camera(camera, "topic's")
        return camera
    except ValueError as error:
        raise InputError(f"{topic}: {error}: --calibration FILE gives another") from error


_MAGIC = {b"#ROSBAG V2.0": "ros1", b"\x89MCAP0\r\n": "mcap", b"SQLite format 3\0": "sqlite"}
_SUFFIXES = {".bag": "ros1", ".mcap": "mcap", ".db3": "sqlite"}


def _fits(path: Path) -> bool:
    return _bag_file(path) is not None


def _find(path: Path, options: OpenOptions) -> Layout:
    bag = _open(path)
    choice = choose_topics(bag, options.topics)
    named = {topic.name: topic for topic in bag.topics}
    names = choice.first, choice.second
    first, second = topics = TopicImages(bag, named[names[0]]), TopicImages(bag, named[names[1]])
    stamps, said = stamps_of(topics)
    samples = first.sample(), second.sample()
    if choice.kind == "rgbd":
        pairs = pair_stamps(stamps[0], stamps[0], (names[0], names[0]))
        mates = np.where(pairs.left >= 0, nearest_mates(*stamps)[pairs.left], -1)
        if not (mates >= 0).any():
            raise InputError(f"{path}: expected images and depth of the same times, found none")
        bits = true_bits(samples[0])
        images, depths = TopicFrames(first, pairs.left, samples[0], bits), TopicDepth(second, mates, samples[1])
        sizes, kinds = (images.size, depths.size), (pixel_text(images.is_grey, bits), "depth")
        said += (*depth_note(mates), *bits_note(bits))
    else:
        pairs = pair_stamps(*stamps, names)
        check_paired(pairs, path)
        bits = true_bits([*samples[0], *samples[1]])
        a, b = TopicFrames(first, pairs.left, samples[0], bits), TopicFrames(second, pairs.right, samples[1], bits)
        sizes = (same_size(a, b, *names),) * 2
        kinds = pixel_text(a.is_grey, bits), pixel_text(b.is_grey, bits)
        said += bits_note(bits)
    streams = tuple(
        Stream(name, size, len(own), own_times(own), kind)
        for name, size, own, kind in zip(names, sizes, stamps, kinds, strict=True)
    )
    clock = clock_of_pairs(pairs, options)
    if choice.kind == "rgbd":
        registered, assumed = _is_registered(bag, names)
        rig = partial(_rgbd_rig, bag, names, options.calibration, sizes, registered)
        lacking = int(np.count_nonzero(mates < 0))
        return rgbd_layout(path, images, depths, streams, clock, rig, (*said, *assumed), unpaired=lacking)

    def stereo_rig() -> StereoRig:
        return load_rig(options.calibration, sizes[0]) if options.calibration else rig_of(bag, names, sizes[0])

    return stereo_layout(
        path, partial(both, a, b), streams, len(pairs.left), clock, stereo_rig, said, unpaired=pairs.unpaired,
        folder=path if path.is_dir() else path.parent,
    )  # fmt: skip


def stamps_of(topics: tuple[TopicImages, TopicImages]) -> tuple[tuple[I64, I64], tuple[str, ...]]:
    """When the images were taken by their headers; when they were recorded, where the headers hold no times."""
    stamped = all(topic.stamp_ns.any() and (len(topic.stamp_ns) < 2 or np.ptp(topic.stamp_ns)) for topic in topics)
    notes = topics[0].notes + topics[1].notes
    if stamped:
        return (topics[0].stamp_ns, topics[1].stamp_ns), notes
    note = "headers hold no times: the times of recording are taken"
    return (topics[0].log_ns, topics[1].log_ns), (note, *notes)


def _open(path: Path) -> Bag:
    file = _bag_file(path) or path
    if file.is_dir():
        return RosBag(file, ros1=False)
    kind = _kind(file)
    return McapFile(file) if kind == "mcap" else RosBag(file, ros1=kind == "ros1")


def _bag_file(path: Path) -> Path | None:
    """The bag at a path: a file, a ROS 2 folder, or the only bag in a folder."""
    if path.is_file():
        return path if _kind(path) else None
    if not path.is_dir():
        return None
    if (path / "metadata.yaml").is_file() and _is_ros2(path / "metadata.yaml"):
        return path
    found = [file for file in sorted(path.iterdir()) if file.suffix in _SUFFIXES and file.is_file() and _kind(file)]
    return found[0] if len(found) == 1 else None


def _kind(file: Path) -> str | None:
    try:
        with file.open("rb") as content:
            head = content.read(16)
    except OSError:
        return None
    found = next((kind for magic, kind in _MAGIC.items() if head.startswith(magic)), None)
    return None if found == "sqlite" and file.suffix != ".db3" else found


def _is_ros2(metadata: Path) -> bool:
    try:
        with metadata.open("rb") as file:
            return b"rosbag2_bagfile_information" in file.read(4096)
    except OSError:
        return False


READER = Reader("bag", "a bag", "a ROS 1 bag, a ROS 2 bag or an MCAP file with images", _fits, _find)
