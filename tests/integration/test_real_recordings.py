"""Real recordings: PETS S2-L1 view 1, an overhead pair, and images with depth."""

import csv
from collections import defaultdict
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from calib.ground_camera import GroundCamera
from calib.people.calibration import calibrate_from_people
from calib.people.samples import read_image_size, read_samples
from calib.types import F64
from planview.api.run import run
from planview.cli import main
from planview.engine.open import open_engine
from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
from planview.trajectories.formats import load_truth
from planview.trajectories.table import Trajectories, read_tracks, write_header, write_rows
from stereo.readers import find_layout, open_any
from stereo.recording import DepthCamera


@pytest.fixture
def truth(shared_data) -> Trajectories:
    path = shared_data / "pets09-s2l1-view001" / "gt.txt"
    if not path.is_file():
        pytest.skip(f"{path} is not here")
    return load_truth(path)


def test_annotation_scores_full_marks_against_itself(truth):
    assert (len(truth), int(truth.frame[0]), int(truth.frame[-1])) == (2396, 0, 399)
    result = evaluate_tracks(truth, truth, EvaluationParams(match_on="boxes", fps=7.0)).to_json()
    assert (result["truth_rows"], result["mota"], result["idf1"]) == (2396, 1.0, 1.0)
    assert result["significant_errors"]["total"] == 0


def test_world_that_was_moved_is_aligned_on_the_floor(truth):
    rng = np.random.default_rng(0)
    turned = replace(
        truth,
        x_m=20.0 - truth.y_m + rng.normal(0, 0.2, len(truth)),
        y_m=-5.0 + truth.x_m + rng.normal(0, 0.2, len(truth)),
        box_px=np.full_like(truth.box_px, np.nan),
    )
    result = evaluate_tracks(turned, truth, EvaluationParams(gate_m=1.0, align=True, fps=7.0)).to_json()
    assert result["mota"] > 0.99
    assert result["position_error_mean_m"] == pytest.approx(0.25, abs=0.02)
    assert result["alignment"]["rotation_deg"] == pytest.approx(-90.0, abs=1.0)


FRAMES = 200


@pytest.mark.slow
def test_pets_view_1_is_tracked_without_calibration(shared_data, tmp_path):
    folder = shared_data / "pets09-s2l1-view001"
    path = tmp_path / "tracks.csv"
    with path.open("w", encoding="utf-8") as file:
        write_header(file)
        for result in islice(open_engine(folder / "view001.mp4", "ellipse-particle"), FRAMES):
            write_rows(file, result.frame, result.timestamp_s, result.tracks)
    truth = load_truth(folder / "gt.txt")
    truth = truth.where(truth.frame < FRAMES)
    tracks = read_tracks(path)
    scores = evaluate_tracks(tracks, truth, EvaluationParams(match_on="boxes"))
    assert scores.mota >= 0.68
    assert scores.idf1 >= 0.70
    assert scores.clear.switches + len(scores.significant) <= 22, (scores.clear.switches, len(scores.significant))


PEOPLE = Path(__file__).resolve().parents[1] / "data" / "pets_people.json"


@pytest.fixture
def camera() -> GroundCamera:
    return calibrate_from_people(read_samples(PEOPLE), read_image_size(PEOPLE), "pinhole").camera


@pytest.mark.slow
def test_pets_boxes_reach_what_is_asked(shared_data, camera):
    folder = shared_data / "pets09-s2l1-view001"
    truth = load_truth(folder / "gt.txt")
    scores = []
    for n in range(3):  # cameras that are nearly alike: small changes decide who is who in a group
        alike = replace(camera, focal_px=camera.focal_px * (1.0 + 1e-5 * n))
        tracks = run(folder / "view001.mp4", tracker="human-model", calibration=alike)
        scores.append(evaluate_tracks(tracks, truth, EvaluationParams(match_on="boxes", fps=7.0)))
    assert np.mean([score.mota for score in scores]) >= 0.80
    assert np.mean([score.idf1 for score in scores]) >= 0.88


MIDDLE_CROSSED_AT = (67, 242)
"""Frames near which a walker's head crosses the middle of the image (README of the data)."""


@pytest.mark.slow
def test_two_walkers_are_followed_through_the_middle_as_they_went(shared_data):
    engine = open_engine(shared_data / "overhead-stereo")
    geometry = engine.stereo.geometry
    camera = geometry.above(engine.stereo.floor.world_SE3_left)
    rows = defaultdict(list)
    for result in engine:
        for track in (t for t in result.tracks if t.state == "confirmed"):
            u, _ = camera.project((track.x_m, track.y_m, track.height_m))
            rows[track.track_id].append((result.frame, result.timestamp_s, track.height_m, u / geometry.width))
    found = [np.array(rows[i]).T for i in sorted(rows)]
    lasting = [walker for walker in found if walker[1, -1] - walker[1, 0] > 1.0]
    assert len(lasting) == 2
    for (frame, _, height_m, column), crossed_at, way in zip(lasting, MIDDLE_CROSSED_AT, (-1, 1), strict=True):
        assert 1.5 <= np.median(height_m[np.abs(column - 0.5) < 0.3]) <= 1.9
        (crossing,) = np.flatnonzero(np.diff(np.sign(column - 0.5)))
        assert frame[crossing + 1] == pytest.approx(crossed_at, abs=10)
        assert np.sign(column[-1] - 0.5) == np.sign(0.5 - column[0]) == way
        # Followed for as long as they are well inside.
        assert column.min() < 0.3
        assert column.max() > 0.7
        assert np.diff(frame).max() <= 5


STANDS_FROM = 30
"""From this frame on the walker leaves the picture at its lower edge, and a second person stands there."""


@pytest.fixture(scope="module")
def walked(shared_data, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("rgbd") / "out"
    _run(shared_data / "rgbd-one-walker", "--fps", 5, "--out", out, "--maps")
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
    return tracks.where(tracks.state == "confirmed")


def test_walker_is_tracked_along_the_path_of_the_depth_blobs(walked, shared_data):
    tracks, path = _confirmed(walked), _path(shared_data)
    assert len(np.unique(tracks.track_id)) == 1
    off = [
        float(np.hypot(tracks.x_m[i] - path[int(f)][0], tracks.y_m[i] - path[int(f)][1]))
        for i, f in enumerate(tracks.frame)
        if int(f) in path
    ]
    assert len(off) >= 20  # of 23 that the path has; a track is confirmed from its third frame on
    assert np.median(off) < 0.15
    assert np.percentile(off, 95) < 0.15
    assert np.nanmedian(tracks.height_m) == pytest.approx(1.765, abs=0.05)


def test_saved_maps_of_depth_give_the_same_tracks(walked, tmp_path):
    _run(walked / "maps.h5", "--out", tmp_path / "again")
    assert (tmp_path / "again" / "tracks.csv").read_bytes() == (walked / "tracks.csv").read_bytes()


def test_tum_sample_pairs_all_but_the_frame_left_out(shared_data):
    path = shared_data / "recordings" / "tum-rgbd-people"
    reader, layout = find_layout(path)
    recording = open_any(path)
    assert isinstance(recording.sensor, DepthCamera)
    assert (reader.key, layout.kind, recording.n_frames) == ("tum-rgbd", "rgbd", 20)
    assert recording.fps == pytest.approx(5.0)
    first = recording.at([0, 6])
    assert [frame.index for frame in first] == [0]
    assert 3.0 < float(np.nanmedian(first[0].images[1])) < 4.5  # 5000 values per metre: at 1000 it would be 18 m
