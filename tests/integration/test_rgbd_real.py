"""Real images with depth, with no configuration at all: a walker among seated people (see the data's README)."""

import csv
from pathlib import Path

import numpy as np
import pytest

from calib.types import F64
from planview.cli import main
from planview.trajectories.table import Trajectories, read_tracks
from stereo.readers import find_layout, open_any
from stereo.recording import RgbdRecording

STANDS_FROM = 30
"""From this frame on the walker leaves the picture at its lower edge, and a second person stands there."""


@pytest.fixture(scope="module")
def walked(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("rgbd") / "out"
    _run(shared_data / "rgbd-one-walker", "--out", out, "--maps")
    return out


def _run(*words: object) -> None:
    with pytest.raises(SystemExit) as left:
        main(["run", *(str(word) for word in words)])
    assert not left.value.code


def _path(shared_data: Path) -> dict[int, F64]:
    """(x, y) of the walker by frame [m], measured from depth blobs."""
    with (shared_data / "rgbd-one-walker" / "walker_path_from_depth.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if int(row["frame"]) < STANDS_FROM]
    return {int(row["frame"]): np.array([float(row["x_m"]), float(row["z_m"])]) for row in rows}


def _confirmed(folder: Path) -> Trajectories:
    tracks = read_tracks(folder / "tracks.csv")
    return tracks.where(np.asarray(tracks.state == "confirmed"))


def test_walker_is_tracked_along_the_path_of_the_depth_blobs(walked: Path, shared_data: Path) -> None:
    tracks, path = _confirmed(walked), _path(shared_data)
    assert len(np.unique(tracks.track_id)) == 1
    off = [
        float(np.hypot(tracks.x_m[i] - path[int(f)][0], tracks.y_m[i] - path[int(f)][1]))
        for i, f in enumerate(tracks.frame)
        if int(f) in path
    ]
    assert len(off) >= 20  # of 23 that the path has; a track is confirmed from its third frame on
    assert np.median(off) < 0.15 and np.percentile(off, 95) < 0.15
    assert np.nanmedian(tracks.height_m) == pytest.approx(1.765, abs=0.05)


def test_saved_maps_of_depth_give_the_same_tracks(walked: Path, tmp_path: Path) -> None:
    _run(walked / "maps.h5", "--out", tmp_path / "again")
    assert (tmp_path / "again" / "tracks.csv").read_bytes() == (walked / "tracks.csv").read_bytes()


def test_tum_sample_pairs_all_but_the_frame_left_out(shared_data: Path) -> None:
    path = shared_data / "recordings" / "tum-rgbd-people"
    reader, layout = find_layout(path)
    recording = open_any(path)
    assert isinstance(recording, RgbdRecording)
    assert (reader.key, layout.kind, recording.n_frames) == ("tum-rgbd", "rgbd", 20)
    assert recording.fps == pytest.approx(5.0)
    first = recording.at([0, 6])
    assert [frame.index for frame in first] == [0]
    assert 3.0 < float(np.nanmedian(first[0].depth_m)) < 4.5  # 5000 values per metre: at 1000 it would be 18 m
