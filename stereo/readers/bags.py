"""Bags as recordings: which topics are the cameras or the image and its depth, and their calibration."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import islice, takewhile
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from calib.camera import Camera
from calib.errors import InputError, UnreadableError
from calib.formats import fitted, load_rig, refuse_strange_camera
from calib.formats.base import projected
from calib.formats.rgbd import fitted_rgbd, load_rgbd
from calib.formats.ros import camera_from, region_of, windowed
from calib.io import entries, reason, size_text
from calib.pose import SE3
from calib.rig import IDENTITY, RgbdRig, StereoRig
from stereo.depth import Depths
from stereo.readers import base
from stereo.readers.bag_files import STORAGES, ZSTD, Bag, Topic, TopicImages, error_text, open_bag
from stereo.readers.bag_messages import camera_fields, field, frame_id, image_message, pose_of, transforms
from stereo.readers.images import Colour, Size, bits_note, true_bits
from stereo.readers.pairing import depth_note, nearest_mates, pair_stamps, split_sides
from stereo.recording import OpenOptions

_TRANSPORT = re.compile(r"/(compressed|compressedDepth|theora|ffmpeg|zstd)$")
_DEPTH = re.compile(r"depth|disparity", re.IGNORECASE)
_COLOUR = re.compile(r"rgb|colou?r", re.IGNORECASE)
_PREFERENCE = ("image_raw", "image_color", "image_rect_color", "image_rect", "image_mono")
"""Of one camera's topics the first is taken: what the driver sent before what was made of it."""


TopicChoice = tuple[Literal["stereo", "rgbd"], str, str]
"""Two topics and what they are."""


def choose_topics(bag: Bag, named: Sequence[str]) -> TopicChoice:
    """The topics that were named, else the pair that is clear from names and types: left and right before depth."""
    there = [topic for topic in bag.topics if topic.kind in ("image", "compressed") and topic.count]
    if named:
        for name in named:
            if name not in [topic.name for topic in there]:
                expected = f"expected image topics of {bag.path.name} ({_listed(there)})"
                raise InputError(f"{expected}, found {name!r}", argument="topics")
        first, second = named
        depths = _depths(bag, [topic for topic in there if topic.name in named])
        if first in depths and second not in depths:
            first, second = second, first
        return "rgbd" if second in depths else "stereo", first, second
    coded = ", ".join([f"{t.name} of {t.schema}" for t in bag.topics if t.kind == "coded" and t.count][:4])
    also = f"; not read are {coded}" if coded else ""
    if not there:
        empty = [topic for topic in bag.topics if topic.kind in ("image", "compressed")]
        found = f"no message in {_listed(empty)}" if empty else _listed(bag.topics)
        if coded:
            found = f"images coded as video or objects, which are not read ({coded}): {_REPUBLISH}"
        raise InputError(f"{bag.path}: expected image topics of two cameras, found {found}")
    by_base: dict[str, Topic] = {}  # each image once: raw before compressed
    for topic in sorted(there, key=lambda topic: topic.kind == "compressed"):
        by_base.setdefault(_TRANSPORT.sub("", topic.name), topic)
    pairs = _stereo(list(by_base))
    if not pairs:
        depths = _depths(bag, list(by_base.values()))
        pairs = _rgbd(list(by_base), {base for base, topic in by_base.items() if topic.name in depths})
    if not pairs and len(there) == 1:
        raise InputError(
            f"{bag.path}: expected image topics of two cameras, or an image and its depth, "
            f"found only {there[0].name}: one camera{also}"
        )
    if len(pairs) != 1:
        what = f"{len(pairs)} pairs" if pairs else "no clear pair"
        expected = f"{bag.path}: expected one pair of image topics"
        raise InputError(f"{expected}, found {what} among {_listed(there)}{also}", remedy="topics")
    kind, first, second = pairs[0]
    return kind, by_base[first].name, by_base[second].name


