"""The calibration that a bag holds: camera_info of both cameras, and tf_static where these give no baseline."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from calib.camera import Camera
from calib.errors import InputError
from calib.formats.fields import camera as camera_of
from calib.formats.ros import camera_from
from calib.pose import SE3
from calib.rig import StereoRig
from stereo.readers.bags.messages import camera_fields, frame_id, transforms
from stereo.readers.bags.storage import Bag
from stereo.readers.bags.topics import info_topic

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
    except ValueError as error:
        raise InputError(f"{bag.path}: {error}: --calibration FILE gives another") from error
    if np.linalg.norm(pose.translation) == 0:
        pose, source = _from_tf(bag, found[0][2], found[1][2]), source + " and tf_static"
    rig = StereoRig(left, right, pose, source)
    return _fitted(rig, bag, size).check(f"{bag.path} (camera_info)")


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
    message = next(bag.messages(name), None) if name else None
    if name is None or message is None:
        raise InputError(
            f"{bag.path}: expected a camera_info of {topic} in the bag, found none: --calibration FILE gives one"
        )
    decoded = message.decode(message.data)
    fields = camera_fields(decoded)
    if not any(fields["K"]):
        raise InputError(
            f"{bag.path}: expected a calibrated camera in {name}, found K of zeros: --calibration FILE gives one"
        )
    return CameraMessage(name, fields, frame_id(decoded).lstrip("/"))


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


def _fitted(rig: StereoRig, bag: Bag, size: tuple[int, int]) -> StereoRig:
    if rig.left.size == rig.right.size == size:
        return rig
    (width, height), (w, h) = size, rig.left.size
    if rig.left.size != rig.right.size or width * h != height * w:
        raise InputError(f"{bag.path}: expected camera_info for images of {width}x{height}, found {w}x{h}")
    scaled = rig.scaled(*size)
    return StereoRig(scaled.left, scaled.right, rig.right_SE3_left, f"{rig.source} (scaled from {w}x{h})")
