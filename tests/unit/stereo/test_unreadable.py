"""Why something that is there cannot be read: the reason stands in the sentence, and nothing counts as absent."""

import os
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from toy_recordings import folder_recording, picture, write_images, write_video

from calib.errors import InputError
from stereo.readers import find_layout, open_recording, open_video
from stereo.readers.images import decode_image
from stereo.readers.video import VideoFile, boxes, video_tracks

DEMO = Path(__file__).parents[3] / "data/synthetic/demo/left.mp4"


def closed(monkeypatch: pytest.MonkeyPatch, path: Path) -> None:
    """Take the right to read a file or folder away, for the owner of the machine, too."""
    opened, listed, access = Path.open, Path.iterdir, os.access

    def refuse(own):
        if own == path:
            raise PermissionError(13, "Permission denied", str(own))

    monkeypatch.setattr(Path, "open", lambda own, *args, **named: refuse(own) or opened(own, *args, **named))
    monkeypatch.setattr(Path, "iterdir", lambda own: refuse(own) or listed(own))
    monkeypatch.setattr(os, "access", lambda own, *args: Path(own) != path and access(own, *args))


@pytest.mark.parametrize("name", [".", "right", "right/0000.png", "rig.toml"])
def test_what_may_not_be_read_is_named_with_no_permission(tmp_path, monkeypatch, name):
    folder = folder_recording(tmp_path / "r", 1)
    closed(monkeypatch, folder / name)
    with pytest.raises(InputError, match="no permission"):
        open_recording(folder)


def test_image_that_may_not_be_read_is_a_skipped_frame_with_its_reason(tmp_path, monkeypatch):
    folder = folder_recording(tmp_path / "r", 3)
    closed(monkeypatch, folder / "left" / "0001.png")
    recording = open_recording(folder)
    assert len(list(recording)) == 2
    assert [s.why for s in recording.skipped] == ["left: left/0001.png cannot be decoded: no permission"]


def test_bag_that_may_not_be_read_is_no_missing_bag(tmp_path, monkeypatch):
    (tmp_path / "walk.bag").write_bytes(b"#ROSBAG V2.0\n")
    closed(monkeypatch, tmp_path / "walk.bag")
    with pytest.raises(InputError, match=r"walk.bag: .*no permission"):
        find_layout(tmp_path)


def pages(kind: str, second: tuple[int, int] = (32, 24)) -> bytes:
    """A file of three pictures, of which the first is 32 pixels wide and 24 high."""
    made = [
        Image.fromarray(np.full((size[1], size[0], 3), 80 * i, np.uint8))
        for i, size in enumerate([(32, 24), second, second])
    ]
    out = BytesIO()
    made[0].save(out, kind, save_all=True, append_images=made[1:])
    return out.getvalue()


@pytest.mark.parametrize("kind", ["TIFF", "MPO"])
def test_image_with_smaller_previews_is_one_image(kind):
    assert decode_image(pages(kind, (16, 12))).shape == (24, 32, 3)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "an empty file"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 7\n", "git lfs pull"),
        (b"<!DOCTYPE html><html>", "a web page"),
        (b"\0\0\0\x18ftypheic" + bytes(20), "HEIF or AVIF"),
        (cv2.imencode(".tiff", np.ones((24, 32), np.float32))[1].tobytes(), "float32 values"),
        (pages("TIFF"), "3 pages in one TIFF: write each"),
        (pages("GIF"), "3 pages in one GIF"),
        (pages("PNG"), "3 pages in one PNG"),
        (pages("WEBP"), "3 pages in one WEBP"),
        (pages("MPO"), "3 pages in one MPO"),
        (None, "a link to a file that is not there"),
    ],
)
def test_images_that_are_none_say_what_they_are(tmp_path, content, why):
    folder = folder_recording(tmp_path / "r", 2)
    for file in (folder / "left").iterdir():
        file.unlink()
        file.symlink_to(tmp_path / "gone") if content is None else file.write_bytes(content)
    with pytest.raises(InputError, match=f"left: .*{why}"):
        open_recording(folder)


def test_depth_of_8_bits_is_named(tmp_path):
    write_images(write_images(tmp_path, "depth/0.png"), "rgb/0.png", image=picture(0, colour=True))
    with pytest.raises(InputError, match="uint8"):
        find_layout(tmp_path)


def box(kind: bytes, content: bytes = b"") -> bytes:
    return (8 + len(content)).to_bytes(4, "big") + kind + content


def test_video_without_its_index_was_cut_off(tmp_path):
    (tmp_path / "a.mp4").write_bytes(box(b"ftyp", b"isom") + box(b"mdat", bytes(100)))
    with pytest.raises(InputError, match="cut off"):
        open_video(tmp_path / "a.mp4")


def test_frames_keep_their_numbers_after_those_before_the_first_key_frame(tmp_path):
    capture = cv2.VideoCapture(str(DEMO))
    capture.set(cv2.CAP_PROP_FORMAT, -1)
    packets = [capture.read()[1].tobytes() for _ in range(256)]
    parameters = packets[0].partition(b"\0\0\0\1\x67")[2][:40]  # behind SEI: SPS and PPS, before the key frame
    start = b"\0\0\0\1\x67" + parameters.partition(b"\0\0\1\x65")[0]
    (tmp_path / "a.h264").write_bytes(start + b"".join(packets[247:]))
    video = VideoFile(tmp_path / "a.h264")
    assert [frame.index for frame in video if frame.image is None] == [0, 1, 2]
    assert video.n_frames == 9
    (third,) = video.at([4])
    (same,) = VideoFile(DEMO).at([251])
    np.testing.assert_array_equal(third.image, same.image)


def test_video_tracks_of_a_container_are_counted(tmp_path):
    track = box(b"trak", box(b"mdia", box(b"hdlr", bytes(8) + b"vide" + bytes(12))))
    (tmp_path / "a.mp4").write_bytes(box(b"ftyp", b"isom") + box(b"mdat", bytes(100)) + box(b"moov", 2 * track))
    assert list(boxes(tmp_path / "a.mp4")) == [b"ftyp", b"mdat", b"moov"]
    assert video_tracks(tmp_path / "a.mp4") == 2
    write_video(tmp_path / "b.avi", 2)
    assert video_tracks(tmp_path / "b.avi") == 1


def test_video_that_opencv_does_not_open_leaves_nothing_on_standard_error_but_the_sentence(tmp_path):
    (tmp_path / "a.mkv").write_bytes(b"\x1aE\xdf\xa3 and no more of it")
    command = [sys.executable, "-m", "planview", "check", "--quick", str(tmp_path / "a.mkv")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("planview: ")
    assert done.stderr.count("\n") == 1
    assert "OpenCV does not open" in done.stderr
    assert "ffmpeg -i" in done.stderr
