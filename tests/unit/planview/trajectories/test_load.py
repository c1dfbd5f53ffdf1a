"""Trajectories in the layouts of public benchmarks."""

from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError
from planview.trajectories.formats import load_tracks, load_truth
from planview.trajectories.table import IGNORED


def test_pets_rows_count_frames_from_zero_and_carry_boxes_and_metres(tmp_path: Path) -> None:
    path = tmp_path / "gt.txt"
    path.write_text("2,5,10,20,30,40,1,1.5,-2.5,0\n1,5,11,20,30,40,1,1.4,-2.5,0\n")
    truth = load_truth(path)
    assert truth.frame.tolist() == [0, 1]
    assert truth.box_px[1].tolist() == [10, 20, 30, 40]
    assert (truth.x_m[1], truth.y_m[1]) == (1.5, -2.5)


def test_rows_without_metres_have_unknown_positions(tmp_path: Path) -> None:
    path = tmp_path / "gt.txt"
    path.write_text("1,5,11,20,30,40,1\n")
    assert np.isnan(load_truth(path).x_m).all()


MOT16_TRUTH = """1,1,10,20,30,40,1,1,0.9
1,2,50,20,30,40,0,1,1
1,3,90,20,30,40,1,3,1
1,4,130,20,30,40,0,8,0.7
2,1,11,20,30,40,1,1,0.25
"""
"""A pedestrian, a pedestrian not to be considered, a car, a distractor; then the pedestrian, partly hidden."""


def test_motchallenge_truth_has_visibility_instead_of_metres(tmp_path: Path) -> None:
    path = tmp_path / "gt.txt"
    path.write_text(MOT16_TRUTH)
    truth = load_truth(path)
    assert (truth.frame.tolist(), truth.track_id.tolist()) == ([0, 0, 1], [1, 4, 1])
    assert truth.visible.tolist() == [0.9, IGNORED, 0.25]
    assert np.isnan(truth.x_m).all()


def test_truth_with_confidence_zero_is_left_out_and_results_with_it_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "gt.txt"
    path.write_text("1,1,10,20,30,40,1,2.5,3.5,0\n1,2,50,20,30,40,0,4.5,5.5,0\n")
    assert load_truth(path).track_id.tolist() == [1]
    assert load_tracks(path).track_id.tolist() == [1, 2]


def test_world_columns_of_minus_one_are_unknown_positions(tmp_path: Path) -> None:
    path = tmp_path / "gt.txt"
    path.write_text("1,1,10,20,30,40,1,-1,-1,-1\n1,2,50,20,30,40,1,-1,-1,0\n")
    assert np.isnan(load_truth(path).x_m).tolist() == [True, False]


@pytest.mark.parametrize("columns", ["1,2,0.5,0", "1,2.5,0.5", "0.5,2,0.5", "1,2,-0.5", "1,14,0.5"])
def test_rows_that_are_not_flag_class_visibility_are_metres(tmp_path: Path, columns: str) -> None:
    path = tmp_path / "gt.txt"
    path.write_text(f"1,1,10,20,30,40,{columns}\n")
    truth = load_truth(path)
    assert [truth.x_m[0], truth.y_m[0]] == [float(value) for value in columns.split(",")[1:3]]


def test_laboratory_rows_become_metres_and_seconds(tmp_path: Path) -> None:
    path = tmp_path / "lab.txt"
    path.write_text("3 32 100 -50 175\n")
    tracks = load_tracks(path)
    assert (tracks.track_id[0], tracks.frame[0], tracks.timestamp_s[0]) == (3, 32, 2.0)
    assert (tracks.x_m[0], tracks.y_m[0], tracks.height_m[0]) == (1.0, -0.5, 1.75)


def test_own_layout_is_told_by_its_header(tmp_path: Path) -> None:
    path = tmp_path / "truth.csv"
    path.write_text("frame,id,x_m,y_m,height_m\n0,1,2,3,1.8\n")
    assert load_truth(path).height_m[0] == 1.8


@pytest.mark.parametrize(
    "text",
    [
        "",
        "1,2,3\n",
        "1,2,x,4,5,6\n",
        "1,1,nan,2,3,4,1\n",
        "1 2 3\n",
        "1 2 3 4 5\n6 7\n",
        "hello\n",
        "frame,id\n0,1\n",
        "1,1,0,0,2,2\n1,1,3,3,2,2\n",
        "1.5,1,0,0,2,2\n",
    ],
)
def test_anything_else_is_refused_with_the_name_of_the_file(tmp_path: Path, text: str) -> None:
    path = tmp_path / "odd.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=r"odd\.txt: expected"):
        load_truth(path)


def test_binary_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "odd.txt"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match="expected"):
        load_truth(path)
