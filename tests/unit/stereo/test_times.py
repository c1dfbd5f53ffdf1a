"""One time per frame: of each camera's own file, of names, of containers; two rates; what is not used is named."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_recordings import folder_recording, picture, video_pair, write_times, write_video

from calib.errors import InputError
from calib.times import rate_of_times
from stereo.readers import OpenOptions, open_recording, open_video
from stereo.readers.times import load_timestamps, read_times
from stereo.readers.video import _by_time, _Packets
from stereo.recording import Decoded, FrameClock, Recording, SingleCamera, refuse_untimed

KEPT = [i for i in range(12) if i != 5]
"""Frames of a right camera that lost the sixth."""
SLOWER = [i * i / 100 for i in range(6)]


@pytest.mark.parametrize(
    "name", ["{}_timestamps.csv", "{}/timestamps.csv", "timestamps_{}.txt", "{}/times.txt", "{}.csv"]
)
def test_each_camera_has_its_own_file_of_times(tmp_path, name):
    folder = folder_recording(tmp_path / "r", 11, [picture(10 * i) for i in range(11)])
    for side, frames in (("left", range(11)), ("right", KEPT)):
        times = [f"{i / 15:.5f}" for i in frames]
        write_times(folder / name.format(side), times)
        if "stamps.csv" not in name:
            (folder / name.format(side)).write_text("\n".join(times))
    recording = open_recording(folder)
    assert recording.fps == pytest.approx(15, rel=0.01)
    # Frame 6 of the left camera has the right one's sixth image; frame 5 has none.
    assert {f.index: (f.image[0, 0], f.images[1][0, 0]) for f in recording}[6] == (60, 50)
    assert [s.index for s in recording.skipped] == [5, 11]


def test_times_of_one_camera_alone_are_named_as_not_used(tmp_path):
    folder = folder_recording(tmp_path / "r", 3)
    write_times(folder / "left_timestamps.csv", [0.0, 0.1, 0.2])
    assert any("not used: left_timestamps.csv" in note for note in open_recording(folder).notes)


def test_videos_have_the_times_of_their_own_files(tmp_path):
    folder = video_pair(tmp_path, (11, 11))
    for side, frames in (("left", range(11)), ("right", KEPT)):
        write_times(folder / f"{side}_timestamps.csv", [i / 5 for i in frames])
    recording = open_recording(folder)
    assert [f.index for f in recording] == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10]
    assert recording.fps == pytest.approx(5)


def test_video_of_one_camera_has_the_times_of_the_file_next_to_it(tmp_path):
    write_video(tmp_path / "hall.avi", 4)
    write_times(tmp_path / "hall_timestamps.csv", [0.0, 0.5, 1.0, 1.5])
    video = open_video(tmp_path / "hall.avi")
    assert video.fps == pytest.approx(2)
    assert [f.timestamp_s for f in video] == [0.0, 0.5, 1.0, 1.5]


def test_videos_of_two_rates_pair_by_time():
    pairs = _by_time(np.arange(50) / 25, np.arange(60) / 30)
    both = [(a, b) for a, b in zip(pairs.left, pairs.right, strict=True) if a >= 0 and b >= 0]
    assert (5, 6) in both
    assert (45, 54) in both
    assert max(abs(a / 25 - b / 30) for a, b in both) <= 0.25 / 25


def test_videos_whose_times_waver_pair_in_order():
    wavering = np.sort(np.arange(200) / 30 + np.random.default_rng(0).normal(0.0, 0.008, 200))
    assert _by_time(np.arange(200) / 30, wavering) is None


def test_rate_is_the_mean_of_steps_that_a_clock_of_milliseconds_rounds():
    rate = rate_of_times(np.round(np.arange(61) / 15, 3))
    assert rate.fps == pytest.approx(15, rel=1e-3)


def test_header_that_gives_the_clock_for_a_rate_is_corrected_by_the_times(tmp_path, monkeypatch):
    write_video(tmp_path / "a.avi", 6)  # 10 per second
    times = np.arange(6) / 5
    monkeypatch.setattr("stereo.readers.video._packets", lambda path, most=None: _Packets(times, ()))
    assert open_video(tmp_path / "a.avi").fps == pytest.approx(5)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("frame,timestamp_s\n0,0\n1,nan\n", "'nan'"),
        ("frame,value\n0,0\n", "frame,timestamp_s"),
        ("frame,timestamp_s\n0,0\n999999999,1\n5,2\n", "number the frames from 0"),
        ("0" * 50_000_000, "expected a table of times of up to 33554432 bytes"),
    ],
)
def test_bad_timestamps_are_refused(tmp_path, text, found):
    (tmp_path / "timestamps.csv").write_text(text)
    with pytest.raises(InputError, match=rf"timestamps\.csv: .*{found}"):
        load_timestamps(tmp_path / "timestamps.csv", range(4), range(4))


@pytest.mark.parametrize(
    ("text", "times_s"),
    [
        ("frame,timestamp_s\n0,100.0\n1,100.1\n3,100.9\n", [0.0, 0.1, np.nan, 0.9]),
        ("frame;timestamp_s\n0;0,5\n1;0,75\n", [0.0, 0.25]),  # decimal commas
        ("frame,timestamp_s\n0,0.0\n1\x1c,0.5\x1d\n", [0.0, 0.5]),  # marks that count as blanks
    ],
)
def test_timestamps_of_any_table_start_at_zero(tmp_path, text, times_s):
    (tmp_path / "timestamps.csv").write_text(text)
    frames = range(len(times_s))
    np.testing.assert_allclose(load_timestamps(tmp_path / "timestamps.csv", frames, frames).times_s, times_s)


@pytest.mark.parametrize(("name", "count"), [("r/left", 6), ("a.mjpeg", 7)])
def test_frames_without_a_container_have_no_times_but_those_of_a_rate(tmp_path, name, count):
    folder_recording(tmp_path / "r")
    coded = cv2.imencode(".jpg", np.full((48, 64), 90, np.uint8))[1].tobytes()
    (tmp_path / "a.mjpeg").write_bytes(7 * coded)
    video = open_video(tmp_path / name)
    assert video.n_frames == count
    assert all(math.isnan(frame.timestamp_s) for frame in video.sample(count))
    with pytest.raises(InputError, match="fps="):
        refuse_untimed(video)
    assert [f.timestamp_s for f in open_video(tmp_path / name, OpenOptions(fps=5)).sample(count)][:2] == [0.0, 0.2]


def test_files_of_times_that_are_not_used_are_named_where_times_are_missing(tmp_path):
    folder = folder_recording(tmp_path / "r")
    write_times(folder / "left_timestamps.csv", [0, 0.1, 0.2, 0.3, 0.4, 0.5])
    with pytest.raises(InputError, match="left_timestamps"):
        refuse_untimed(open_recording(folder))


def test_table_with_a_time_of_one_frame_gives_no_times(tmp_path):
    folder = folder_recording(tmp_path / "r")
    write_times(folder / "timestamps.csv", [0])
    with pytest.raises(InputError, match="1 of 6"):
        refuse_untimed(open_recording(folder))


def test_times_of_one_camera_are_those_of_its_list_or_names(tmp_path):
    folder, names = folder_recording(tmp_path / "a").joinpath("left"), [f"{1700000000 + i / 5:.3f}" for i in range(6)]
    (folder / "timestamps.txt").write_text("\n".join(names))
    assert open_video(folder).fps == pytest.approx(5.0)
    named = open_video(folder_recording(tmp_path / "b", names) / "left")
    assert [frame.timestamp_s for frame in named] == pytest.approx([i / 5 for i in range(6)])
    assert not named.notes


@pytest.mark.parametrize(
    ("frames", "times_s", "found_s", "note"),
    [
        (
            [0, 1],
            [0, 0.2],
            [0, 0.2, 0.4, 0.6, 0.8, 1.0],
            "of 2 of 6 frames: the others follow at the same rate",
        ),
        (range(1, 7), SLOWER, SLOWER, "are counted from 1: its rows are the images in order"),
    ],
)
def test_table_of_times_that_is_too_short_or_counts_from_1_is_noted(tmp_path, frames, times_s, found_s, note):
    folder = folder_recording(tmp_path / "r")
    write_times(folder / "timestamps.csv", times_s, frames)
    recording = open_recording(folder)
    assert [frame.timestamp_s for frame in recording] == pytest.approx(found_s)
    found, *_ = recording.notes
    assert "timestamps.csv" in found
    assert found.endswith(note)


@pytest.mark.parametrize(
    ("column", "times", "period_s", "noted"),
    [
        ("timestamp_s", (0, 10, 20), 10.0, "another unit in timestamps.csv?"),
        ("timestamp_ms", (0, 100, 200), 0.1, "taken as ms"),
        ("time", (0, 100, 200), 0.1, "taken as ms"),
        ("timestamp_s", (1_700_000_000_000, 1_700_000_000_100, 1_700_000_000_200), 0.1, "taken as ms"),
    ],
    ids=["time-lapse", "named", "by its steps", "no clock counts so many seconds"],
)
def test_the_unit_of_times_is_that_of_their_column(tmp_path, column, times, period_s, noted):
    table = "".join(f"{frame},{time}\n" for frame, time in enumerate(times))
    (tmp_path / "timestamps.csv").write_text(f"frame,{column}\n{table}")
    found, notes = load_timestamps(tmp_path / "timestamps.csv", range(3), range(3))
    assert found[1] == pytest.approx(period_s)
    assert noted in notes[0]


def test_frames_after_a_time_far_ahead_run_on():
    image, own_s = np.zeros((4, 4), np.uint8), [0.0, 0.1, 90_000.0, 0.3, 0.4]
    parts = [(Decoded(index, time, image),) for index, time in enumerate(own_s)]
    decode = lambda indices: (part for part in parts)  # noqa: E731
    recording = Recording(Path("a.mp4"), decode, 5, FrameClock(10.0), [], SingleCamera((4, 4)))
    assert [frame.timestamp_s for frame in recording] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert not recording.skipped


COUNTER = [0, 1, 2, 9, 10, 11]
"""Of a camera that lost six frames."""


@pytest.mark.parametrize("first", [0, 1_000_000, 65_530])
def test_frames_that_a_camera_counted_are_the_images_in_order(tmp_path, first):
    folder = folder_recording(tmp_path / "r")
    write_times(folder / "timestamps.csv", [n / 10 for n in COUNTER], [(first + n) % 65_536 for n in COUNTER])
    recording = open_recording(folder)
    assert [frame.timestamp_s for frame in recording] == pytest.approx([0, 0.1, 0.2, 0.9, 1.0, 1.1])
    assert "are the images in order" in recording.notes[0]


def test_frames_of_a_table_that_are_the_numbers_of_the_images_are_theirs(tmp_path):
    folder = folder_recording(tmp_path / "r", [f"{n:04d}" for n in COUNTER])
    write_times(folder / "timestamps.csv", [n / 10 for n in COUNTER], COUNTER)
    recording = open_recording(folder)
    times = {frame.index: frame.timestamp_s for frame in recording}
    assert times == pytest.approx({n: n / 10 for n in COUNTER})
    assert not recording.notes


def test_table_whose_frames_belong_to_no_image_is_refused_with_what_was_found(tmp_path):
    folder = folder_recording(tmp_path / "r")
    write_times(folder / "timestamps.csv", [0, 0.1, 0.2], [100, 101, 102])
    with pytest.raises(InputError, match="100 to 102"):
        open_recording(folder)


def test_times_run_on_where_the_clock_of_a_table_was_set_back(tmp_path):
    table = "".join(f"{i},0{2 + (i < 3)}:59:5{i}\n" for i in range(6))
    (tmp_path / "timestamps.csv").write_text(f"frame,time\n{table}")
    times, notes = load_timestamps(tmp_path / "timestamps.csv", range(6), range(6))
    assert times.tolist() == [0, 1, 2, 3, 4, 5]
    assert "the clock jumps by -3599 s after frame 2" in notes[1]


@pytest.mark.parametrize(
    "lines",
    [
        [f"{i} {i / 10}" for i in range(6)],
        [f"{n} {i / 10}" for i, n in enumerate(COUNTER)],
        [f"{i},2023-10-29 02:59:59.{i}" for i in range(6)],
        [f"2023-10-29 02:59:59,{i}00" for i in range(6)],
        [f"{1_700_000_000_000 + 100 * i} left/{i}.png" for i in range(6)],
        ["# time;x", *(f"{i};0,{i}" for i in range(6))],
    ],
    ids=["counted", "counter with gaps", "dates", "comma before milliseconds", "names", "decimal commas"],
)
def test_list_of_times_may_hold_more_than_the_times(tmp_path, lines):
    (tmp_path / "times.txt").write_text("\n".join(lines))
    assert np.diff(read_times(tmp_path / "times.txt", 6).ns) == pytest.approx(1e8)


def test_list_of_times_that_is_too_short_is_refused(tmp_path):
    (tmp_path / "times.txt").write_text("0.0\n0.1\n\n0.3\n")
    with pytest.raises(InputError, match="found 3"):
        read_times(tmp_path / "times.txt", 4)
