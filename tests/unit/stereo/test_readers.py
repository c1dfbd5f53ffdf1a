"""Readers of stereo recordings."""

import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_recordings import H, W, folder_recording, picture, textured, video_pair, write_frames, write_times, write_video
from toy_stereo import toy_rig

from calib.errors import InputError
from calib.io import entries
from calib.pose import SE3
from calib.rig import save_rig
from calib.world import RigEntry, save_rigs
from stereo.readers import OpenOptions, find_layout, open_recording, open_video
from stereo.readers.live import READER, without_password
from stereo.readers.open import open_rigs
from stereo.readers.pairing import even_sequence, pair_files
from stereo.readers.video import VideoFile, _Packets
from stereo.recording import Decoded, FrameClock, LiveRecording, Recording, SingleCamera, prefetch


@pytest.mark.parametrize("colour", [False, True])
def test_folder_recording_yields_pairs_in_order_each_time(tmp_path, colour):
    recording = open_recording(folder_recording(tmp_path / "r", colour=colour))
    for _ in range(2):
        frames = list(recording)
        values = [int(f.image[0, 0, 0] if colour else f.image[0, 0]) for f in frames]
        assert [f.index for f in frames] == list(range(6))
        assert values == [0, 10, 20, 30, 40, 50]
    assert frames[0].image.shape == ((H, W, 3) if colour else (H, W))
    assert recording.n_frames == 6
    assert recording.skipped == []


@pytest.mark.parametrize(
    ("damage", "why"),
    [
        (lambda data: b"not an image", "cannot be decoded: no image that OpenCV reads"),
        (lambda data: data[:-40], "cannot be decoded: its end is cut off"),
        (lambda data: cv2.imencode(".png", np.zeros((H, W + 2), np.uint8))[1], "is 34x24, not 32x24"),
    ],
    ids=["no image", "cut off", "another size"],
)
def test_damaged_image_is_skipped_with_its_reason(tmp_path, damage, why):
    file = folder_recording(tmp_path / "r") / "left" / "0002.png"
    file.write_bytes(damage(file.read_bytes()))
    recording = open_recording(tmp_path / "r")
    assert [f.index for f in recording] == [0, 1, 3, 4, 5]
    assert [(s.index, s.why) for s in recording.skipped] == [(2, f"left: left/0002.png {why}")]


def test_frames_whose_time_does_not_advance_are_skipped_with_the_reason(tmp_path):
    times, image = [0.0, 0.1, np.nan, 0.1, 0.05, 0.2], np.zeros((H, W), np.uint8)

    def decode(indices):
        for index in range(6) if indices is None else indices:
            yield (Decoded(index, times[index], image),)

    video = Recording(tmp_path, decode, 6, FrameClock(10.0), [], SingleCamera((W, H)))
    assert [(frame.index, frame.timestamp_s) for frame in video] == [(0, 0.0), (1, 0.1), (5, 0.2)]
    assert [(skipped.index, skipped.why) for skipped in video.skipped] == [
        (2, "its time is nan"),
        (3, "its time, 0.1 s, is not after 0.1 s of the frame before"),
        (4, "its time, 0.05 s, is not after 0.1 s of the frame before"),
    ]
    assert [frame.index for frame in video.at([0, 2, 5])] == [0, 5]


def test_missing_file_leaves_a_gap_in_time(tmp_path):
    folder = folder_recording(tmp_path / "r", 15)
    (folder / "left" / "0002.png").unlink()
    write_times(folder / "timestamps.csv", [i * 0.1 for i in range(15)])
    recording = open_recording(folder)
    frames = list(recording)
    assert [f.index for f in frames][:4] == [0, 1, 3, 4]
    assert frames[2].timestamp_s == pytest.approx(0.3)
    assert recording.fps == pytest.approx(10.0)
    assert recording.skipped[0].index == 2


def test_folders_that_do_not_pair_are_refused_by_name(tmp_path):
    folder = folder_recording(tmp_path / "r", 9)
    for i in (3, 5, 7):
        (folder / "right" / f"{i:04d}.png").unlink()
    with pytest.raises(InputError, match=r"0003\.png"):
        open_recording(folder)


def test_files_pair_by_number():
    pairs = pair_files([Path(f"l/left{i:02d}.jpg") for i in range(9)], [Path(f"r/right{i:02d}.jpg") for i in range(9)])
    assert pairs[4] == (Path("l/left04.jpg"), Path("r/right04.jpg"))


def test_files_stamped_by_two_clocks_pair_in_order():
    left, right = ([Path(f"{first + 33 * i}.png") for i in range(5)] for first in (1000, 1007))
    assert pair_files(left, right) == list(zip(left, right, strict=True))


