import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_recordings import write_frames
from toy_stereo import toy_rig

from calib.errors import InputError
from calib.rig import save_rig
from stereo.readers import OpenOptions, find_layout, open_recording
from stereo.readers.live import READER, Address, with_gaps
from stereo.recording import Decoded, LiveRecording, newest

COUNT = 9


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *args: object) -> None:
        pass


@pytest.fixture
def served(tmp_path: Path) -> Iterator[str]:
    """Address of a folder with a side-by-side video and both of its halves."""
    rng = np.random.default_rng(0)
    texture = cv2.resize(rng.integers(0, 255, (12, 18), dtype=np.uint8), (72, 48), interpolation=cv2.INTER_LINEAR)
    left, right = texture[:, :64], texture[:, 4:68]
    for name, picture in (("both", np.hstack([left, right])), ("left", left), ("right", right)):
        write_frames(tmp_path / f"{name}.avi", [np.ascontiguousarray(picture)] * COUNT)
    save_rig(toy_rig((64, 48), focal_px=60.0), tmp_path / "rig.toml")
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(tmp_path)))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    thread.join()


def test_stream_with_both_views_gives_pairs_until_it_ends(served: str, tmp_path: Path) -> None:
    recording = open_recording(Path(f"{served}/both.avi"), OpenOptions(tmp_path / "rig.toml"))
    assert isinstance(recording, LiveRecording) and recording.n_frames == 0
    frames = list(recording)
    assert [f.index for f in frames] == list(range(COUNT))
    assert frames[0].left.shape == (48, 64) and recording.skipped == []
    assert frames[5].timestamp_s == pytest.approx(0.5, abs=0.01)


def test_two_streams_are_paired_as_they_come(served: str, tmp_path: Path) -> None:
    both = Path(f"{served}/left.avi,{served}/right.avi")
    recording = open_recording(both, OpenOptions(tmp_path / "rig.toml"))
    assert len(list(recording)) == COUNT
    assert "paired as they come" in recording.notes[0]


def test_live_sample_takes_frames_a_quarter_second_apart(served: str, tmp_path: Path) -> None:
    recording = open_recording(Path(f"{served}/both.avi"), OpenOptions(tmp_path / "rig.toml"))
    assert [f.index for f in recording.sample(3)] == [0, 3, 6]


def test_live_camera_without_calibration_asks_for_one(served: str) -> None:
    _, layout = find_layout(Path(f"{served}/both.avi"))
    with pytest.raises(InputError, match="--calibration FILE"):
        layout.open()


def test_address_that_does_not_answer_is_refused() -> None:
    with pytest.raises(InputError, match=r"http://127\.0\.0\.1:9/x: .*nothing that answers"):
        find_layout(Path("http://127.0.0.1:9/x"))


def test_password_of_an_address_is_not_shown() -> None:
    assert Address("rtsp://me:secret@10.0.0.1/a", True).text == "rtsp://10.0.0.1/a"


def test_live_reader_takes_devices_and_addresses_only(tmp_path: Path) -> None:
    fitting = ("0", "0,1", "rtsp://a/b", "http://a/b,http://a/c")
    assert [READER.fits(Path(text)) for text in fitting] == [True] * 4
    assert not READER.fits(tmp_path / "0") and not READER.fits(Path("ftp://a/b"))


def test_newest_frames_are_kept_and_lost_ones_counted() -> None:
    taken = threading.Event()

    def camera():  # type: ignore[no-untyped-def]
        for index in range(10):
            yield Decoded(index, None, np.zeros((2, 2), np.uint8))
        taken.set()

    frames = with_gaps(newest(camera()))
    first = next(frames)
    taken.wait(5.0)
    rest = [first, *frames]
    assert [frame.index for frame in rest] == list(range(10))
    assert rest[-1].image is not None and rest[-1].index == 9
