"""Rows of boxes: MOTChallenge, PETS, and what detectors found."""

import json
from pathlib import Path

import numpy as np
import pytest
from toy_recordings import table_file

from calib.errors import InputError
from planview.trajectories.detections import Detections, load_detections
from planview.trajectories.formats import load_file, load_tracks, load_truth
from planview.trajectories.table import IGNORED

MOT16_TRUTH = """1,1,10,20,30,40,1,1,0.9
1,2,50,20,30,40,0,1,1
1,3,90,20,30,40,1,3,1
1,4,130,20,30,40,0,8,0.7
2,1,11,20,30,40,1,1,0.25
"""
"""A pedestrian, a pedestrian not to be considered, a car, a distractor; then the pedestrian, partly hidden."""
BOX = "10,20,30,60"


def file_of(tmp_path: Path, *ends: str) -> Path:
    """A row of person k + 1 in frame 1 for every end of a row."""
    return table_file(tmp_path, "".join(f"1,{k + 1},{BOX},{end}\n" for k, end in enumerate(ends)))


def test_pets_rows_hold_boxes_with_metres(tmp_path):
    truth = load_truth(table_file(tmp_path, "2,5,10,20,30,40,1,1.5,-2.5,0\n1,5,11,20,30,40,1,1.4,-2.5,0\n"))
    assert truth.frame.tolist() == [0, 1]
    assert truth.box_px[1].tolist() == [10, 20, 30, 40]
    assert (truth.x_m[1], truth.y_m[1]) == (1.5, -2.5)


def test_pets_rows_without_metres_have_no_place(tmp_path):
    assert np.isnan(load_truth(table_file(tmp_path, "1,5,11,20,30,40,1\n")).x_m).all()


def test_pets_rows_of_minus_one_have_no_place(tmp_path):
    unknown = load_truth(table_file(tmp_path, "1,1,10,20,30,40,1,-1,-1,-1\n1,2,50,20,30,40,1,-1,-1,0\n"))
    assert np.isnan(unknown.x_m).tolist() == [True, False]


def test_motchallenge_truth_has_visibility_instead_of_metres(tmp_path):
    truth = load_truth(table_file(tmp_path, MOT16_TRUTH))
    assert (truth.frame.tolist(), truth.track_id.tolist()) == ([0, 0, 1], [1, 4, 1])
    assert truth.visible.tolist() == [0.9, IGNORED, 0.25]
    assert np.isnan(truth.x_m).all()


UNSURE = "1,1,10,20,30,40,1,2.5,3.5,0\n1,2,50,20,30,40,0,4.5,5.5,0\n"


def test_truth_with_confidence_zero_is_left_out(tmp_path):
    assert load_truth(table_file(tmp_path, UNSURE)).track_id.tolist() == [1]


def test_results_with_confidence_zero_are_kept(tmp_path):
    assert load_tracks(table_file(tmp_path, UNSURE)).track_id.tolist() == [1, 2]


@pytest.mark.parametrize("columns", ["1,2,0.5,0", "1,2.5,0.5", "0.5,2,0.5", "1,2,-0.5"])
def test_rows_that_are_not_flag_class_visibility_are_metres(tmp_path, columns):
    truth = load_truth(table_file(tmp_path, f"1,1,10,20,30,40,{columns}\n"))
    assert [truth.x_m[0], truth.y_m[0]] == [float(value) for value in columns.split(",")[1:3]]


def test_frames_from_0_are_kept_with_a_note(tmp_path):
    path = table_file(tmp_path, "0,7,10,20,30,60\n1,7,11,20,30,60\n")
    file, found = load_file(path), load_detections(path)
    assert file.table.frame.tolist() == [0, 1]
    assert "from 0" in file.note
    assert (found.at(0)[0, 0], found.at(1)[0, 0]) == (10, 11)
    assert "frames count from 0" in found.note


def test_boxes_outside_of_the_image_are_refused():
    boxes = Detections.of([[[1200.0, 800.0, 150.0, 250.0]]])
    assert boxes.within((1920, 1080)) is boxes
    with pytest.raises(InputError, match="400x400"):
        boxes.within((400, 400))


def test_rows_of_a_detector_may_be_shorter_than_others(tmp_path):
    found = load_detections(table_file(tmp_path, "1 7 10 20 30 60\n2,7,10,20,30,60,0.5\n"))
    assert [found.at(frame).tolist() for frame in (0, 1)] == [[[10, 20, 30, 60, 1.0]], [[10, 20, 30, 60, 0.5]]]


@pytest.mark.parametrize(("text", "rows"), [("", 0), ("1,7,10,20,30,60,1,0,1.0\n", 1)], ids=["empty", "with classes"])
def test_results_of_motchallenge_without_metres_have_none(tmp_path, text, rows):
    table = load_tracks(table_file(tmp_path, text))
    assert len(table) == rows
    assert np.isnan(table.x_m).all()