def test_files_that_lack_others_on_each_side_are_not_paired_in_order():
    left, right = ([Path(f"{n}.png") for n in range(8) if n not in lost] for lost in ((3, 4), (5, 6)))
    with pytest.raises(InputError, match=r"3\.png.*6 in .*and 6 in"):
        pair_files(left, right)


def test_file_whose_mate_has_another_name_is_refused():
    with pytest.raises(InputError, match=r"left/b\.png"):
        pair_files([Path(f"left/{name}.png") for name in "abc"], [Path("right/a.png"), Path("right/c.png")])


def test_even_sequence_leaves_uneven_numbers_alone():
    assert even_sequence([0, 5, 15]) == [0, 5, 10, 15]
    assert even_sequence([1000, 1033, 1067, 1100]) == [1000, 1033, 1067, 1100]
    assert even_sequence([3]) == [3]


@pytest.mark.parametrize("right", [8, 5])
def test_shorter_video_trims_the_pair(tmp_path, right):
    recording = open_recording(video_pair(tmp_path, (8, right)))
    frames = list(recording)
    assert [f.index for f in frames] == list(range(right))
    assert frames[0].image.ndim == 2
    assert recording.fps == pytest.approx(10.0)
    assert frames[4].timestamp_s == pytest.approx(0.4)
    assert recording.n_frames == 8
    assert [s.index for s in recording.skipped] == list(range(right, 8))


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (lambda folder: open_recording(folder_recording(folder)), [f"000{n % 6}.png" for n in range(12)]),
        (lambda folder: open_recording(video_pair(folder, (8, 5))), ["left.avi", "right.avi"]),
        (lambda folder: open_video(video_pair(folder, (8, 5)) / "left.avi"), ["left.avi"]),
    ],
    ids=["folders", "two videos", "one video"],
)
def test_recording_lists_the_files_of_its_images(tmp_path, make, names):
    assert [file.name for file in make(tmp_path).files] == names


def test_truncated_video_ends_early_with_a_note(tmp_path):
    video_pair(tmp_path, (30, 30), 320, 240)
    data = (tmp_path / "right.avi").read_bytes()
    (tmp_path / "right.avi").write_bytes(data[: len(data) // 2])
    recording = open_recording(tmp_path)
    count = len(list(recording))
    assert 0 < count < 30
    assert len(recording.skipped) == 30 - count


def test_single_camera_video_is_refused_as_a_pair(tmp_path):
    write_video(tmp_path / "clip.avi", 3, 64, 48)
    with pytest.raises(InputError, match="needs both cameras"):
        open_recording(tmp_path / "clip.avi")


@pytest.mark.parametrize(("count", "frames"), [(3, [0, 2, 5]), (100, [*range(6)])])
def test_sample_is_spread_over_the_frames(tmp_path, count, frames):
    recording = open_recording(folder_recording(tmp_path / "r"))
    assert [f.index for f in recording.sample(count)] == frames
    assert recording.skipped == []


def test_sample_of_videos_seeks_its_frames(tmp_path):
    frames = open_recording(video_pair(tmp_path, (12, 12))).sample(4)
    assert [(f.index, round(int(f.image[4, 4]) / 20)) for f in frames] == [(i, i) for i in (0, 4, 7, 11)]


def test_path_that_is_absent_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file or folder"):
        open_recording(tmp_path / "absent")


def test_world_file_gives_the_pose(tmp_path):
    folder = folder_recording(tmp_path / "r")
    rotation = "rotation = [[1,0,0],[0,-1,0],[0,0,-1]]"
    (folder / "world.toml").write_text(f"[world_SE3_left]\n{rotation}\ntranslation_m = [0,0,2.5]\n")
    pose = open_recording(folder).sensor.world_SE3_left
    assert pose.translation[2] == 2.5


def test_single_camera_folder_is_a_video(tmp_path):
    folder = folder_recording(tmp_path / "r") / "left"
    (folder / "0001.png").write_bytes(b"")
    video = open_video(folder)
    assert [f.index for f in video] == [0, 2, 3, 4, 5]
    assert video.sensor.size == (W, H)
    assert len(video.skipped) == 1


def test_prefetch_passes_errors_on():
    def source():
        yield 0
        raise OSError("gone")

    with pytest.raises(OSError, match="gone"):
        list(prefetch(source()))


def test_closed_prefetch_stops_its_thread_with_its_source():
    before, closed = threading.active_count(), threading.Event()

    def source():
        try:
            yield from range(1000)
        finally:
            closed.set()

    items = prefetch(source(), depth=2)
    assert next(items) == 0
    items.close()
    assert closed.is_set()
    assert threading.active_count() == before


def test_topics_may_be_one_text():
    assert OpenOptions(topics="/a, /b").topics == ("/a", "/b")


def test_rate_must_be_a_positive_number():
    for fps in ("30", -1):
        with pytest.raises(InputError, match=repr(fps)):
            OpenOptions(fps=fps)


def test_files_that_are_no_part_of_a_recording_are_passed_over(tmp_path):
    folder = folder_recording(tmp_path / "r")
    for name in ("._rig.toml", "left/._000000.png", "._left.mp4"):  # of macOS
        (folder / name).write_bytes(b"\0\5\x16\7" + bytes(100))
    (folder / "._left").mkdir()
    (folder / "notes.json").write_text('{"by": "hand"}')
    assert [path.name for path in entries(folder)] == ["left", "notes.json", "rig.toml", "right"]
    assert len(list(open_recording(folder))) == 6


def video_with_times(path: Path, ticks: list[int]) -> None:
    """A video of 10 Hz whose frames are taken at these ticks and as bright as 20 times the tick."""
    write_frames(whole := path.with_name("whole.mp4"), [np.full((H, W), 20 * t, np.uint8) for t in range(10)], "mp4v")
    packets = cv2.VideoCapture(str(whole))
    packets.set(cv2.CAP_PROP_FORMAT, -1)
    as_stored = [cv2.VIDEOWRITER_PROP_RAW_VIDEO, 1, cv2.VIDEOWRITER_PROP_KEY_INTERVAL, 1]
    code = cv2.VideoWriter.fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, 10.0, (W, H), as_stored)
    for tick in range(10):
        packet = packets.read()[1]
        if tick in ticks:
            writer.set(cv2.VIDEOWRITER_PROP_PTS, tick)
            writer.write(packet)
    writer.release()
    whole.unlink()


def test_videos_are_paired_by_time_where_one_lost_frames(tmp_path):
    save_rig(toy_rig((W, H), focal_px=60.0), tmp_path / "rig.toml")
    for side, ticks in (("left", list(range(10))), ("right", [0, 1, 2, 3, 7, 8, 9])):
        video_with_times(tmp_path / f"{side}.mkv", ticks)
    recording = open_recording(tmp_path)
    frames = list(recording)
    assert [frame.timestamp_s for frame in frames] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.7, 0.8, 0.9])
    assert all(abs(frame.image.mean() - frame.images[1].mean()) < 3.0 for frame in frames)
    assert [skipped.index for skipped in recording.skipped] == [4, 5, 6]
    assert any("3 of 10 frames without a mate" in note for note in recording.notes)
    assert [frame.index for frame in recording.at([3, 5, 8])] == [3, 8]


