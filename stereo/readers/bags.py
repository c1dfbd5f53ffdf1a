"""Bags as recordings: which topics are the cameras or the image and its depth, and their calibration."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from calib.camera import Camera
from calib.errors import InputError, UnreadableError
from calib.formats import fit_rig, load_rig, refuse_strange_camera
from calib.formats.base import camera_from_projection
from calib.formats.rgbd import fit_rgbd, load_rgbd
from calib.formats.ros import camera_from, region_of, sent_image
from calib.io import size_text
from calib.pose import SE3
from calib.rig import IDENTITY, RgbdRig, StereoRig
from stereo.depth import Depths
from stereo.readers import base
from stereo.readers.bag_files import INFO, TRANSFORMS, Bag, TopicImages, bag_at, error_text
from stereo.readers.bag_messages import camera_fields, frame_id, image_message, pose_of, transforms
from stereo.readers.images import Colour, Size, bits_note, true_bits
from stereo.readers.pairing import depth_note, nearest_mates, pair_stamps, split_sides
from stereo.recording import OpenOptions

_TRANSPORT = re.compile(r"/(compressed|compressedDepth|zstd)$")
_DEPTH = re.compile(r"depth|disparity", re.IGNORECASE)


class TopicChoice(NamedTuple):
    """Two topics and what they are: those of a left and a right camera, or of an image and its depth."""

    kind: Literal["stereo", "rgbd"]
    first: str
    second: str


def choose_topics(bag: Bag, named: Sequence[str]) -> TopicChoice:
    """The topics that were named, else the two that there are, in the order of their sides. Raises InputError: other
    topics, which are listed, to be named."""
    images = [topic.name for topic in bag.topics if topic.holds_images]
    topics = ", ".join(images)
    for name in named:
        if name not in images:
            raise InputError(f"expected image topics of {bag.path.name} ({topics}), found {name!r}", argument="topics")
    # Each image once, raw before compressed.
    raw_first = sorted(images, key=lambda name: (_TRANSPORT.search(name) is not None, name))
    by_camera = {_TRANSPORT.sub("", name): name for name in reversed(raw_first)}
    pair = list(named) or [by_camera[camera] for camera in sorted(by_camera)]
    if len(pair) < 2:
        there = ", ".join(f"{topic.name} of {topic.type}" for topic in bag.topics[:8]) or "no topics"
        found = f"only {topics}: one camera" if images else f"{there}; {_REPUBLISH}"
        raise InputError(f"{bag.path}: expected image topics of two cameras, or an image and its depth, found {found}")
    depths = [name for name in pair if _is_depth(bag, name)]
    if len(pair) == 2 and len(depths) == 1:
        first = next(name for name in pair if name not in depths)
        return TopicChoice("rgbd", first, depths[0])
    if named:
        return TopicChoice("stereo", pair[0], pair[1])
    sides = split_sides(_differences(pair))
    if len(pair) > 2 or sides is None:
        expected = f"{bag.path}: expected two image topics, of a left and a right camera or an image and its depth"
        raise InputError(f"{expected}, found {topics}", remedy="topics")
    return TopicChoice("stereo", pair[sides.left[0]], pair[sides.right[0]])


_REPUBLISH = "ros2 run image_transport republish writes images coded as video as raw ones, to be recorded again"


def _differences(names: Sequence[str]) -> list[str]:
    """Parts that two names do not have in common: the number of the device does not name a side."""
    parts = [name.split("/") for name in names[:2]]
    apart = [i for i, words in enumerate(zip(*parts, strict=False)) if len(set(words)) > 1]
    return ["/".join(words[i] for i in apart) for words in parts]


def _is_depth(bag: Bag, topic: str) -> bool:
    """True if a topic holds depth, by its name or the encoding of its first image (drivers of infrared pairs send
    images as 16UC1, too)."""
    if _DEPTH.search(topic):
        return True
    try:
        encoding = image_message(next(bag.messages(topic)).decoded()).encoding
    except Exception:  # a damaged message has no encoding; reading the topic reports it
        return False
    return encoding.upper() in ("16UC1", "32FC1") or "compressedDepth" in encoding


def rig_of(bag: Bag, topics: tuple[str, str], size: Size, rectified: bool) -> StereoRig:
    """The rig from the camera_info of two image topics: by the rectified camera P, or by K and D."""
    first, second = infos = [info_of(bag, topic) for topic in topics]
    source = f"camera_info of {bag.path.name}"
    (left, rect_SE3_left), (right, rect_SE3_right) = (_camera(bag, info, rectified) for info in infos)
    pose = rect_SE3_right.inverse() @ rect_SE3_left
    if pose.translation[0] > 0 and (shift := float(np.ravel(second.fields["P"])[3])) > 0:
        expected = "expected P[3] of the right camera to be -fx times the baseline"
        raise InputError(f"{second.topic}: {expected}, found {shift:+.4g}: change its sign, or exchange the topics")
    if np.linalg.norm(pose.translation) == 0:
        found, where = _pose(bag, second, first)
        if found is None or not found.translation.any():
            other = f"no transform from {first.frame} to {second.frame} in /{where}"
            other = f"both camera_info in the frame {first.frame!r}" if first.frame == second.frame else other
            raise InputError(f"{bag.path}: expected a baseline, found none in P and {other}", remedy="calibration")
        pose = found
        source = f"{source} and {where}"
    if not left.size == right.size == size and any(region_of(info.fields) for info in infos):
        own = f"{size_text(left.size)}, the region of interest in camera_info"
        raise InputError(f"{bag.path}: expected images of {own}, found {size_text(size)}")
    name = f"{bag.path} (camera_info)"
    return fit_rig(StereoRig(left, right, pose, source).check(name), name, size)


_SDK = re.compile(r"((/device_\d+/sensor_\d+)/\w+)/(image/data|info/camera_info)")
"""Topics of recordings of the RealSense SDK (librealsense, media/ros), and what begins those of a stream and a sensor.
The SDK rectifies infrared images."""


def _pose(bag: Bag, target: CameraMessage, source: CameraMessage) -> tuple[SE3 | None, str]:
    """target_SE3_source of two cameras, None where the bag does not hold it, and where it is looked for."""
    sdk = [match[1] for info in (target, source) if (match := _SDK.fullmatch(info.topic))]
    # Of the SDK's streams the pose of a reference in their camera.
    sent = [next(bag.messages(f"{stream}/tf/0"), None) for stream in sdk]
    if len(sdk) == 2:
        poses = [pose_of(message.decoded()) for message in sent if message]
        return (poses[0] @ poses[1].inverse() if len(poses) == 2 else None), "tf/0 of the streams"
    found = None if target.frame == source.frame else pose_between(static_poses(bag), target.frame, source.frame)
    return found, "tf_static"


def _depth_pixels(bag: Bag, topic: str) -> Depths:
    """Depth of a topic, in the unit that the SDK writes next to it, else in millimetres."""
    if match := _SDK.fullmatch(topic):
        for name in ("Depth_Units", "Depth Units"):
            with suppress(Exception):  # no such message, or damage
                unit_m = float(next(bag.messages(f"{match[2]}/option/{name}/value")).decoded().data)
                return Depths(float(np.round(1.0 / unit_m, 3)))
    return Depths()


def is_rectified(topic: str) -> bool:
    """True if images are rectified by the name of their topic (REP 104 and image_proc: image_rect...)."""
    return re.search(r"(?<![a-z])rect", topic) is not None


class CameraMessage(NamedTuple):
    """The first camera_info of an image topic: its own topic, the fields of ROS's YAML files, frame of reference."""

    topic: str
    fields: dict[str, Any]
    frame: str