@pytest.mark.parametrize(
    ("ends", "kept"),
    [
        (["0.9,0,-1", "0.8,2,-1"], [1]),  # a detector of COCO's classes, from 0
        (["0.9,1", "0.8,3"], [1]),  # from 1
        (["0.9,1,-1,-1", "0.8,4,-1,-1"], [1]),  # with two more columns
        (["0", "2", "7"], [1]),  # a class alone
        (["2,0.8", "0,0.7"], [2]),  # class and score
        (["1,1,1.0", "1,3,0.5"], [1]),  # rows like truth of MOT16
        (["0.9,-1,-1,-1", "0.5,-1,-1,-1"], [1, 2]),  # no class
        (["90", "80"], [1, 2]),  # percent
    ],
)
def test_results_keep_people_alone(tmp_path, ends, kept):
    path = file_of(tmp_path, *ends)
    file, found = load_file(path), load_detections(path)
    assert file.table.track_id.tolist() == kept
    assert len(found.at(0)) == len(kept)
    assert ("left out" in file.note) == ("left out" in found.note) == (len(kept) < len(ends))


def test_results_without_a_class_of_people_are_refused(tmp_path):
    with pytest.raises(InputError, match="class 2, 7"):
        load_tracks(file_of(tmp_path, "0.9,2,-1", "0.8,7,-1"))


def test_classes_of_truth_are_those_that_labels_name(tmp_path):
    path = file_of(tmp_path, "1,1,1.0", "1,2,1.0")
    (tmp_path / "labels.txt").write_text("car\nPerson\n")
    assert load_truth(path).track_id.tolist() == [2]
    assert "class 2 in column 8 is people; class 1 is left out" in load_file(path, truth=True).note


def test_rows_with_inf_or_nan_are_left_out(tmp_path):
    path = table_file(tmp_path, f"1,1,{BOX},1\n1,2,nan,20,30,60,1\n2,1,10,inf,30,60,1\n")
    assert len(load_tracks(path)) == len(load_detections(path).at(0)) == 1
    assert load_file(path).note == load_detections(path).note == "2 of 3 rows hold inf or NaN and are left out"


def test_commands_that_read_a_file_print_what_was_left_out_of_it(tmp_path, cli):
    path = table_file(tmp_path, f"1,1,{BOX},1,0.5,2\n2,1,{BOX},1,0.6,2\n3,1,nan,20,30,60,1,0.7,2\n")
    rules = tmp_path / "rules.toml"
    rules.write_text('[[tripwire]]\nname = "a"\nfrom_m = [0.55, 0]\nto_m = [0.55, 3]\n')
    note = f"{path}: 1 of 3 rows hold inf or NaN and are left out"
    for words in (
        ("count", path, "--rules", rules), ("export", path, "--to", "csv", "--out", tmp_path / "a.csv"),
        ("evaluate", path, path),
    ):  # fmt: skip
        status, printed = cli(*words, "--fps", 10)
        assert status == 0 and note in " ".join(printed.split()), printed


@pytest.mark.parametrize(
    "text",
    [
        "frame,id,bb_left,bb_top,bb_width,bb_height,conf,x,y,z\n1,7,10.5,20,30,60,0.5,-1,-1,-1\n",
        "track_id;frame;x;y;w;h\n7;1;10,5;20;30;60\n",
        "1;7;10,5;20;30;60;0,5\n",
    ],
)
def test_boxes_are_read_from_tables_of_other_programs(tmp_path, text):
    table = load_tracks(table_file(tmp_path, text))
    assert table.frame.tolist() == [0]
    assert table.track_id.tolist() == [7]
    assert table.box_px.tolist() == [[10.5, 20.0, 30.0, 60.0]]


def test_boxes_without_ids_are_no_tracks(tmp_path):
    with pytest.raises(InputError, match="detections, not tracks"):
        load_tracks(table_file(tmp_path, f"1,-1,{BOX},1\n1,-1,{BOX},1\n"))


def test_boxes_of_minus_one_are_unknown(tmp_path):
    table = load_tracks(table_file(tmp_path, "1,1,-1,-1,-1,-1,1,1.5,2.02,0\n"))
    assert np.isnan(table.box_px).all()
    assert (table.x_m[0], table.y_m[0]) == (1.5, 2.02)


def test_categories_that_count_from_0_have_people_there(tmp_path):
    rows = [{"image_id": 1, "category_id": k, "bbox": [k, 2, 3, 6]} for k in (0, 1)]
    (tmp_path / "a.json").write_text(json.dumps(rows))
    found = load_detections(tmp_path / "a.json")
    assert found.at(0)[:, 0].tolist() == [0.0]
    assert "class 0 in category_id is people; class 1" in found.note


def test_frames_that_a_detector_left_out_show_nothing():
    boxes = [[[10.0, 20.0, 30.0, 60.0]] if k % 3 == 0 else [] for k in range(10)]
    found = Detections.of(boxes)
    assert [found.is_searched(k) for k in range(4)] == [True, False, False, True]
    assert "every 3rd frame" in found.note
    assert Detections.of(boxes[:1] * 4).is_searched(9)


def test_detections_that_end_early_are_doubted():
    found = Detections.of([[[10.0, 20.0, 30.0, 60.0]]] * 100)
    assert "end at frame 100 of 300: are they of every 3rd frame?" in found.of_frames(300).note
    assert found.of_frames(260).note == "boxes end at frame 100 of 260"
    assert found.of_frames(105).note == ""
    with pytest.raises(InputError, match="frame 100"):
        found.of_frames(99)