@pytest.mark.parametrize("count", [10, 7])
def test_videos_are_paired_by_time_where_the_right_one_begins_later(tmp_path, count):
    save_rig(toy_rig((W, H), focal_px=60.0), tmp_path / "rig.toml")
    video_with_times(tmp_path / "left.mkv", list(range(count)))
    video_with_times(tmp_path / "right.mkv", list(range(3, 10)))
    recording = open_recording(tmp_path)
    frames = list(recording)
    assert [frame.index for frame in frames] == list(range(3, count))
    assert all(abs(frame.image.mean() - frame.images[1].mean()) < 3.0 for frame in frames)
    assert any("right video begins +0.3 s after the left one" in note for note in recording.notes)


def test_videos_of_two_clocks_are_paired_in_order(tmp_path, monkeypatch):
    packets = {"left.avi": np.arange(6) / 10, "right.avi": 90 + np.arange(6) / 10}
    monkeypatch.setattr("stereo.readers.video._packets", lambda path, most=None: _Packets(packets[path.name], ()))
    recording = open_recording(video_pair(tmp_path, (6, 6)))
    assert len(list(recording)) == 6
    assert any("right video begins +90 s after the left one: paired in order" in note for note in recording.notes)


@pytest.mark.parametrize(("count", "how"), [(6, "in order"), (30, "by number")])
def test_images_numbered_from_different_starts_are_named(tmp_path, count, how):
    folder = folder_recording(tmp_path / "r", count, [picture(n) for n in range(count)])
    for file in sorted((folder / "right").iterdir(), reverse=True):
        file.rename(file.with_name(f"{int(file.stem) + 1:04d}.png"))
    notes = open_recording(folder).notes
    assert any(f"left/0000.png and right/0001.png: paired {how}" in note for note in notes)


def test_rate_of_the_caller_replaces_the_times_of_one_camera(tmp_path):
    folder = folder_recording(tmp_path / "r") / "left"
    write_times(folder / "timestamps.csv", [0, 7, 9])
    video = open_video(folder, OpenOptions(fps=5.0))
    assert video.fps == 5.0
    assert video.notes == []
    assert [frame.timestamp_s for frame in video][:3] == pytest.approx([0.0, 0.2, 0.4])