def _camera(bag: Bag, info: CameraMessage, rectified: bool) -> tuple[Camera, SE3]:
    """The camera of a camera_info, or of its rectified images by P, and rect_SE3_camera."""
    try:
        if rectified:
            size, _, p = sent_image(info.fields)
            camera, camera_SE3_rect = camera_from_projection(size, p.tolist(), f"P of {info.topic}", 1.0)
            pose = camera_SE3_rect.inverse()
        else:
            camera, pose = camera_from(info.fields, info.topic)
        refuse_strange_camera(camera, info.topic)
    except ValueError as error:
        raise InputError(f"{bag.path}: {error}", remedy="calibration") from error
    return camera, pose


def info_of(bag: Bag, topic: str) -> CameraMessage:
    """The camera_info of an image topic, in the same namespace."""
    image = _TRANSPORT.sub("", topic)
    places = (
        f"{image.rpartition('/')[0]}/camera_info",
        f"{image}/camera_info",
        image.replace("/image/data", "/info/camera_info"),
    )
    sent = [one.name for one in bag.topics if one.type == INFO and one.n_messages and one.name in places]
    if not sent:
        raise InputError(f"{bag.path}: expected a camera_info of {topic} in the bag, found none", remedy="calibration")
    name = sent[0]
    try:
        message = next(bag.messages(name)).decoded()
        fields = camera_fields(message)
        frame = frame_id(message)
    except Exception as error:  # the library raises whatever a damaged file provokes
        expected = f"expected a camera_info in {name}, found {error_text(error)}"
        raise InputError(f"{bag.path}: {expected}", remedy="calibration") from error
    if not any(fields["K"]):
        raise InputError(f"{bag.path}: expected a calibrated camera in {name}, found K of zeros", remedy="calibration")
    if _SDK.fullmatch(topic):  # sets K and D alone, and calls the lens by another name
        rectified = np.column_stack([np.reshape(fields["K"], (3, 3)), np.zeros(3)])
        fields |= {"P": rectified.ravel().tolist(), "R": np.eye(3).ravel().tolist(), "distortion_model": "plumb_bob"}
    return CameraMessage(name, fields, frame)


def static_poses(bag: Bag) -> dict[str, tuple[str, SE3]]:
    """Parent frame and parent_SE3_child by child frame."""
    poses: dict[str, tuple[str, SE3]] = {}
    for topic in (one.name for one in bag.topics if one.type in TRANSFORMS and "static" in one.name):
        # A damaged message leaves the frames that were read before.
        with suppress(Exception):
            for message in islice(bag.messages(topic), 2000):  # drivers send some dozens
                for parent, child, pose in transforms(message.decoded()):
                    poses[child] = parent, pose
    return poses


