"""What is in a folder, and when its frames were taken."""

import math
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_calibrations import EUROC, KITTI, MIDDLEBURY, foreign_calibrations
from toy_recordings import H, W, folder_recording, picture, write_images, write_times
from toy_stereo import toy_rig

from calib.errors import InputError, UnreadableError
from calib.rig import save_rig
from calib.times import rate_of_times, read_stamps
from stereo.readers import OpenOptions, find_layout, find_reader, open_recording
from stereo.readers.images import decode_image, to_8_bits, true_bits
from stereo.readers.pairing import pair_stamps, split_sides
from stereo.readers.times import stamps_in_names

COUNT = 6
START = 1_403_715_273_262_142_976
CALIBRATIONS = foreign_calibrations((W, H), focal_px=30.0)
STAMPS = [START + i * 50_000_000 for i in range(COUNT)]


def euroc(folder: Path, listed: bool = True) -> Path:
    for name in EUROC:
        camera = (folder / "mav0" / name).parent
        camera.mkdir(parents=True)
        (folder / "mav0" / name).write_text(CALIBRATIONS[name])
        for i, stamp in enumerate(STAMPS):
            write_images(camera / "data", f"{stamp}.png", image=picture(10 * i))
        if listed:
            rows = "".join(f"{stamp},{stamp}.png\n" for stamp in STAMPS)
            (camera / "data.csv").write_text("#timestamp [ns],filename\n" + rows)
    return folder


@pytest.mark.parametrize("listed", [True, False])
def test_euroc_folder_opens_with_the_times_of_its_stamps(tmp_path, listed):
    recording = open_recording(euroc(tmp_path, listed))
    assert [round(f.timestamp_s, 6) for f in recording] == [0.0, 0.05, 0.1, 0.15, 0.2, 0.25]
    assert recording.fps == pytest.approx(20.0)
    assert recording.sensor.rig.baseline_m == pytest.approx(0.12)


def test_euroc_cameras_in_the_wrong_order_are_refused(tmp_path):
    folder, swap = euroc(tmp_path) / "mav0", tmp_path / "swap"
    for old, new in ((folder / "cam0", swap), (folder / "cam1", folder / "cam0"), (swap, folder / "cam1")):
        old.rename(new)
    with pytest.raises(InputError, match="swapped"):
        open_recording(tmp_path)


def kitti(folder: Path, suffix: str) -> Path:
    day = folder / "2011_09_26"
    for camera in ("image_00", "image_01"):
        drive = day / f"2011_09_26_drive_0001_{suffix}" / camera
        write_images(drive / "data", *(f"{i:010d}.png" for i in (0, 1, 3)))
        (drive / "timestamps.txt").write_text("".join(f"2011-09-26 13:02:25.{i}00000000\n" for i in range(4)))
    rows = [f"S_rect_{i}: {W} {H}\nP_rect_{i}: 25 0 15.5 {shift} 0 25 11.5 0 0 0 1 0\n"
            for i, shift in (("00", 0), ("01", -2.5))]  # fmt: skip
    (day / KITTI).write_text(CALIBRATIONS[KITTI] + "".join(rows))
    return folder


@pytest.mark.parametrize(("suffix", "focal_px", "baseline_m"), [("sync", 25.0, 0.1), ("extract", 30.0, 0.12)])
def test_kitti_drive_is_rectified_by_its_name(tmp_path, suffix, focal_px, baseline_m):
    recording = open_recording(kitti(tmp_path, suffix))
    assert recording.sensor.rig.left.fx == focal_px
    assert recording.sensor.rig.baseline_m == pytest.approx(baseline_m)
    assert [f.timestamp_s for f in recording] == pytest.approx([0.0, 0.1, 0.3])


def test_empty_line_of_a_drive_is_a_missing_image(tmp_path):
    folder = kitti(tmp_path, "sync")
    for file in folder.rglob("timestamps.txt"):
        lines = file.read_text().split("\n")
        lines[2] = ""
        file.write_text("\n".join(lines))
    assert [f.timestamp_s for f in open_recording(folder)] == pytest.approx([0.0, 0.1, 0.3])


def test_image_of_a_drive_without_a_time_is_named(tmp_path):
    folder = kitti(tmp_path, "sync")
    file = next(folder.rglob("image_01/timestamps.txt"))
    lines = file.read_text().split("\n")
    file.write_text("\n".join(["", *lines[1:]]))
    with pytest.raises(InputError, match=r"image_01/timestamps\.txt.*0000000000\.png"):
        open_recording(folder)
    file.write_text("\n".join(lines[:3]))
    with pytest.raises(InputError, match=r"0000000003\.png"):
        open_recording(folder)


