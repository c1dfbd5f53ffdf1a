"""The layouts that people have, real ones and made from real images."""

from pathlib import Path

import pytest

from calib.errors import InputError
from stereo.readers import find_layout, open_recording

STEREO = [
    ("euroc-asl", "euroc", (752, 480), 12, 20.0, 458.654, 0.11008),
    ("kitti-raw-made", "kitti", (640, 400), 20, 15.0, 404.4458, 0.07381),
    ("ros1-bag/stereo.bag", "bag", (640, 400), 20, 15.0, 404.1356, 0.07381),
    ("ros2-sqlite3/stereo", "bag", (640, 400), 20, 15.0, 404.1356, 0.07381),
    ("ros2-mcap/stereo/stereo.mcap", "bag", (640, 400), 20, 15.0, 404.1356, 0.07381),
    ("side-by-side/lr_raw.mp4", "side-by-side", (640, 400), 20, 15.0, 404.1356, 0.07381),
    ("side-by-side/rl_swapped_raw.mp4", "side-by-side", (640, 400), 20, 15.0, 404.1356, 0.07381),
]
REFUSED = {
    "negatives/example_noimages.bag": "expected image topics of two cameras, found /rosout",
    "negatives/example_bz2_noimages.bag": "expected image topics of two cameras, found /rosout",
    "negatives/logs_noimages.mcap": "expected image topics of two cameras, found /rosout",
    "negatives/empty.db3": "expected image topics of two cameras",
    "negatives/lfs_pointer.bag": "git lfs pull",
    "negatives/truncated.bag": "rosbag reindex",
    "negatives/truncated.mcap": "mcap recover",
    "negatives/fake.svo": "ZED SDK",
    "mcap-foxglove/custom-camera-model.mcap": "only /image/compressed: one camera",
    "side-by-side/not_stereo_depth_and_rgb.mp4": "depth beside its colour image",
}


@pytest.fixture
def recordings(shared_data: Path) -> Path:
    if not (shared_data / "recordings").is_dir():
        pytest.skip("no recordings in the test data")
    return shared_data / "recordings"


@pytest.mark.parametrize(("name", "reader", "size", "frames", "fps", "focal_px", "baseline_m"), STEREO)
def test_stereo_sample_opens_with_its_size_rate_and_calibration(
    recordings, name, reader, size, frames, fps, focal_px, baseline_m
):
    assert find_layout(recordings / name)[0].key == reader
    recording = open_recording(recordings / name)
    assert recording.rig.left.size == size and recording.n_frames == frames
    assert recording.fps == pytest.approx(fps, rel=1e-4)
    assert recording.rig.left.fx == pytest.approx(focal_px, rel=1e-5)
    assert recording.rig.baseline_m == pytest.approx(baseline_m, rel=1e-3)
    assert len(recording.sample(2)) == 2


def test_depth_topics_open_with_their_rate_and_camera(recordings):
    _, layout = find_layout(recordings / "ros1-bag" / "rgbd_compressed.bag")
    frame = layout.open().sample(1)[0]
    assert layout.kind == "rgbd" and layout.n_frames == 15 and layout.fps == pytest.approx(5.0)
    assert frame.index == 0 and layout.streams[1].pixels == "depth"


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_recording_is_refused_in_one_sentence(recordings, name):
    with pytest.raises(InputError) as error:
        open_recording(recordings / name)
    assert REFUSED[name] in str(error.value) and "\n" not in str(error.value)
