"""Messages of bags: pixels of every encoding, depth, and what is damaged in them."""

import tracemalloc

import cv2
import numpy as np
import pytest
from toy_bags import START_NS, Writer, picture

from calib.errors import InputError, UnreadableError
from stereo.readers import open_recording
from stereo.readers.bag_messages import ImageMessage, stored_pixels


@pytest.mark.parametrize(
    ("encoding", "values", "expected"),
    [
        ("mono8", np.array([[1, 2], [3, 4]], np.uint8), 1),
        ("16UC1", np.array([[500, 2], [3, 4]], "<u2"), 500),
        ("rgb8", np.array([[[1, 2, 3]]], np.uint8), [3, 2, 1]),
        ("bgra8", np.array([[[1, 2, 3, 255]]], np.uint8), [1, 2, 3]),
        ("32FC1", np.array([[1.5]], "<f4"), 1.5),
    ],
)
def test_raw_encodings_give_bgr_or_grey(encoding, values, expected):
    rows, columns = values.shape[:2]
    stored = stored_pixels(ImageMessage(encoding, values.tobytes(), columns, rows, values.nbytes // rows))
    np.testing.assert_array_equal(stored[0, 0], expected)


def test_bayer_red_pixel_is_red_in_every_pattern():
    for pattern, (row, column) in {"rggb": (0, 0), "bggr": (1, 1), "gbrg": (1, 0), "grbg": (0, 1)}.items():
        mosaic = np.zeros((8, 8), np.uint8)
        mosaic[row::2, column::2] = 200
        stored = stored_pixels(ImageMessage(f"bayer_{pattern}8", mosaic.tobytes(), 8, 8, 8))
        np.testing.assert_array_equal(stored[4, 4], [0, 0, 200])


def test_compressed_depth_of_floats_is_unquantised():
    png = cv2.imencode(".png", np.array([[0, 101]], np.uint16))[1].tobytes()
    header = np.array([0], "<i4").tobytes() + np.array([2.0, 100.0], "<f4").tobytes()
    stored = stored_pixels(ImageMessage("32FC1; compressedDepth png", header + png))
    np.testing.assert_array_equal(stored, [[np.nan, 2.0]])


@pytest.mark.parametrize("damage", [lambda data: data[:20], lambda data: b""])
def test_damaged_camera_info_is_refused_in_one_sentence(tmp_path, damage):
    writer = Writer(tmp_path / "a", False)
    for side in ("left", "right"):
        writer.write(f"/{side}/image_raw", START_NS, writer.image(START_NS, picture(0)))
        info = writer.info(START_NS, 0.0)
        connection = writer.bag.add_connection(f"/{side}/camera_info", info.__msgtype__, typestore=writer.store)
        writer.bag.write(connection, START_NS, damage(writer.store.serialize_cdr(info, info.__msgtype__)))
    writer.close()
    with pytest.raises(InputError, match="/left/camera_info"):
        open_recording(tmp_path / "a")


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (ImageMessage("8UC-1", bytes(144), 4, 4, 36), "damaged pixels of '8UC-1'"),
        (ImageMessage("16UC7", bytes(144), 4, 4, 36), "damaged pixels of '16UC7'"),
        (ImageMessage("nv12", bytes(24), 4, 4, 4), "pixels coded as 'nv12', which is not read"),
        (ImageMessage("mono12", bytes(24), 4, 4, 6), "pixels coded as 'mono12'"),
        (ImageMessage("rgb8", bytes(16), 4, 4, 4), "16 bytes in steps of 4, where 4 rows of 4 pixels of rgb8 take 48"),
        (ImageMessage("mono8", b"\0" * 100, 60_000, 60_000, 60_000), "an image of 60000x60000 pixels"),
        (ImageMessage("16UC1; compressedDepth rvl", bytes(30)), "depth coded as rvl, which is not read"),
        (ImageMessage("h264", b"\0\0\0\1\x67" + bytes(20)), r"coded as 'h264' \(a packet of H.264 or H.265 video"),
        (ImageMessage("jpeg", b"\xff\xd8\xff" + bytes(2000)), "its end is cut off"),
    ],
)
def test_image_that_is_not_read_says_why(message, why):
    with pytest.raises(UnreadableError, match=why):
        stored_pixels(message)


def test_rows_without_padding_are_read_whatever_step_the_message_gives():
    assert stored_pixels(ImageMessage("rgb8", bytes(range(12)), 2, 2, 2))[1, 1].tolist() == [11, 10, 9]


def test_messages_that_announce_more_than_they_hold_take_no_memory():
    message = ImageMessage("mono8", bytes(range(4)), 4, 1, 2**32 - 1)
    tracemalloc.start()
    stored = stored_pixels(message)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert stored.tolist() == [[0, 1, 2, 3]]
    assert peak < 1e6