_REPUBLISH = "ros2 run image_transport republish writes them as raw or compressed images, to be recorded again"


def info_topic(topics: Iterable[Topic], image: str) -> str | None:
    """The camera_info topic of an image topic: of the same camera, else the one that shares most of its name."""
    infos = [topic.name for topic in topics if topic.kind == "info" and topic.count]
    base = _TRANSPORT.sub("", image)
    for name in (f"{base.rsplit('/', 1)[0]}/camera_info", f"{base}/camera_info"):
        if name in infos:
            return name

    def shared(name: str) -> int:
        parts = zip(name.strip("/").split("/"), base.strip("/").split("/"), strict=False)
        return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], parts))

    best = max(map(shared, infos), default=0)
    if len(infos) > 1 and not best:
        return None
    return min((name for name in infos if shared(name) == best), key=len, default=None)


def _depths(bag: Bag, topics: Sequence[Topic]) -> set[str]:
    """Names of the topics that hold depth by their name, or by the encoding of their first image where not all of the
    topics have it (drivers of infrared pairs send 16UC1, too)."""
    named = {topic.name for topic in topics if _DEPTH.search(topic.name)}
    encoded = {topic.name for topic in topics if _is_encoded_depth(bag, topic)}
    return named | encoded if len(encoded) < len(topics) else named


def _is_encoded_depth(bag: Bag, topic: Topic) -> bool:
    try:
        message = next(iter(bag.messages(topic.name)))
        found = image_message(message.decoded(), topic.kind == "compressed").encoding
    except Exception:  # a damaged message has no encoding; reading the topic reports it
        return False
    return found.upper() in ("16UC1", "32FC1") or "compressedDepth" in found


def _stereo(bases: Sequence[str]) -> list[TopicChoice]:
    """Left and right topics whose names differ in the side alone, one pair for each rig."""
    images = [base for base in bases if not _DEPTH.search(base) and not _COLOUR.search(base.rsplit("/", 1)[0])]
    parts = [image.split("/") for image in images]
    # What all have in common is no side, such as the numbers of a device and its sensor.
    shared = sum(1 for _ in takewhile(lambda same: len(set(same)) == 1, zip(*parts, strict=False)))
    sided = split_sides(["/".join(own[shared:]) for own in parts])
    if sided is None:
        return []
    rights = {sided.rest[i]: images[i] for i in sided.right}
    lefts = {sided.rest[i]: images[i] for i in sided.left if sided.rest[i] in rights}
    return [("stereo", lefts[rest], rights[rest]) for rest in _preferred(lefts)]


def _rgbd(bases: Sequence[str], depth_bases: set[str]) -> list[TopicChoice]:
    """Images of colour, or whatever is not depth, with the depth topic of the same camera."""
    depths = _preferred([base for base in bases if base in depth_bases])
    images = [base for base in bases if base not in depth_bases]
    images = _preferred([base for base in images if _COLOUR.search(base)] or images)
    return [("rgbd", image, depth) for image in images for depth in depths]


def _preferred(names: Iterable[str]) -> list[str]:
    """One topic of each camera, by what drivers call it."""
    by_camera: dict[str, list[str]] = {}
    for name in names:
        by_camera.setdefault(name.rsplit("/", 1)[0], []).append(name)
    rank = {word: i for i, word in enumerate(_PREFERENCE)}
    return [min(own, key=lambda name: rank.get(name.rsplit("/", 1)[-1], len(rank))) for own in by_camera.values()]


