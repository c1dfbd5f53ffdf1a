import io
from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError
from planview.trajectories.state import TrackState
from planview.trajectories.table import (
    Trajectories,
    TrajectoryCollector,
    read_tracks,
    read_truth,
    write_header,
    write_rows,
)


def test_tracks_survive_a_round_trip_with_unknown_values_empty(tmp_path: Path) -> None:
    file = io.StringIO()
    write_header(file)
    write_rows(file, 3, 0.2, [TrackState(7, "confirmed", 1.0, 2.0, height_m=1.75)])
    path = tmp_path / "tracks.csv"
    path.write_text(file.getvalue())
    tracks = read_tracks(path)
    assert (tracks.frame[0], tracks.track_id[0], tracks.state[0]) == (3, 7, "confirmed")
    assert (tracks.x_m[0], tracks.y_m[0], tracks.height_m[0]) == (1.0, 2.0, 1.75)
    assert np.isnan(tracks.box_px).all()


def test_collected_tracks_are_those_of_a_round_trip_through_the_file(tmp_path: Path) -> None:
    first = TrackState(9, "lost", 1 / 3, -0.00001, 0.25, 2 / 3, 1.71234, (10.05, -0.5, 20.25, 31.96))
    second = TrackState(7, "tentative", 1.00005, 2.0)
    path, collector = tmp_path / "tracks.csv", TrajectoryCollector()
    with path.open("w") as file:
        write_header(file)
        for frame, tracks in ((3, [first, second]), (4, [second]), (5, [])):
            write_rows(file, frame, frame / 7, tracks)
            collector.add(frame, frame / 7, tracks)
    read, collected = read_tracks(path), collector.trajectories()
    for name in Trajectories.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(collected, name), getattr(read, name), strict=name != "state")


def test_nothing_collected_is_an_empty_table() -> None:
    empty = TrajectoryCollector().trajectories()
    assert len(empty) == 0
    assert (empty.box_px.shape, empty.velocity_mps.shape, empty.x_m.shape) == ((0, 4), (0, 2), (0,))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frame,id\n", "column 'x_m'"),
        ("frame,id,x_m,y_m,height_m\n1,1,a,0,0\n", "number in 'x_m', line 2, found 'a'"),
        ("frame,id,x_m,y_m,height_m\n1.5,1,0,0,0\n", "whole number in 'frame'"),
        ("frame,id,x_m,y_m,height_m\n1,1,0,0,0\n1,1,0,0,0\n", "two for frame 1, id 1"),
        ("frame,id,x_m,y_m,height_m\n1,1\n", "found fewer"),
    ],
)
def test_bad_truth_is_refused_in_one_sentence(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "truth.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_truth(path)
