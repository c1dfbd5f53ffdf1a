"""Real recordings in which nothing is wrong: no hypothesis explains them better than they are."""

import pytest

from stereo.doctor.diagnose import diagnose, place_of_depth
from stereo.readers import OpenOptions, open_any
from stereo.recording import StereoPair

PAIRS = (
    "overhead-stereo",
    "recordings/euroc-asl",
    "recordings/kitti-raw-made",
    "recordings/ros1-bag/stereo.bag",
    "recordings/ros2-mcap/stereo",
    "recordings/ros2-sqlite3/stereo",
)
DEPTH = (
    "rgbd-one-walker",
    "rgbd-six-people",
    "rgbd-overhead",
    "recordings/tum-rgbd-people",
    "recordings/ros1-bag/rgbd_compressed.bag",
)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*PAIRS, *DEPTH])
def test_the_doctor_is_silent_on_a_healthy_recording(shared_data, name):
    path = shared_data / name
    if not path.exists():
        pytest.skip(f"{path} is not here")
    recording = open_any(path, OpenOptions(fps=5.0))
    frames = recording.sample(8)
    if isinstance(recording.sensor, StereoPair):
        findings = [diagnose(recording)]
    else:
        findings = [place_of_depth(frames).finding, diagnose(recording)]
    assert [str(finding) for finding in findings if finding] == []
