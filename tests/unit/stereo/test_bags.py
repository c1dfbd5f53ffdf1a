"""Bags of ROS 1 and ROS 2: their topics, times and calibration, and what is refused."""

import json
import re
from pathlib import Path
from shutil import copy
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from toy_bags import COUNT, FOCAL, START_NS, STEP_NS, H, W, Writer, changed, picture, stereo_bag

from calib.errors import InputError
from calib.types import AnyArray
from stereo.readers import OpenOptions, find_layout, open_any, open_recording
from stereo.readers.bag_files import IMAGE, Bag, Message, Topic
from stereo.readers.bags import choose_topics

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")


@pytest.mark.parametrize(
    ("name", "plugin", "compressed", "chunks"),
    [("a.bag", "", False, "lz4"), ("b.bag", "", True, "bz2"), ("c", "sqlite3", False, ""), ("d", "mcap", True, "")],
)
def test_stereo_bag_of_every_storage_gives_the_same_pairs(tmp_path, name, plugin, compressed, chunks):
    recording = open_recording(
        stereo_bag(tmp_path / name, not plugin, plugin or "sqlite3", compressed=compressed, chunks=chunks)
    )
    frames = list(recording)
    assert [int(f.image[0, 0]) for f in frames] == [10 * i for i in range(COUNT)]
    assert recording.fps == pytest.approx(10.0)
    assert recording.skipped == []
    assert recording.sensor.rig.baseline_m == pytest.approx(0.1)
    assert recording.sensor.rig.left.fx == FOCAL
    assert [(f.index, int(f.images[1][0, 0])) for f in recording.sample(3)] == [(0, 0), (4, 40), (7, 70)]


def bag_of_pairs(path: Path, frames: range, *infos: Any) -> Path:
    writer = Writer(path, path.suffix == ".bag")
    writer.pairs(frames, *infos)
    writer.close()
    return path


def test_bare_mcap_file_is_read_without_its_metadata(tmp_path):
    file = next(stereo_bag(tmp_path / "bag", False, "mcap").glob("*.mcap"))
    assert len(list(open_recording(file.rename(tmp_path / "alone.mcap")))) == COUNT


def test_message_that_is_missing_on_one_side_is_a_skipped_frame(tmp_path):
    def stamps(i, side):
        return None if (i, side) == (6, "right") else START_NS + i * STEP_NS + 3_000_000 * (side == "right")

    recording = open_recording(stereo_bag(tmp_path / "a.bag", stamps=stamps))
    assert [f.index for f in recording] == [0, 1, 2, 3, 4, 5, 7]
    assert recording.skipped[0].why == "right: image is missing"
    assert "1 of 8 frames without a mate within 25.0 ms" in recording.notes[0]


def test_headers_without_a_time_of_this_world_take_the_time_of_recording(tmp_path):
    recording = open_recording(stereo_bag(tmp_path / "a.bag", stamps=lambda i, side: 0))
    assert [f.timestamp_s for f in recording][:3] == pytest.approx([0.0, 0.1, 0.2])
    assert "headers hold no times" in recording.notes[0]
    odd = stereo_bag(tmp_path / "a", False, stamps=lambda i, _: -(2**31) * 10**9 if i == 3 else START_NS + i * STEP_NS)
    assert len(list(open_recording(odd))) == COUNT


@pytest.mark.parametrize(
    ("shifts_m", "frame", "found"),
    [
        (None, "", "camera_info of /left/image_raw"),
        ((0.0, 0.0), "{}_optical", "no transform from left_optical to right_optical"),
        ((0.0, 0.0), "infra1", "'infra1'"),
        ((0.0, 0.1), "{}_optical", r"found \+3"),
    ],
)
def test_bag_without_calibration_or_baseline_is_refused_with_what_it_lacks(tmp_path, shifts_m, frame, found):
    bag_of_pairs(tmp_path / "a.bag", range(COUNT), shifts_m, frame)
    with pytest.raises(InputError, match=found):
        open_recording(tmp_path / "a.bag")


@pytest.mark.parametrize("name", ["a", "a.bag"])
def test_static_transforms_give_the_baseline_by_the_definition_in_the_bag(tmp_path, name):
    writer = Writer(tmp_path / name, name.endswith(".bag"))
    writer.pairs(range(3), (0.0, 0.0))
    writer.static_transforms(0.2)
    writer.close()
    recording = open_recording(tmp_path / name)
    np.testing.assert_allclose(recording.sensor.rig.right_SE3_left.translation, [-0.2, 0, 0])


def test_truncated_bag_is_refused_with_the_way_out(tmp_path):
    path = stereo_bag(tmp_path / "a.bag")
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(InputError, match="rosbag reindex"):
        open_recording(path)