def test_middlebury_pair_is_one_frame(tmp_path):
    (write_images(tmp_path, "im0.png", "im1.png", "im1E.png") / MIDDLEBURY).write_text(CALIBRATIONS[MIDDLEBURY])
    recording = open_recording(tmp_path)
    assert find_reader(tmp_path).key == "middlebury"
    assert len(list(recording)) == 1
    assert recording.sensor.rig.baseline_m == pytest.approx(0.12)


@pytest.mark.parametrize(
    "names",
    [("left{:03d}", "right{:03d}"), ("{:03d}_L", "{:03d}_R"), ("cam0_{}", "cam1_{}"), ("I1_{:06d}", "I2_{:06d}"),
     ("cam0_img{:02d}", "cam1_img{:02d}"), ("{}-imageLeft", "{}-imageRight")],
)  # fmt: skip
def test_images_in_one_folder_pair_by_any_naming_of_the_sides(tmp_path, names):
    for i in range(COUNT):
        for value, name in zip((10, 200), names, strict=True):
            write_images(tmp_path, f"{name.format(i)}.png", image=picture(value + i))
    save_rig(toy_rig((W, H), focal_px=30.0), tmp_path / "rig.toml")
    frames = list(open_recording(tmp_path))
    assert [(int(f.image[0, 0]), int(f.images[1][0, 0])) for f in frames] == [(10 + i, 200 + i) for i in range(COUNT)]


@pytest.mark.parametrize("names", ["frame1 frame2 frame3", "camera1 camera2 camera3", "calibration result"])
def test_names_without_a_side_are_no_pair(names):
    assert split_sides(names.split()) is None


def test_nanoseconds_in_timestamps_csv_are_recognised(tmp_path):
    folder = folder_recording(tmp_path / "r", COUNT)
    write_times(folder / "timestamps.csv", STAMPS)
    recording = open_recording(folder)
    assert recording.fps == pytest.approx(20.0)
    assert "taken as ns" in recording.notes[0]
    even = open_recording(folder, OpenOptions(fps=5.0))
    assert [f.timestamp_s for f in even][:3] == pytest.approx([0.0, 0.2, 0.4])


def test_twelve_bits_in_sixteen_are_scaled_by_the_brightest_frame(tmp_path):
    folder = folder_recording(tmp_path / "r", COUNT, [np.full((H, W), 900, np.uint16)] * COUNT)
    write_images(folder, "right/0005.png", image=np.full((H, W), 4000, np.uint16))
    recording = open_recording(folder)
    assert int(next(iter(recording)).image[0, 0]) == 900 >> 4
    assert [note for note in recording.notes if "16 bits" in note] == [
        "images of 16 bits whose values use 12: their upper 8 bits are taken"
    ]


def test_true_bits_are_those_of_the_largest_value():
    bits = {255: 8, 256: 10, 1023: 10, 4095: 12, 4096: 14, 65535: 16}
    assert {v: true_bits([np.array([[v]], np.uint16)]) for v in bits} == bits
    assert true_bits([np.zeros((2, 2), np.uint8)]) is None
    np.testing.assert_array_equal(to_8_bits(np.array([[4095, 65535]], np.uint16), 12), [[255, 255]])


@pytest.mark.parametrize(
    ("suffix", "kind"),
    [(suffix, np.uint8) for suffix in (".png", ".jpg", ".bmp", ".tiff", ".webp", ".ppm")]
    + [(suffix, np.uint16) for suffix in (".png", ".tiff", ".ppm")],
)
def test_image_of_every_format_is_decoded_unless_it_is_cut_off(suffix, kind):
    data = cv2.imencode(suffix, np.full((37, 53, 3), 9, kind))[1].tobytes()
    image = decode_image(data)
    assert (image.shape, image.dtype) == ((37, 53, 3), kind)
    with pytest.raises(UnreadableError):
        decode_image(data[:8])


def test_exif_orientation_turns_an_image_as_a_viewer_does():
    stored = np.zeros((16, 32), np.uint8)
    stored[:8, :8] = 200  # upper left as stored, lower right when turned by 180 degrees (tag 3)
    data = cv2.imencode(".jpg", stored)[1].tobytes()
    tiff = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x112, 3, 1, 3, 0, 0)
    exif = b"Exif\0\0" + tiff
    turned = decode_image(data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:])
    assert turned[0, 0] < 20
    assert turned[-1, -1] > 180
    assert decode_image(data)[0, 0] > 180


LFS = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 727\n"


@pytest.mark.parametrize(
    ("name", "content", "found"),
    [("a.bag", LFS, "git lfs pull"), ("a.svo2", "SVO", "ZED SDK")],
)
def test_file_that_is_no_recording_is_named_as_what_it_is(tmp_path, name, content, found):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=found):
        find_layout(tmp_path / name)


STEP = 100_000_000
NOW = 1_650_000_000_000_000_000
EVEN = NOW + STEP * np.arange(10)