def _listed(topics: Sequence[Topic]) -> str:
    names = ", ".join(topic.name for topic in topics[:8]) or "no topics"
    return names + (f" and {len(topics) - 8} more" if len(topics) > 8 else "")


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
        pose, source = found, f"{source} and {where}"
    if not left.size == right.size == size and any(region_of(info.fields) for info in infos):
        own = f"{size_text(left.size)}, the region of interest in camera_info"
        raise InputError(f"{bag.path}: expected images of {own}, found {size_text(size)}")
    name = f"{bag.path} (camera_info)"
    return fitted(StereoRig(left, right, pose, source).check(name), name, size)


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
                unit_m = float(field(next(bag.messages(f"{match[2]}/option/{name}/value")).decoded(), "data"))
                return Depths(float(np.round(1.0 / unit_m, 3)))
    return Depths()


def is_rectified(topic: str) -> bool:
    """Whether images are rectified by the name of their topic (REP 104 and image_proc: image_rect...)."""
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
            size, _, p = windowed(info.fields)
            camera, camera_SE3_rect = projected(size, p.tolist(), f"P of {info.topic}", 1.0)
            pose = camera_SE3_rect.inverse()
        else:
            camera, pose = camera_from(info.fields, info.topic)
        refuse_strange_camera(camera, info.topic)
    except ValueError as error:
        raise InputError(f"{bag.path}: {error}", remedy="calibration") from error
    return camera, pose


def info_of(bag: Bag, topic: str) -> CameraMessage:
    """The camera_info of an image topic."""
    name = info_topic(bag.topics, topic)
    try:
        message = next(bag.messages(name), None) if name else None
        decoded = message.decoded() if message else None
        fields, frame = (camera_fields(decoded), frame_id(decoded)) if message else ({}, "")
        problem = ""
    except Exception as error:  # libraries raise whatever a damaged file provokes
        message, problem = None, f"a camera_info in {name}, found {error_text(error)}"
    if name is None or message is None:
        problem = problem or f"a camera_info of {topic} in the bag, found none"
    elif not any(fields["K"]):
        problem = f"a calibrated camera in {name}, found K of zeros"
    if problem or name is None:
        raise InputError(f"{bag.path}: expected {problem}", remedy="calibration")
    if _SDK.fullmatch(topic):  # sets K and D alone, and calls the lens by another name
        rectified = np.column_stack([np.reshape(fields["K"], (3, 3)), np.zeros(3)])
        fields |= {"P": rectified.ravel().tolist(), "R": np.eye(3).ravel().tolist(), "distortion_model": "plumb_bob"}
    return CameraMessage(name, fields, frame.lstrip("/"))


def static_poses(bag: Bag) -> dict[str, tuple[str, SE3]]:
    """Parent frame and parent_SE3_child by child frame."""
    poses: dict[str, tuple[str, SE3]] = {}
    for topic in (t.name for t in bag.topics if t.kind == "tf" and "static" in t.name):
        # A type that the library does not know, or a damaged message, leaves the frames that were read before.
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
    """Whether depth lies in the image's own pixels, and what is assumed where the bag does not define it."""
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
    image, source = info_of(bag, names[0]), f"camera_info of {bag.path.name}"
    rig = RgbdRig(_camera(bag, image, is_rectified(names[0]))[0], source=source)
    if not registered:
        depth = info_of(bag, names[1])
        depth_camera = _camera(bag, depth, is_rectified(names[1]))[0]
        rig = replace(rig, depth_camera=depth_camera, camera_SE3_depth=_pose(bag, image, depth)[0] or IDENTITY)
    return fitted_rgbd(rig, *sizes)


_MAGIC = {b"#ROSBAG V2.0": "ros1", b"\x89MCAP0\r\n": "mcap", b"SQLite format 3\0": "sqlite"}