def test_topic_that_is_not_in_the_bag_is_refused_by_name(tmp_path):
    with pytest.raises(InputError, match="'/x'"):
        find_layout(stereo_bag(tmp_path / "a.bag"), OpenOptions(topics=("/stereo/left/image_raw", "/x")))


def test_topics_of_two_rigs_are_listed_to_choose_from():
    bag = Listed("/a/left", "/a/right", "/b/left", "/b/right")
    with pytest.raises(InputError, match=r"/a/left.*/b/right.*topics="):
        choose_topics(bag, ())


class Listed:
    """A bag of which only the topics are known."""

    path = Path("bag")

    def __init__(self, *names: str) -> None:
        self.topics = tuple(Topic(name, IMAGE, 5) for name in names)


COLOUR_AND_DEPTH = ("/camera/color/image_raw", "/camera/depth/image_rect_raw")
INFRARED = ("/camera/infra1/image_rect_raw", "/camera/infra2/image_rect_raw")  # of a RealSense


def test_infrared_pair_is_in_the_order_of_its_numbers():
    assert choose_topics(Listed(*reversed(INFRARED)), ()) == ("stereo", *INFRARED)


def test_colour_topic_with_a_depth_topic_is_an_image_with_depth():
    bag = Listed(*COLOUR_AND_DEPTH, f"{COLOUR_AND_DEPTH[0]}/compressed")
    assert choose_topics(bag, ()) == ("rgbd", *COLOUR_AND_DEPTH)


@pytest.mark.parametrize("topics", [(*INFRARED, *COLOUR_AND_DEPTH), ("/front/image_raw", "/back/image_raw")])
def test_topics_that_are_no_clear_pair_are_asked_for_with_their_list(topics):
    with pytest.raises(InputError, match=rf"found {', '.join(topics)}; use topics="):
        choose_topics(Listed(*topics), ())


def test_one_image_topic_is_one_camera():
    with pytest.raises(InputError, match="one camera"):
        choose_topics(Listed("/cam/image_raw"), ())


def test_messages_that_are_compressed_one_by_one_are_refused_with_the_way_out(tmp_path):
    writer = Writer(tmp_path / "unused", False)
    writer.close()
    bag = rosbag2.Writer(tmp_path / "a", version=9, storage_plugin=rosbag2.StoragePlugin.SQLITE3)
    bag.set_compression(rosbag2.CompressionMode.MESSAGE, rosbag2.CompressionFormat.ZSTD)
    bag.open()
    writer.bag = bag
    writer.pairs(range(2))
    writer.close()
    with pytest.raises(InputError, match="ros2 bag convert"):
        find_layout(tmp_path / "a")


def test_files_that_are_compressed_are_refused_with_the_way_out(tmp_path):
    path = stereo_bag(tmp_path / "a", False)
    file = next(path.glob("*.db3"))
    file.rename(path / f"{file.name}.zstd")
    with pytest.raises(InputError, match="ros2 bag convert"):
        find_layout(path)


def nested(levels: int) -> str:
    """YAML of references whose every level stands for nine of the one before."""
    rows = [f"b{i}: &b{i} {{<<: [{', '.join([f'*b{i - 1}'] * 9)}]}}" for i in range(1, levels)]
    return "\n".join(["b0: &b0 {x: 1}", *rows]) + "\n"


@pytest.mark.parametrize("plugin", ["sqlite3", "mcap"])
@pytest.mark.parametrize(
    "changed",
    [
        lambda text: text + nested(12),
        lambda text: text.replace("format: cdr", f"format: cdr\n      offered_qos_profiles: {json.dumps(nested(12))}"),
        lambda text: text.replace(f"since_epoch: {START_NS}", "since_epoch: noon"),
        lambda text: re.sub("storage_identifier: .*", 'storage_identifier: ""', text),
    ],
    ids=["references without end", "the same in profiles", "a time that is none", "no storage"],
)
def test_bag_is_read_whatever_its_metadata_hold(tmp_path, plugin, changed):
    path = stereo_bag(tmp_path / "a", False, plugin)
    before = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_text(changed(before))
    assert changed(before) != before
    assert find_layout(path)[1].n_frames == COUNT


@pytest.mark.parametrize(
    ("lost", "more", "found"),
    [
        ("*.db3", "", r"no \.db3"),
        ("metadata.yaml", "b.db3", r"a\.db3 and b\.db3"),
    ],
)
def test_ros_2_folder_that_lacks_a_file_is_refused_with_the_way_out(tmp_path, lost, more, found):
    path = stereo_bag(tmp_path / "a", False)
    if more:
        copy(next(path.glob("*.db3")), path / more)
    next(path.glob(lost)).unlink()
    with pytest.raises(InputError, match=found):
        find_layout(path)


