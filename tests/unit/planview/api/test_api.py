"""Commands as public functions: one name and one default, in Python and on the command line."""

import inspect
import json

import numpy as np
import pytest
from toy_recordings import write_frames

import planview
from calib.errors import InputError
from planview.api.arguments import frame_span, settings
from planview.cli import CALIBRATE, COMMANDS, make_app

NAMES = [name for group in COMMANDS.values() for name in group if name != "demo"]


@pytest.mark.parametrize("words", [*([name] for name in NAMES), *(["calibrate", name] for name in CALIBRATE)], ids=str)
def test_options_of_a_command_are_arguments_of_the_function_of_its_name(words):
    function = getattr(planview.calibrate, words[1]) if len(words) > 1 else getattr(planview, words[0])
    command = make_app()[words[0]] if len(words) == 1 else make_app()["calibrate"][words[1]]
    options = {argument.field_info.name for argument in command.assemble_argument_collection()}
    arguments = inspect.signature(function).parameters
    assert options - {"json", "all", "print_config", "quiet", "set"} <= arguments.keys()
    assert arguments.keys() - options <= {"camera", "matcher", "watch", "progress"}


def test_parameters_are_tables_or_dotted_names_or_a_file_over_a_base(tmp_path):
    (tmp_path / "c.toml").write_text("[foreground]\nbeta = 4\n")
    expected = settings({"foreground": {"beta": 4}})
    assert expected == settings({"foreground.beta": 4}) == settings(tmp_path / "c.toml")
    assert settings({"seed": 3}, expected) == expected.model_copy(update={"seed": 3})
    with pytest.raises(InputError, match=r"config=: .*did you mean foreground\.beta"):
        settings({"foreground.bta": 4})


@pytest.mark.parametrize(("frames", "span"), [(5, (0, 4)), ("5", (0, 4)), ("2:7", (2, 7)), ((2, 7), (2, 7))])
def test_frames_are_the_first_or_from_one_to_another(frames, span):
    assert frame_span(frames) == span


@pytest.mark.parametrize(
    ("call", "argument"),
    [
        (lambda: planview.export("out", "xlsx"), "to"),
        (lambda: planview.export("out", "pedpy", unit="mm"), "unit"),
        (lambda: planview.plot("out", what="heat"), "what"),
        (lambda: planview.calibrate.board("photos", "2cm", model="pinhole"), "model"),
    ],
)
def test_a_choice_that_there_is_not_is_refused_with_those_there_are(call, argument):
    with pytest.raises(InputError, match=f"^{argument}=: expected one of .*, found '"):
        call()


def test_two_videos_without_calibration_say_how_to_get_one(tmp_path, refused):
    for name in ("left.avi", "right.avi"):
        write_frames(tmp_path / name, [np.zeros((48, 64, 3), np.uint8)] * 4)
    sentence = refused("run", tmp_path / "left.avi", tmp_path / "right.avi", "--out", tmp_path / "out")
    ways = ("--calibration FILE", "planview calibrate board PHOTOS", "planview calibrate human VIDEO")
    assert all(way in sentence for way in ways)


def test_parameters_in_a_pipe_are_a_line_each(shown_by, json_of):
    rows = [line.split("\t") for line in shown_by("params", "maps").splitlines()]
    assert {len(row) for row in rows} == {4}
    assert ["maps.cell_m", "0.04", "m"] in [row[:3] for row in rows]
    assert json_of("params", "maps.cell_m")["maps.cell_m"]["unit"] == "m"
    assert planview.params("maps.cell_m")[0].default == "0.04"


def test_evaluation_prints_no_figure_twice(tmp_path, shown_by):
    rows = "".join(f"{t},{t / 10},1,1.0,{t / 10:.1f},1.7,confirmed\n" for t in range(40))
    (tmp_path / "tracks.csv").write_text("frame,timestamp_s,id,x_m,y_m,height_m,state\n" + rows)
    truth = tmp_path / "truth.csv"
    truth.write_text("frame,id,x_m,y_m,height_m\n" + "".join(f"{t},7,1.0,{t / 10:.1f},1.7\n" for t in range(40)))
    printed = [shown_by("evaluate", tmp_path, truth, *words) for words in ([], ["--all"])]
    assert all(text.count(name) == 1 for text in printed for name in ("MOTA", "IDF1", "positions missed"))
    assert not any("MOTP" in text for text in printed)  # the position error above the table
    assert "group" not in printed[0]
    assert "group" in printed[1]


def test_checks_read_like_their_table(tmp_path):
    (tmp_path / "left").mkdir()
    found = planview.check(tmp_path)
    lines = repr(found).splitlines()
    assert lines[0].startswith("Results of this recording cannot be trusted: 1 of 1 checks failed")
    assert not json.dumps(found.to_json()).count("true")
    assert "\x1b" not in repr(found)
