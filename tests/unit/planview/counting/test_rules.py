"""rules.toml: what is accepted, where it is placed, and one clear sentence for what is not."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.errors import InputError
from calib.ground_camera import GroundCamera
from planview.counting.geometry import Outline, RulePlane, crossing_edges, inner_radius
from planview.counting.rules import load_rules, parse_rules

CAMERA = GroundCamera(640, 480, 500.0, 3.0, math.radians(60))
SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])


def rules_file(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "rules.toml"
    path.write_text(text)
    return path


WIRE = '[[tripwire]]\nname = "door"\nfrom_m = [0, 0]\nto_m = [2, 0]\n'
ZONE = '[[zone]]\nname = "till"\npolygon_m = [[0, 0], [2, 0], [2, 2]]\n'


def test_rules_keep_metres_as_they_are(tmp_path: Path) -> None:
    rules = load_rules(rules_file(tmp_path, WIRE + ZONE + '[[queue]]\nname = "q"\nzone = "till"\n'))
    assert rules.names == ["door", "till", "q"]
    assert rules.tripwires[0].plane == "floor"
    np.testing.assert_array_equal(rules.tripwires[0].points, [[0, 0], [2, 0]])


def test_closed_polygon_loses_its_repeated_point() -> None:
    zone = {"name": "z", "polygon_m": [[0, 0], [2, 0], [2, 2], [0, 2], [0, 0]]}
    assert len(parse_rules({"zone": [zone]}, RulePlane(), "r").zones[0].points) == 4


def test_pixels_go_to_the_floor_of_a_known_camera() -> None:
    wire = {"name": "w", "from_px": [100, 300], "to_px": [500, 300]}
    placed = parse_rules({"tripwire": [wire]}, RulePlane(CAMERA), "r").tripwires[0]
    assert placed.plane == "floor"
    pixels = CAMERA.project(np.column_stack([placed.points, np.zeros(2)]))
    np.testing.assert_allclose(pixels, [[100, 300], [500, 300]], atol=1e-6)


def test_pixels_stay_pixels_without_a_camera() -> None:
    wire = {"name": "w", "from_px": [0, 200], "to_px": [400, 200]}
    assert parse_rules({"tripwire": [wire]}, RulePlane(image_size=(400, 400)), "r").tripwires[0].plane == "image"


def test_line_in_the_image_goes_on_beyond_the_border_where_it_ends():
    wire = {"name": "w", "from_px": [100, 50], "to_px": [100, 239]}
    placed = parse_rules({"tripwire": [wire]}, RulePlane(image_size=(320, 240)), "r").tripwires[0]
    assert placed.counted.tolist() == [[100, 50], [100, 559]]
    assert placed.points.tolist() == [wire["from_px"], wire["to_px"]]  # as it is drawn and written


def test_zone_around_the_whole_view_is_inside_the_view() -> None:
    zone = {"name": "all", "polygon_m": [[-500, -500], [500, -500], [500, 500], [-500, 500]]}
    assert parse_rules({"zone": [zone]}, RulePlane(GroundCamera(640, 480, 500.0, 3.0, 0.0)), "r").zones


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "at least one [[tripwire]] or [[zone]], found an empty file"),
        ("tripwire = []", "at least one [[tripwire]] or [[zone]], found none"),
        ("[[tripwire]\n", "expected a rules.toml, found"),
        ('[[line]]\nname = "a"\n', "tables named tripwire, zone or queue, found 'line'"),
        ("tripwire = 3\n", "tripwire: input should be a valid list, found 3"),
        ('[[tripwire]]\nname = "a"\nfrom_m = [1, 1]\nto_m = [1, 1]\n', "'a', found a line of zero length"),
        ('[[tripwire]]\nname = "a"\nfrom_m = [1, 1]\n', "from_m and to_m, or from_px and to_px, in tripwire 'a'"),
        ('[[tripwire]]\nname = "a"\n', "found neither"),
        ('[[tripwire]]\nname = "a"\nfrom_m = [1, 1]\nto_px = [1, 2]\n', "found from_m, to_px"),
        ('[[tripwire]]\nname = "a"\nfrom_m = [1, nan]\nto_m = [1, 2]\n', "tripwire 'a'"),
        ('[[tripwire]]\nname = "a"\nfrom_m = ["x", 1]\nto_m = [1, 2]\n', "found 'x'"),
        ('[[tripwire]]\nname = "a"\nfrom_m = [1, 1]\nto_m = [1, 2]\nhysteresis = 1\n', "found hysteresis in"),
        ("[[tripwire]]\nfrom_m = [1, 1]\nto_m = [1, 2]\n", "expected name in tripwire number 1, found none"),
        (WIRE + WIRE, "a name of its own, found 'door' twice"),
        (WIRE + '[[zone]]\nname = "door"\npolygon_m = [[0, 0], [2, 0], [2, 2]]\n', "found 'door' twice"),
        (ZONE + '[[queue]]\nname = "q"\nzone = "kiosk"\n', "queue 'q' to name one of the zones (till), found 'kiosk'"),
        (WIRE + '[[queue]]\nname = "q"\nzone = "kiosk"\n', "(there are none), found 'kiosk'"),
        ('[[zone]]\nname = "z"\npolygon_m = [[0, 0], [1, 0]]\n', "at least 3 points in zone 'z', found 2"),
        ('[[zone]]\nname = "z"\npolygon_m = [[0, 0], [1, 1], [2, 2]]\n', "found points on a line"),
        ('[[zone]]\nname = "z"\npolygon_m = [[0, 0], [2, 2], [2, 0], [0, 2]]\n', "does not cross itself in zone 'z'"),
        ('[[zone]]\nname = "z"\n', "polygon_m or polygon_px in zone 'z', found neither"),
    ],
)
def test_bad_rules_get_one_sentence_that_names_the_file(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(InputError) as caught:
        load_rules(rules_file(tmp_path, text))
    assert sentence in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "rules.toml"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("rule", "sentence"),
    [
        ({"from_px": [700, 10], "to_px": [900, 10]}, "inside the view of 640x480 pixels"),
        ({"from_px": [100, 5], "to_px": [200, 5]}, "above the horizon"),
        ({"from_m": [-1, -5], "to_m": [1, -5]}, "inside the view"),
        ({"from_m": [50, 5], "to_m": [50, 6]}, "inside the view"),
    ],
)
def test_line_outside_the_view_is_refused(rule: dict[str, list[float]], sentence: str) -> None:
    camera = GroundCamera(640, 480, 500.0, 3.0, math.radians(80))
    with pytest.raises(InputError, match=sentence):
        parse_rules({"tripwire": [{"name": "w", **rule}]}, RulePlane(camera), "r")


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.toml"):
        load_rules(tmp_path / "nothing.toml")


def test_depth_is_the_distance_to_the_outline_with_a_sign() -> None:
    x, y = np.array([[1.0, 0.25], [3.0, 1.0], [-3.0, -4.0]]).T
    assert Outline(SQUARE).depth(x, y) == pytest.approx([0.25, -1.0, -5.0])


def test_inner_radius_of_a_square_is_near_half_its_side() -> None:
    assert inner_radius(SQUARE) == pytest.approx(1.0, abs=0.1)


def test_notch_of_a_polygon_is_outside() -> None:
    notched = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]])
    assert crossing_edges(notched) is None
    outside, inside = Outline(notched).depth(np.array([2.0, 0.5]), np.array([2.0, 1.0]))
    assert outside < 0 < inside


def test_spike_that_runs_back_over_itself_crosses() -> None:
    assert crossing_edges(np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 0.0], [1.0, 2.0]])) is not None


_json = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 5) | st.floats() | st.text(max_size=3),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["name", "from_m", "to_m", "x"]), inner)
    ),
    max_leaves=8,
)


@settings(max_examples=80, deadline=None)
@given(st.dictionaries(st.sampled_from(["tripwire", "zone", "queue", "x"]), _json, max_size=3))
def test_wild_rules_are_accepted_or_refused(data: dict[str, object]) -> None:
    try:
        rules = parse_rules(data, RulePlane(), "r")
    except InputError as error:
        assert str(error).startswith("r")  # noqa: PT017
    else:
        assert rules.names


@pytest.mark.parametrize("name", ["=HYPERLINK(1)", "@door", "-1+1", "+door", "a\tb", "a\x1b[31m"])
def test_name_that_a_spreadsheet_or_terminal_would_act_on_is_refused(name: str) -> None:
    rule = {"name": name, "from_m": [0, 0], "to_m": [1, 0]}
    with pytest.raises(InputError, match="begins with none of"):
        parse_rules({"tripwire": [rule]}, RulePlane(), "rules.toml")