@pytest.mark.parametrize(
    ("opened", "options", "message"),
    [
        (open_video, OpenOptions(topics=("/a", "/b")), "topics=: expected a bag, found .*: one camera"),
        (open_video, OpenOptions(Path("rig.toml")), "calibration=: expected a stereo pair or images with depth, found"),
        (open_recording, OpenOptions(topics=("/a", "/b")), "topics=: expected a bag, found .*images of two cameras"),
    ],
)
def test_options_that_a_recording_does_not_take_are_refused(tmp_path, opened, options, message):
    folder = folder_recording(tmp_path / "r")
    with pytest.raises(InputError, match=message):
        opened(folder / "left" if opened is open_video else folder, options)


COUNT = 9


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *args: object) -> None:
        pass


@pytest.fixture(scope="module")
def served(tmp_path_factory) -> Iterator[tuple[str, OpenOptions]]:
    """Address of a folder with a side-by-side video and both of its halves, and how to open them."""
    folder = tmp_path_factory.mktemp("served")
    left, right = textured()[:48, :64], textured(4)[:48, :64]
    for name, image in (("both", np.hstack([left, right])), ("left", left), ("right", right)):
        write_frames(folder / f"{name}.avi", [np.ascontiguousarray(image)] * COUNT)
    save_rig(toy_rig((64, 48), focal_px=60.0), folder / "rig.toml")
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}", OpenOptions(folder / "rig.toml")
        server.shutdown()


def test_stream_with_both_views_gives_pairs_until_it_ends(served):
    address, options = served
    recording = open_recording(Path(f"{address}/both.avi"), options)
    assert isinstance(recording, LiveRecording)
    assert recording.n_frames == 0
    frames = list(recording)
    assert [f.index for f in frames] == list(range(COUNT))
    assert frames[0].image.shape == (48, 64)
    assert recording.skipped == []
    assert frames[5].timestamp_s == pytest.approx(0.5, abs=0.01)
    again = open_recording(Path(f"{address}/both.avi"), options)
    assert [f.index for f in again.sample(3)] == [0, 3, 6]


def test_two_streams_are_paired_as_they_come(served):
    address, options = served
    recording = open_recording(Path(f"{address}/left.avi,{address}/right.avi"), options)
    assert len(list(recording)) == COUNT
    assert "paired as they come" in recording.notes[0]


def test_live_camera_without_calibration_asks_for_one(served):
    with pytest.raises(InputError, match="calibration="):
        open_recording(Path(f"{served[0]}/both.avi"))


def test_address_without_an_answer_is_refused():
    with pytest.raises(InputError, match="answers"):
        find_layout(Path("http://127.0.0.1:9/x"))


@pytest.mark.parametrize("name", ["0", "0,1", "rtsp://a/b", "http://a/b,http://a/c"])
def test_devices_or_addresses_are_live(name):
    assert READER.fits(Path(name))


@pytest.mark.parametrize("name", ["/tmp/0", "ftp://a/b"])
def test_files_are_not_live(name):
    assert not READER.fits(Path(name))


def test_password_of_an_address_is_left_out():
    assert without_password("rtsp://me:secret@10.0.0.1/a") == "rtsp://10.0.0.1/a"


def numbered_video(path: Path, code: str) -> Path:
    """400 frames of 160 x 128 px that show their number in binary bars of 12 px."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), 25.0, (160, 128), True)
    for number in range(400):
        bits = np.repeat([220 if number >> bit & 1 else 40 for bit in range(10)], 16)
        writer.write(np.broadcast_to(bits[None, :, None], (128, 160, 3)).astype(np.uint8))
    writer.release()
    return path


@pytest.mark.parametrize(("name", "code"), [("a.avi", "PIM1"), ("a.mpg", "PIM1"), ("a.mp4", "mp4v")])
def test_frames_of_a_video_by_number_are_those_of_reading_in_order(tmp_path, name, code):
    video = VideoFile(numbered_video(tmp_path / name, code))  # OpenCV's seek in the first is off by one frame
    assert video._seeks == (name != "a.avi")
    found = [(frame.index, frame.image) for frame in video.at([5, 299, 399])]
    shown = [sum(1 << bit for bit in range(10) if image[64, 16 * bit + 8].max() > 128) for _, image in found]
    assert shown == [index for index, _ in found] == [5, 299, 399]


def test_sensor_without_times_is_refused_unless_a_rate_is_given(tmp_path):
    for name in ("a", "b"):
        folder_recording(tmp_path / name)
    write_times(tmp_path / "a" / "timestamps.csv", [0, 0.2, 0.4])
    pose = SE3.from_rotvec([np.pi, 0.0, 0.0], (0.0, 0.0, 2.7))
    save_rigs([RigEntry(name, pose) for name in ("a", "b")], tmp_path / "rigs.toml")
    with pytest.raises(InputError, match="fps="):
        open_rigs(tmp_path)
    assert [part.fps for part in open_rigs(tmp_path, 10.0).parts] == [10.0, 10.0]