def test_parts_of_a_bag_follow_each_other(tmp_path):
    bag_of_pairs(tmp_path / "a", range(COUNT))
    next(bag_of_pairs(tmp_path / "b", range(COUNT, 2 * COUNT)).glob("*.db3")).rename(tmp_path / "a" / "b.db3")
    times = [message.log_ns for message in Bag(tmp_path / "a").messages("/left/image_raw")]
    assert times == [START_NS + i * STEP_NS for i in range(2 * COUNT)]


def sdk_bag(path: Path, unit_m: float | None, **streams: tuple[float, str, AnyArray, str]) -> Path:
    """A bag of the RealSense SDK: place [m], lens, picture and encoding of every stream."""
    writer = Writer(path, True)
    types = writer.store.types
    if unit_m is not None:
        unit = types["std_msgs/msg/Float32"](unit_m)
        writer.write("/device_0/sensor_0/option/Depth_Units/value", START_NS, unit)
    for stream, (x_m, model, pixels, encoding) in streams.items():
        topic, no_turn = f"/device_0/sensor_0/{stream}", types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        place = types["geometry_msgs/msg/Transform"](types["geometry_msgs/msg/Vector3"](x_m, 0.0, 0.0), no_turn)
        writer.write(f"{topic}/tf/0", START_NS, place)
        others = {"p": np.zeros(12), "r": np.zeros(9), "distortion_model": model}
        writer.write(f"{topic}/info/camera_info", START_NS, changed(writer.info(START_NS, 0.0, "0"), others))
        for log in range(START_NS, START_NS + COUNT * STEP_NS, STEP_NS):
            writer.write(f"{topic}/image/data", log, writer.image(log, pixels, encoding))
    writer.close()
    return path


def test_bag_of_the_realsense_sdk_has_its_baseline_from_the_places_of_its_cameras(tmp_path):
    cameras = {f"Infrared_{i}": (x_m, "Brown Conrady", picture(0), "mono8") for i, x_m in ((1, 0.0), (2, -0.055))}
    recording = open_recording(sdk_bag(tmp_path / "a.bag", None, **cameras))
    assert len(list(recording)) == COUNT
    assert recording.sensor.rig.baseline_m == pytest.approx(0.055)
    assert recording.sensor.rig.left.fx == FOCAL


def test_depth_of_the_realsense_sdk_is_placed_as_the_bag_says(tmp_path):
    model, deep = "Inverse Brown Conrady", np.full((H, W), 20_000, np.uint16)
    streams = {"Depth_0": (0.0, model, deep, "16UC1"), "Color_0": (0.2, model, picture(0), "mono8")}
    recording = open_any(sdk_bag(tmp_path / "a.bag", 1e-4, **streams))
    (frame, *_) = recording
    assert np.nanmedian(frame.images[1]) == pytest.approx(2.0)
    assert not recording.notes
    # A point 2 m ahead lies 0.2 m * 30 px / 2 m = 3 px farther to the right in the colour image.
    assert np.flatnonzero(np.isnan(frame.images[1][H // 2])).tolist() == [0, 1, 2]


def test_images_coded_as_video_are_named_with_their_topics(tmp_path):
    name = "theora_image_transport/msg/Packet"
    writer = Writer(tmp_path / "a.bag", True)
    writer.store.register(typesys.get_types_from_msg("std_msgs/Header header\nuint8[] data\n", name))
    packet = writer.store.types[name](writer.header(START_NS), np.zeros(9, np.uint8))
    writer.write("/left/image_raw/theora", START_NS, packet)
    writer.close()
    with pytest.raises(InputError, match="/left/image_raw/theora"):
        find_layout(tmp_path / "a.bag")


class Sent(Listed):
    """A bag of topics with one image each, of these encodings."""

    def __init__(self, **encodings: str) -> None:
        self._encodings = {f"/oak/{name}/image_raw": encoding for name, encoding in encodings.items()}
        super().__init__(*self._encodings)

    def messages(self, topic, start_ns=None):
        image = SimpleNamespace(data=b"", width=1, height=1, step=2, encoding=self._encodings[topic], is_bigendian=0)
        yield Message(0, lambda: image)


@pytest.mark.parametrize(
    ("encodings", "named", "kind"),
    [
        ({"rgb": "bgr8", "stereo": "16UC1"}, [], "rgbd"),
        ({"rgb": "bgr8", "stereo": "16UC1"}, ["rgb", "stereo"], "rgbd"),
        ({"rgb": "bgr8", "stereo": "16UC1"}, ["stereo", "rgb"], "rgbd"),
        ({"left": "16UC1", "right": "16UC1"}, ["left", "right"], "stereo"),
    ],
)
def test_16_bits_are_depth_unless_both_topics_have_them(encodings, named, kind):
    topics = [f"/oak/{name}/image_raw" for name in named]
    assert choose_topics(Sent(**encodings), topics) == (kind, *(f"/oak/{name}/image_raw" for name in encodings))
