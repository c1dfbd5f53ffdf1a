"""What is no recording is named as what it is, with what to do; what nearly is one is read."""

from pathlib import Path

import numpy as np
import pytest
from toy_recordings import textured, write_images
from toy_stereo import toy_rig

from calib.errors import InputError
from calib.formats import load_rig
from calib.formats.devices import _socket
from calib.rig import save_rig
from planview.output.viewer import refuse_broken
from stereo.readers import OpenOptions, find_layout, open_recording

DEEP = np.full((24, 32), 2000, np.uint16)


@pytest.mark.parametrize(
    ("names", "found"),
    [
        ("rgb/0.png depth/0.png depth2/0.png", "folders of images, depth, depth2 and rgb: give the two of a pair"),
        ("a/0.png b/0.png depth/0.png", "folders of images, a, b and depth: give the two of a pair as two paths"),
        ("walk/left/0.png walk/right/0.png", "a folder of recordings: give one of them"),
        ("photo.png", "a single image, in which nobody walks: give the folder of a camera's images (photo.png)"),
        ("camA.avi camB.avi", "videos, camA.avi and camB.avi: give the two of a pair as two paths, left first"),
        ("a.avi b.avi c.avi d.avi", "videos, a.avi, b.avi, c.avi and 1 more: give"),
        ("walk_rgb.avi walk_depth.avi", "walk_rgb.avi: depth in a video is not read"),
        ("left.avi right_depth.avi", "right_depth.avi: depth in a video is not read"),
        ("rgb/0.png depth.mkv", "depth.mkv: depth in a video is not read"),
        ("x.png y.png", "images, x.png and y.png: give the two of a pair"),
        ("a.bag b.bag", "bags, a.bag and b.bag: give one of them"),
        ("a.heic", "a file of the kind .heic: convert it to PNG or JPEG"),
        ("left/a.npy", "write its arrays as images"),
        ("a.yuv", "ffmpeg -f rawvideo"),
        ("right/0.png left/a.heic", "left: expected images of one camera, found no images, videos or bags but a.heic"),
        ("right/0.png left/images/0.png", "found folders of images, images"),
        ("left/a.mp4 left/b.mp4 right/a.mp4", "left: expected images of one camera, found videos, a.mp4 and b.mp4"),
        ("notes.txt", "no images, videos or bags but notes.txt, a file of another kind"),
        ("a.svo2", "ZED SDK"),
    ],
)
def test_folder_that_nearly_fits_is_told_what_to_do(tmp_path, names, found):
    for name in map(Path, names.split()):
        write_images(tmp_path, f"{name.with_suffix('.png')}")
        (tmp_path / name.with_suffix(".png")).rename(tmp_path / name)
    with pytest.raises(InputError) as error:
        find_layout(tmp_path)
    assert found in str(error.value)
    assert len(str(error.value)) < 300 + len(str(tmp_path))


def test_depth_given_as_a_video_of_its_own_is_named(tmp_path):
    (tmp_path / "rgb.avi").touch()
    (tmp_path / "depth.avi").touch()
    with pytest.raises(InputError, match=r"depth\.avi"):
        find_layout(tmp_path / "rgb.avi", OpenOptions(right=tmp_path / "depth.avi"))


def test_two_single_images_are_no_recording(tmp_path):
    write_images(tmp_path, "a.png", "b.png")
    with pytest.raises(InputError, match="a single image"):
        find_layout(tmp_path / "a.png", OpenOptions(right=tmp_path / "b.png"))


def test_registered_depth_is_taken_before_raw_depth(tmp_path):
    write_images(tmp_path, "rgb/0.png", "rgb/1.png")
    write_images(tmp_path, "depth/0.png", "depth/1.png", "depth_registered/0.png", image=DEEP)
    _, layout = find_layout(tmp_path)
    assert layout.kind == "rgbd"
    assert [stream.n_frames for stream in layout.streams] == [2, 1]


def test_depth_named_as_its_image_in_one_folder_is_a_recording(tmp_path):
    write_images(tmp_path, "0.jpg", "1.jpg")
    write_images(tmp_path, "0.png", "1.png", image=DEEP)
    assert find_layout(tmp_path)[1].kind == "rgbd"


def test_photographs_with_both_views_are_a_recording(tmp_path):
    write_images(tmp_path, "0.png", "1.png", "2.png", image=np.hstack([textured(0), textured(12)]))
    save_rig(toy_rig((320, 240)), tmp_path / "rig.toml")
    frames = list(open_recording(tmp_path))
    assert len(frames) == 3
    assert frames[0].image.shape == (240, 320)


def test_sockets_are_named_in_every_way():
    assert [_socket(name) for name in (1, "CAM_B", "cam_c", "LEFT", "CameraBoardSocket.CAM_A")] == [1, 1, 2, 1, 0]


@pytest.mark.parametrize(
    "names", ["mtxL distL mtxR distR R T", "K_left D_left K_right D_right rot trans", "M1 D1 M2 D2 R T"]
)
def test_arrays_of_numpy_are_a_calibration_by_any_usual_names(tmp_path, names):
    camera = [np.array([[30.0, 0, 15.5], [0, 30.0, 11.5], [0, 0, 1]]), np.zeros((1, 5))]
    values = [*camera, *camera, np.eye(3), np.array([[-0.12], [0], [0]])]
    np.savez(tmp_path / "calib.npz", **dict(zip(names.split(), values, strict=True)), maps=np.zeros((48, 64)))
    rig = load_rig(tmp_path, (32, 24))
    assert rig.baseline_m == pytest.approx(0.12)
    assert rig.left.fx == 30.0


def test_arrays_of_numpy_that_are_no_calibration_name_what_they_lack(tmp_path):
    np.savez(tmp_path / "calib.npz", Q=np.eye(4), P1=np.zeros((3, 4)))
    with pytest.raises(InputError, match="lacks P2"):
        load_rig(tmp_path / "calib.npz")


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "an empty file"),
        (b"hello hello", "a file of another kind"),
        (b"RRF2\0\x12\0\0 more", "one of rerun 0.18, which rerun .* does not read"),
        (b"RRF2\0\x63\0\0 more", "one of rerun 0.99, which rerun .* does not read"),
        (b"RRF0\0\x12\0\0 more", "one of rerun 0.18"),
        (None, "one that was cut off: rerun rrd merge"),
    ],
)
def test_recording_that_the_viewer_cannot_show_is_refused(tmp_path, content, found):
    import rerun

    own = tuple(map(int, rerun.__version__.split(".")[:2]))
    (tmp_path / "run.rrd").write_bytes(b"RRF2" + bytes([*own, 0, 0]) + bytes(99) if content is None else content)
    with pytest.raises(InputError, match=found):
        refuse_broken(tmp_path / "run.rrd")
