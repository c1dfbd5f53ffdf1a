"""Frames with the wrong number of people, on a few rows that can be counted by hand."""

import pytest

from benchmarks.frame_counts import FrameCounts, count_frames
from planview.trajectories.table import read_tracks, read_truth

TRUTH = "frame,timestamp_s,id,x_m,y_m,height_m,visible\n0,0,1,,,,1\n1,0.1,1,,,,1\n1,0.1,2,,,,0.1\n2,0.2,1,,,,1\n"
TRACKS = "frame,timestamp_s,id,x_m,y_m,state\n0,0,7,,,tentative\n1,0.1,7,,,confirmed\n2,0.2,7,,,confirmed\n"


def files(tmp_path, tracks=TRACKS):
    (tmp_path / "truth.csv").write_text(TRUTH)
    (tmp_path / "tracks.csv").write_text(tracks)
    return read_tracks(tmp_path / "tracks.csv"), read_truth(tmp_path / "truth.csv")


def test_frames_with_too_few_confirmed_tracks_are_wrong(tmp_path):
    assert count_frames("a", *files(tmp_path), 4) == FrameCounts("a", 4, 1, 1)


def test_frames_with_too_many_tracks_are_wrong_but_not_too_few(tmp_path):
    counts = count_frames("a", *files(tmp_path, TRACKS + "2,0.2,8,,,confirmed\n"), 4)
    assert (counts.wrong, counts.too_few) == (2, 1)
    assert counts.error == pytest.approx(0.5)


def test_frames_after_the_end_are_not_counted(tmp_path):
    assert count_frames("a", *files(tmp_path), 1) == FrameCounts("a", 1, 1, 1)


def test_no_frames_have_no_error():
    assert FrameCounts("a", 0, 0, 0).error == 0.0
