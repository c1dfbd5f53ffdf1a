"""ROS 1 bags, ROS 2 bags and MCAP files as recordings."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from calib.formats import load_rig
from calib.rig import StereoRig
from calib.types import I64
from stereo.readers.bags.cameras import rig_of
from stereo.readers.bags.mcap_file import McapFile
from stereo.readers.bags.rgbd import rgbd_layout
from stereo.readers.bags.rosbag import RosBag
from stereo.readers.bags.source import TopicFrames, TopicImages, bits_in
from stereo.readers.bags.storage import Bag
from stereo.readers.bags.topics import choose_topics
from stereo.readers.bits import bits_note
from stereo.readers.pair import both
from stereo.readers.reader import Layout, OpenOptions, Reader, Stream
from stereo.readers.stereo_layout import Size, StereoLayout, same_size
from stereo.readers.time_pairs import pair_stamps
from stereo.readers.timed_files import check_paired, own_times, pixel_text, times_of

_MAGIC = {b"#ROSBAG V2.0": "ros1", b"\x89MCAP0\r\n": "mcap", b"SQLite format 3\0": "sqlite"}
_SUFFIXES = {".bag": "ros1", ".mcap": "mcap", ".db3": "sqlite"}


def _fits(path: Path) -> bool:
    return _bag_file(path) is not None


def _find(path: Path, options: OpenOptions) -> Layout:
    bag = _open(path)
    choice = choose_topics(bag, options.topics)
    named = {topic.name: topic for topic in bag.topics}
    topics = TopicImages(bag, named[choice.first]), TopicImages(bag, named[choice.second])
    if choice.kind == "rgbd":
        stamps, note = stamps_of(topics)
        return rgbd_layout(path, bag, topics, stamps, options, note)
    return _stereo(path, bag, topics, options)


def _stereo(path: Path, bag: Bag, topics: tuple[TopicImages, TopicImages], options: OpenOptions) -> StereoLayout:
    names = topics[0].topic.name, topics[1].topic.name
    stamps, clock_note = stamps_of(topics)
    pairs = pair_stamps(*stamps, names)
    check_paired(pairs, path)
    samples = [topic.sample() for topic in topics]
    bits = bits_in(samples)
    a, b = (
        TopicFrames(topic, places, sample, bits)
        for topic, places, sample in zip(topics, (pairs.left, pairs.right), samples, strict=True)
    )
    size = same_size(a, b, Path(names[0]), Path(names[1]))
    streams = tuple(
        Stream(name, size, len(own), own_times(own), pixel_text(source.is_grey, bits))
        for name, own, source in zip(names, stamps, (a, b), strict=True)
    )
    times, fps = times_of(pairs, options)
    return StereoLayout(
        path, folder_of(path), size, partial(both, a, b), streams, len(pairs.left), fps, times,
        partial(_rig, bag, names, options.calibration, size), (*clock_note, *pairs.notes, *bits_note(bits)),
        unpaired=pairs.unpaired,
    )  # fmt: skip


def _rig(bag: Bag, topics: tuple[str, str], calibration: Path | None, size: Size) -> StereoRig:
    return load_rig(calibration, size) if calibration else rig_of(bag, topics, size)


def stamps_of(topics: tuple[TopicImages, TopicImages]) -> tuple[tuple[I64, I64], tuple[str, ...]]:
    """When the images were taken by their headers; when they were recorded, where the headers hold no times."""
    stamped = all(topic.stamp_ns.any() and (len(topic.stamp_ns) < 2 or np.ptp(topic.stamp_ns)) for topic in topics)
    if stamped:
        return (topics[0].stamp_ns, topics[1].stamp_ns), ()
    note = "headers hold no times: the times of recording are taken"
    return (topics[0].log_ns, topics[1].log_ns), (note,)


def folder_of(path: Path) -> Path:
    """Where world.toml lies: in the folder of the bag."""
    return path if path.is_dir() else path.parent


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