@pytest.mark.parametrize(
    "text",
    ["nan", "1e300", "9" * 30, "soon", "", "0001-01-01 00:00:00", "9999-12-31 00:00:00", "2262-04-12 00:00:00"],
)
def test_text_that_no_clock_shows_is_refused(text):
    with pytest.raises(InputError, match=f"expected.* found '?{text}"):
        read_stamps("", [text, "2022-04-15 05:20:00" if "-" in text else "1"])


@pytest.mark.parametrize(
    ("names", "step_ns"),
    [
        (["rgb_1650000000.066", "rgb_1650000000.133"], 67_000_000),
        (["1403715273262142976", "1403715273312143104"], 50_000_128),
        ([f"1650000000_{n}" for n in (0, 66666667, 133333333, 200000000)], 66_666_667),  # nanoseconds without zeros
        ([f"2023-04-05_12-34-5{i}.{5 * i}00" for i in range(2)], 1_500_000_000),
        ([f"20230405_12345{s}_{n:02d}" for s in range(4) for n in range(10)], 100_000_000),  # counted in each second
        ([f"2023-04-05T12-34-56.{n}+0200" for n in range(8)], 100_000_000),  # decimals, behind a point
        ([f"20230405_123456_{n:02d}" for n in range(10)], None),  # of how many in the second?
        ([f"frame_{i:07d}_{1650000000000 + 33 * i}" for i in range(4)], 33_000_000),
        (["2022041501", "2022041502"], None),
        (["9" * 20, "8" * 20], None),  # more digits than a clock
        (["20230405_120000"] * 9, None),
    ],
)
def test_times_in_names_have_their_unit(names, step_ns):
    stamps = stamps_in_names(names)
    step = None if stamps is None else np.median(np.diff(stamps.ns))
    assert step == (step_ns and pytest.approx(step_ns, abs=2e6))


def test_frames_pair_with_the_nearest_within_a_quarter_period():
    right = np.delete(EVEN, 6) + np.array([0, 0, 0, 26, 0, 0, 0, 0, 0]) * STEP // 100
    pairs = pair_stamps(EVEN, right)
    frames = list(zip(pairs.left.tolist(), pairs.right.tolist(), strict=True))
    assert frames[2:5] == [(2, 2), (3, -1), (-1, 3)]
    assert frames[7] == (6, -1)
    assert pairs.unpaired == 3
    assert pairs.fps == pytest.approx(10.0)
    assert "3 of 11 frames without a mate within 25.0 ms" in pairs.notes[0]


def test_frames_recorded_late_are_put_in_their_place():
    order = [0, 1, 3, 2, 4, 5, 6, 7, 8, 9]
    pairs = pair_stamps(EVEN[order], EVEN)
    assert pairs.left.tolist() == order
    assert pairs.right.tolist() == list(range(10))
    assert "1 frame of left" in pairs.notes[0]


def test_frames_of_repeated_times_are_skipped():
    stamps = EVEN[[0, 1, 2, 3, 3, 5, 6, 7, 8, 9]]
    pairs = pair_stamps(stamps, stamps)
    assert (pairs.left >= 0).sum() == 9
    assert np.all(np.diff(pairs.times_s[pairs.left >= 0]) > 0)


@pytest.mark.parametrize("jump_s", [30 * 86_400, -1_650_000_000])
def test_clock_that_was_set_runs_on_at_the_nominal_rate(jump_s):
    stamps = EVEN + np.where(np.arange(10) >= 5, jump_s * 10**9, 0)
    pairs = pair_stamps(stamps, stamps)
    np.testing.assert_allclose(pairs.times_s, np.arange(10) * 0.1)
    assert "days after frame 4" in pairs.notes[0]
    assert pairs.unpaired == 0


def test_clocks_that_differ_by_a_constant_or_stand_still_pair_in_order():
    pairs = pair_stamps(EVEN, EVEN + 5 * STEP + STEP // 3)
    assert pairs.unpaired == 0
    assert "paired in order" in pairs.notes[0]
    pairs = pair_stamps(np.zeros(3, np.int64), np.zeros(3, np.int64))
    assert pairs.left.tolist() == pairs.right.tolist() == [0, 1, 2]
    assert math.isnan(pairs.fps)


def test_rate_leaves_out_gaps():
    rate = rate_of_times(np.array([0.0, 0.1, 0.2, 0.5, 0.6, 0.7]))
    assert rate.fps == pytest.approx(10.0)
    assert rate.jitter_ms == pytest.approx(0.0, abs=1e-9)
    assert (rate.gaps, rate.dropped) == (1, 2)
    assert rate.longest_gap_s == pytest.approx(0.3)
    assert rate_of_times(np.array([1.0])) is None
