"""Short parts of recordings through the whole engine: who is where, and that each person keeps one id.

Places are the recordings' truth, rounded: tracks may change in their last digits, and better trackers pass.
"""

import math
import shutil
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import pytest

import planview
from calib.ground_camera import save_ground_camera
from calib.people.calibration import calibrate_from_people
from calib.people.samples import read_image_size, read_samples
from calib.world import RigEntry, save_rigs
from planview.trajectories.state import TrackState

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "data" / "synthetic" / "demo"
PEOPLE = ROOT / "tests" / "data" / "pets_people.json"

Walk = dict[int, tuple[float, float]]
"""By frame where a person is: x, y on the floor [m], or the middle of the feet u, v in the image [px]."""

DEMO_WALKS: list[Walk] = [
    {60: (1.79, 7.75), 90: (1.32, 5.48), 105: (0.44, 4.88), 120: (-0.21, 5.15), 135: (-0.23, 5.17)},
    {120: (-2.13, 2.90), 135: (-1.04, 2.75)},
    {120: (1.69, 8.21), 135: (1.70, 6.96)},
]
TWO_RIGS_WALKS: list[Walk] = [{60: (1.79, 7.75), 90: (1.32, 5.48), 105: (0.44, 4.88)}]
OVERHEAD_WALKS: list[Walk] = [
    {55: (0.53, 0.12), 60: (0.33, 0.07), 65: (0.15, 0.04), 70: (-0.05, 0.00), 75: (-0.29, -0.02)}
]
RGBD_WALKS: list[Walk] = [{6: (-0.33, 2.10), 10: (-0.76, 3.27), 24: (-0.56, 3.27), 28: (-0.16, 1.85)}]
ELLIPSE_WALKS: list[Walk] = [
    {14: (223, 178), 20: (236, 172), 30: (248, 167)},
    {8: (364, 202), 14: (325, 201), 20: (288, 198), 30: (269, 184)},
    {20: (445, 241), 30: (406, 225)},
]
MODEL_WALKS: list[Walk] = [
    {8: (308, 150), 14: (288, 155)},
    {8: (202, 184), 14: (223, 178)},
    {8: (364, 202), 14: (325, 201)},
]


def confirmed(engine: planview.Engine, frames: int) -> list[tuple[TrackState, ...]]:
    """Confirmed people of every frame, from the first on."""
    results = list(islice(engine, frames))
    assert [result.frame for result in results] == list(range(frames))
    return [tuple(track for track in result.tracks if track.state == "confirmed") for result in results]


def assert_walked(
    tracks: Sequence[tuple[TrackState, ...]], walks: Sequence[Walk], within: float, in_image: bool = False
) -> None:
    """Every person is where they were, under one id of their own."""
    ids = []
    for walk in walks:
        found = [_nearest(tracks[frame], place, in_image) for frame, place in walk.items()]
        assert all(distance <= within for _, distance in found), found
        assert len({track_id for track_id, _ in found}) == 1, found
        ids.append(found[0][0])
    assert len(set(ids)) == len(walks)


def _nearest(tracks: Sequence[TrackState], place: tuple[float, float], in_image: bool) -> tuple[int, float]:
    """The id nearest to a place, and how far off it is."""
    assert tracks, f"expected somebody at {place}"
    found = []
    for track in tracks:
        left, top, width, height = track.box_px
        at = (left + width / 2, top + height) if in_image else (track.x_m, track.y_m)
        found.append((math.dist(at, place), track.track_id))
    distance, track_id = min(found)
    return track_id, distance


def test_demo():
    tracks = confirmed(planview.open_engine(DEMO), 136)
    assert_walked(tracks, DEMO_WALKS, within=0.15)
    assert len({track.track_id for people in tracks for track in people}) == 3
    # In view from frames 45, 102 and 111 on: 91 + 34 + 25 rows, less those before they are confirmed.
    assert 115 <= sum(len(people) for people in tracks) <= 150


@pytest.mark.slow
def test_two_rigs_that_see_the_same(tmp_path):
    floor = planview.set_up(planview.open_recording(DEMO), planview.Config()).floor
    entries = []
    for name in ("one", "other"):
        shutil.copytree(DEMO, tmp_path / name)
        entries.append(RigEntry(name, floor.world_SE3_left))
    save_rigs(entries, tmp_path / "rigs.toml")
    tracks = confirmed(planview.open_engine(tmp_path), 106)
    assert_walked(tracks, TWO_RIGS_WALKS, within=0.15)
    assert len({track.track_id for people in tracks for track in people}) == 1


@pytest.mark.slow
def test_overhead_pair(shared_data):
    tracks = confirmed(planview.open_engine(shared_data / "overhead-stereo"), 80)
    assert_walked(tracks, OVERHEAD_WALKS, within=0.15)
    assert all(len(people) <= 2 for people in tracks)


def test_images_with_depth(shared_data):
    tracks = confirmed(planview.open_engine(shared_data / "rgbd-one-walker", options=planview.OpenOptions(fps=5.0)), 30)
    assert_walked(tracks, RGBD_WALKS, within=0.15)
    assert len({track.track_id for people in tracks for track in people}) == 1


def test_street_by_ellipses(shared_data):
    video = shared_data / "pets09-s2l1-view001" / "view001.mp4"
    tracks = confirmed(planview.open_engine(video, "ellipse-particle"), 32)
    assert_walked(tracks, ELLIPSE_WALKS, within=15, in_image=True)


def test_street_by_the_human_model(shared_data, tmp_path):
    size = read_image_size(PEOPLE)
    save_ground_camera(calibrate_from_people(read_samples(PEOPLE), size, "pinhole").camera, tmp_path / "camera.toml")
    video = shared_data / "pets09-s2l1-view001" / "view001.mp4"
    tracks = confirmed(planview.open_engine(video, "human-model", camera=tmp_path / "camera.toml"), 15)
    assert_walked(tracks, MODEL_WALKS, within=15, in_image=True)
