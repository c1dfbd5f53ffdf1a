"""Foxglove messages in MCAP files, as JSON and as protobuf."""

import base64
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from toy_recordings import H, W, picture

from calib.errors import InputError
from stereo.readers import open_recording
from stereo.readers.bags import storage

writer_module = pytest.importorskip("mcap.writer")
descriptors = pytest.importorskip("google.protobuf.descriptor_pb2")
pytest.importorskip("mcap_protobuf.decoder")

COUNT, STEP_NS, START_NS = 4, 50_000_000, 1_700_000_000_000_000_000


def messages(side: str, i: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """A CompressedImage and a CameraCalibration."""
    stamp = divmod(START_NS + i * STEP_NS, 10**9)
    png = np.asarray(cv2.imencode(".png", picture(10 * i))[1]).tobytes()
    image = {"timestamp": stamp, "frame_id": side, "data": png, "format": "png"}
    shift = -3.0 if side == "right" else 0.0
    camera = {
        "timestamp": stamp, "frame_id": side, "width": W, "height": H, "distortion_model": "plumb_bob",
        "D": [0.0] * 5, "K": [30.0, 0, 15.5, 0, 30.0, 11.5, 0, 0, 1], "R": [1.0, 0, 0, 0, 1, 0, 0, 0, 1],
        "P": [30.0, 0, 15.5, shift, 0, 30.0, 11.5, 0, 0, 0, 1, 0],
    }  # fmt: skip
    return image, camera


def as_json(message: dict[str, Any]) -> bytes:
    seconds, nanoseconds = message["timestamp"]
    plain = message | {"timestamp": {"sec": seconds, "nsec": nanoseconds}}
    if "data" in plain:
        plain["data"] = base64.b64encode(plain["data"]).decode()
    return json.dumps(plain).encode()


def classes() -> tuple[bytes, dict[str, Any]]:
    """The file descriptor set of the two messages, and their classes by name."""
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    kinds = descriptors.FieldDescriptorProto
    file = descriptors.FileDescriptorProto(name="test.proto", package="foxglove", syntax="proto3")
    time = file.message_type.add(name="Time")
    for number, name in enumerate(("seconds", "nanos"), 1):
        time.field.add(name=name, number=number, type=kinds.TYPE_INT64, label=kinds.LABEL_OPTIONAL)
    texts = {"frame_id": kinds.TYPE_STRING, "format": kinds.TYPE_STRING, "distortion_model": kinds.TYPE_STRING,
             "data": kinds.TYPE_BYTES, "width": kinds.TYPE_INT64, "height": kinds.TYPE_INT64}  # fmt: skip
    for kind, names in (
        ("CompressedImage", ("frame_id", "data", "format")),
        ("CameraCalibration", ("frame_id", "width", "height", "distortion_model", "D", "K", "R", "P")),
    ):
        one = file.message_type.add(name=kind)
        one.field.add(name="timestamp", number=1, type=kinds.TYPE_MESSAGE, type_name=".foxglove.Time", label=1)
        for number, name in enumerate(names, 2):
            label = kinds.LABEL_OPTIONAL if name in texts else kinds.LABEL_REPEATED
            one.field.add(name=name, number=number, type=texts.get(name, kinds.TYPE_DOUBLE), label=label)
    pool = DescriptorPool()
    pool.Add(file)
    names = ("CompressedImage", "CameraCalibration")
    found = {name: GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}")) for name in names}
    return descriptors.FileDescriptorSet(file=[file]).SerializeToString(), found


def foxglove_file(path: Path, encoding: str) -> Path:
    schema_data, by_name = (b"{}", {}) if encoding == "json" else classes()
    with path.open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start()
        for side in ("left", "right"):
            for k, (kind, topic) in enumerate((("CompressedImage", "image"), ("CameraCalibration", "calibration"))):
                schema_encoding = "jsonschema" if encoding == "json" else "protobuf"
                schema = writer.register_schema(f"foxglove.{kind}", schema_encoding, schema_data)
                channel = writer.register_channel(f"/{side}/{topic}", encoding, schema)
                for i in range(COUNT):
                    message = messages(side, i)[k]
                    if encoding == "json":
                        data = as_json(message)
                    else:
                        seconds, nanoseconds = message["timestamp"]
                        stamp = {"seconds": seconds, "nanos": nanoseconds}
                        data = by_name[kind](**(message | {"timestamp": stamp})).SerializeToString()
                    writer.add_message(channel, START_NS // 10**6 + i, data, START_NS // 10**6 + i)
        writer.finish()
    return path


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_foxglove_images_and_calibrations_are_a_recording(tmp_path: Path, encoding: str) -> None:
    recording = open_recording(foxglove_file(tmp_path / "a.mcap", encoding))
    frames = list(recording)
    assert [int(f.right[0, 0]) for f in frames] == [0, 10, 20, 30]
    assert [f.timestamp_s for f in frames] == pytest.approx([0.0, 0.05, 0.1, 0.15])
    assert recording.rig.baseline_m == pytest.approx(0.1) and recording.rig.left.fx == 30.0


def test_chunk_that_unpacks_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = foxglove_file(tmp_path / "a.mcap", "json")
    monkeypatch.setattr(storage, "MAX_UNPACKED_BYTES", 100)
    with pytest.raises(InputError, match="compressed data of more than"):
        open_recording(path)