def pose_between(poses: Mapping[str, tuple[str, SE3]], target: str, source: str) -> SE3 | None:
    """target_SE3_source over their common ancestor; None when they have none."""
    chains = []
    for frame in (source, target):
        chain = {frame: SE3.identity()}  # ancestor_SE3_frame by ancestor; a loop ends it
        while frame in poses and poses[frame][0] not in chain:
            parent, pose = poses[frame]
            chain[parent] = pose @ chain[frame]
            frame = parent
        chains.append(chain)
    common = next((frame for frame in chains[0] if frame in chains[1]), None)
    return None if common is None else chains[1][common].inverse() @ chains[0][common]


_REGISTERED = re.compile(r"registered|aligned|depth_to_(rgb|colou?r)", re.IGNORECASE)


def _is_registered(bag: Bag, names: tuple[str, str]) -> tuple[bool, tuple[str, ...]]:
    """Check whether depth lies in the image's own pixels, with a note on what is assumed where the bag does not define
    it."""
    if _REGISTERED.search(names[1]):
        return True, ()
    try:
        image, depth = (info_of(bag, name) for name in names)
        found, where = _pose(bag, image, depth)
    except InputError:
        return False, ()
    if image.frame == depth.frame or found is not None:
        return False, ()
    note = f"no transform from {depth.frame} to {image.frame} in /{where}: both are taken to be in one place"
    return False, (f"{note} (a calibration can give another place)",)


def _rgbd_rig(bag: Bag, names: tuple[str, str], sizes: tuple[Size, Size], registered: bool) -> RgbdRig:
    image = info_of(bag, names[0])
    source = f"camera_info of {bag.path.name}"
    rig = RgbdRig(_camera(bag, image, is_rectified(names[0]))[0], source=source)
    if not registered:
        depth = info_of(bag, names[1])
        depth_camera = _camera(bag, depth, is_rectified(names[1]))[0]
        rig = replace(rig, depth_camera=depth_camera, camera_SE3_depth=_pose(bag, image, depth)[0] or IDENTITY)
    return fit_rgbd(rig, *sizes)


def _find(path: Path, options: OpenOptions) -> base.Layout:
    bag = Bag(bag_at(path) or path)
    choice = choose_topics(bag, options.topics)
    names = choice.first, choice.second
    topics = {topic.name: topic for topic in bag.topics}
    first = TopicImages(bag, topics[choice.first])
    second = TopicImages(bag, topics[choice.second])
    stamps = first.stamp_ns, second.stamp_ns
    notes = [*first.notes, *second.notes]
    if not all(own.any() and (len(own) < 2 or np.ptp(own)) for own in stamps):
        stamps = first.log_ns, second.log_ns
        notes.insert(0, "headers hold no times: the times of recording are taken")
    is_rgbd = choice.kind == "rgbd"
    if is_rgbd:
        pairs = pair_stamps(stamps[0], stamps[0], (names[0], names[0]))
        mates = np.where(pairs.left >= 0, nearest_mates(*stamps)[pairs.left], -1)
        if not (mates >= 0).any():
            raise InputError(f"{path}: expected images and depth of the same times, found none")
        notes += depth_note(mates)
    else:
        pairs = pair_stamps(*stamps, names)
        base.check_paired(pairs, path)
        mates = pairs.right
    samples = first.sample(), second.sample()
    read = samples[0] if is_rgbd else [*samples[0], *samples[1]]
    bits = true_bits(image for image in read if not isinstance(image, UnreadableError))
    notes += bits_note(bits)
    a = first.frames(pairs.left, Colour(bits), samples[0])
    b = second.frames(mates, _depth_pixels(bag, names[1]) if is_rgbd else Colour(bits), samples[1])
    streams = (
        a.stream(names[0], len(stamps[0]), base.own_times(stamps[0])),
        b.stream(names[1], len(stamps[1]), base.own_times(stamps[1])),
    )
    clock = base.clock_of_pairs(pairs, options)
    if is_rgbd:
        if options.calibration:
            rig = partial(load_rgbd, options.calibration, a.size, b.size)
        else:
            registered, assumed = _is_registered(bag, names)
            notes += assumed
            rig = partial(_rgbd_rig, bag, names, (a.size, b.size), registered)
        return base.rgbd_layout(path, a, b, streams, clock, rig, notes, int((mates < 0).sum()))
    size = base.same_size(a, b, *names)
    frames = base.FramePairs(base.together(a, b), len(pairs.left), pairs.unpaired)
    folder = path if path.is_dir() else path.parent
    if options.calibration:
        stereo_rig = partial(load_rig, options.calibration, size)
    else:
        stereo_rig = partial(rig_of, bag, names, size, all(map(is_rectified, names)))
    return base.stereo_layout(path, frames, streams, clock, stereo_rig, notes, folder)


READER = base.Reader("bag", "a bag", lambda path: bag_at(path) is not None, _find)
