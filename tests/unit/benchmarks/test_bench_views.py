"""Scores of drawn views."""

from pathlib import Path

import pytest

from benchmarks.views import ViewScore, drawn_view, full_truth, rules_of, view_names
from calib.errors import InputError
from planview.counting.geometry import RulePlane
from planview.counting.rules import parse_rules
from planview.counting.scoring import crossing_scores
from planview.synthetic.camera import ground_camera


def score(true, found):
    return ViewScore("mall", 0, "ellipse-particle", crossing_scores(true, found, 2.0), 0, 0, 0.0, 1.0)


def test_view_that_nobody_crosses_is_right_when_nobody_is_counted():
    assert score([], []).strict == 1.0


def test_unknown_view_is_refused_by_name():
    with pytest.raises(InputError, match="found 'moon'"):
        view_names(["moon"])


def test_every_view_is_found_and_drawn():
    assert "bus_door" in view_names()
    assert drawn_view("bus_door", 3).scene.people


def test_zone_of_a_nearly_horizontal_view_is_floor():
    view = drawn_view("lobby", 1)
    camera = ground_camera(view.scene.camera)
    (zone,) = parse_rules(rules_of(view, camera.size), RulePlane(camera), "line").zones
    assert zone.plane == "floor"


def test_truth_has_the_boxes_of_whole_silhouettes(tmp_path: Path):
    header = "frame,id,x_m,y_m,height_m,visible,left_px,top_px,width_px,height_px,full_left_px,full_top_px"
    path = tmp_path / "truth.csv"
    path.write_text(f"{header},full_width_px,full_height_px\n0,1,0,0,1.7,0.5,10,10,5,5,8,6,9,20\n")
    assert full_truth(path).box_px.tolist() == [[8, 6, 9, 20]]