def _find(path: Path, options: OpenOptions) -> base.Layout:
    file = _bag_file(path) or path
    bag = open_bag(file, "" if file.is_dir() else _kind(file) or "")
    kind, *chosen = choose_topics(bag, options.topics)
    names, named = (chosen[0], chosen[1]), {topic.name: topic for topic in bag.topics}
    first, second = (TopicImages(bag, named[name]) for name in names)
    stamps, remarks = (first.stamp_ns, second.stamp_ns), first.notes + second.notes
    if not all(own.any() and (len(own) < 2 or np.ptp(own)) for own in stamps):
        stamps = first.log_ns, second.log_ns
        remarks = ("headers hold no times: the times of recording are taken", *remarks)
    samples, is_rgbd = (first.sample(), second.sample()), kind == "rgbd"
    if is_rgbd:
        pairs = pair_stamps(stamps[0], stamps[0], (names[0], names[0]))
        mates = np.where(pairs.left >= 0, nearest_mates(*stamps)[pairs.left], -1)
        if not (mates >= 0).any():
            raise InputError(f"{path}: expected images and depth of the same times, found none")
        remarks += tuple(depth_note(mates))
    else:
        pairs = pair_stamps(*stamps, names)
        base.check_paired(pairs, path)
        mates = pairs.right
    read = samples[0] if is_rgbd else [*samples[0], *samples[1]]
    bits = true_bits(image for image in read if not isinstance(image, UnreadableError))
    remarks += bits_note(bits)
    a = first.frames(pairs.left, Colour(bits), samples[0])
    b = second.frames(mates, _depth_pixels(bag, names[1]) if is_rgbd else Colour(bits), samples[1])
    sizes = (a.size, b.size) if is_rgbd else (base.same_size(a, b, *names),) * 2
    each = zip(names, (a, b), stamps, strict=True)
    streams = tuple(source.stream(name, len(own), base.own_times(own)) for name, source, own in each)
    clock = base.clock_of_pairs(pairs, options)
    if is_rgbd:
        registered, assumed = _is_registered(bag, names)
        rig = partial(_rgbd_rig, bag, names, sizes, registered)
        if options.calibration:
            rig = partial(load_rgbd, options.calibration, *sizes)
        return base.rgbd_layout(path, a, b, streams, clock, rig, (*remarks, *assumed), int((mates < 0).sum()))

    rectified = all(is_rectified(name) for name in names)
    stereo_rig: Callable[[], StereoRig] = partial(rig_of, bag, names, sizes[0], rectified)
    other: base.OtherRig | None = None
    if options.calibration:
        stereo_rig = partial(load_rig, options.calibration, sizes[0])
        other = base.other_state(options.calibration, sizes[0])
    elif not any(map(_SDK.fullmatch, names)):

        def other(_: StereoRig) -> tuple[StereoRig, str]:
            return rig_of(bag, names, sizes[0], not rectified), ""

    frames = base.FramePairs(base.together(a, b), len(pairs.left), pairs.unpaired)
    folder = path if path.is_dir() else path.parent
    return base.stereo_layout(path, frames, streams, clock, stereo_rig, remarks, folder, other)


def _bag_file(path: Path) -> Path | None:
    """The bag at a path: a file, a ROS 2 folder, or the only bag in a folder."""
    if path.is_file():
        return path if _kind(path) else None
    if not path.is_dir():
        return None
    if b"rosbag2_bagfile_information" in _head(path / "metadata.yaml", 4096):
        return path
    found = [file for file in entries(path) if file.name.endswith((".bag", *STORAGES)) and _kind(file)]
    return found[0] if len(found) == 1 else None


def _kind(file: Path) -> str | None:
    head = _head(file, 16)
    if head.startswith(ZSTD):
        return {".db3": "sqlite", ".mcap": "mcap"}.get(Path(file.stem).suffix)
    found = next((kind for magic, kind in _MAGIC.items() if head.startswith(magic)), None)
    return None if found == "sqlite" and file.suffix != ".db3" else found


def _head(file: Path, length: int) -> bytes:
    if not file.is_file():
        return b""
    try:
        with file.open("rb") as content:
            return content.read(length)
    except OSError as error:
        raise InputError(f"{file}: expected a recording, found a file that cannot be read ({reason(error)})") from error


READER = base.Reader("bag", "a bag", lambda path: _bag_file(path) is not None, _find)
