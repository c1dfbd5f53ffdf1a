"""The commands: what they do, print and refuse."""

import ast
import csv
import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_recordings import write_frames
from toy_rgbd import write_toy_rgbd
from toy_stereo import toy_rig

from calib.errors import InputError, WorkError
from calib.formats import load_rig, write_rig
from calib.formats.one_camera import NoCameraError
from calib.ground_camera import GroundCamera, load_ground_camera, save_ground_camera
from calib.rig import save_rig
from calib.world import load_world
from planview.api.run import is_of_one_camera
from planview.api.sweep import sweep
from planview.api.view import view
from planview.calibration.board import parse_board, parse_square
from planview.calibration.floor import parse_points
from planview.commands.check import check
from planview.commands.options import typed
from planview.counting.events import read_events
from planview.engine.config import load_config
from planview.studies.study import parse_variations
from planview.trajectories.table import read_tracks, read_truth
from stereo.readers import open_recording, open_video


def test_a_camera_above_the_floor_is_detected_by_its_keys(tmp_path):
    for name in ("camera.toml", "street.toml"):
        save_ground_camera(GroundCamera(320, 240, 200.0, 3.0, 0.8), tmp_path / name)
        assert is_of_one_camera(tmp_path / name, "ellipse-particle")


def test_a_rig_is_of_one_camera_to_trackers_of_one_alone(tmp_path):
    write_rig(toy_rig(), tmp_path / "rig.toml", "rig")
    assert not is_of_one_camera(tmp_path / "rig.toml", "joint")
    assert not is_of_one_camera(tmp_path, "joint")
    assert is_of_one_camera(tmp_path / "rig.toml", "human-model")


SCENE = """
fps = 10
duration_s = 0.4
[rig]
width = 96
height = 72
focal_px = 70
at_m = [3, 0.3, 2.4]
[[people]]
start_m = [3, 3]
"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


def test_synth_writes_a_recording_that_our_reader_takes(scene, tmp_path, json_of, succeed):
    out = tmp_path / "out"
    printed = json_of("synth", scene, out, "--frames", 3, "--world", "--opencv")
    assert printed == {"frames": 3, "truth_rows": 3, "folder": str(out)}
    recording = open_recording(out)
    assert [f.image.shape for f in recording] == [(72, 96, 3)] * 3
    assert [f.timestamp_s for f in recording] == pytest.approx([0, 0.1, 0.2])
    assert load_world(out / "world.toml").height_m == pytest.approx(2.4)
    assert read_truth(out / "truth.csv").frame.tolist() == [0, 1, 2]
    rig = load_rig(out / "rig.toml")
    inner = cv2.FileStorage(str(out / "intrinsics.yml"), cv2.FILE_STORAGE_READ)
    outer = cv2.FileStorage(str(out / "extrinsics.yml"), cv2.FILE_STORAGE_READ)
    assert inner.getNode("M1").mat() == pytest.approx(rig.left.matrix)
    assert outer.getNode("T").mat().ravel() == pytest.approx(rig.right_SE3_left.translation)
    succeed("synth", scene, tmp_path / "videos", "--video")
    assert len(list(open_recording(tmp_path / "videos"))) == 4


def test_synth_of_one_camera_writes_boxes(scene, tmp_path, cli):
    scene.write_text(SCENE.replace("[rig]", "[camera]"))
    out = tmp_path / "out"
    assert cli("synth", scene, out)[0] == 0
    assert load_ground_camera(out / "camera.toml").size == (96, 72)
    assert len(list(open_video(out))) == 4
    with (out / "truth.csv").open() as file:
        row = next(csv.DictReader(file))
    assert float(row["height_px"]) == float(row["full_height_px"]) > 20


@pytest.mark.parametrize(
    ("words", "printed"),
    [
        (("out", "--frames", "0"), "expected"),
        (("out", "--scale", "99"), "expected"),
        (("out", "--video", "--jpeg"), "cannot be combined"),
        (("",), "in use"),
    ],
)
def test_synth_refuses_wrong_usage(scene, tmp_path, words, printed, refused):
    assert printed in refused("synth", scene, tmp_path / words[0], *words[1:])


RULES = """
[[tripwire]]
name = "door"
from_m = [0, 0]
to_m = [2, 0]
[[zone]]
name = "room"
polygon_m = [[0, -3], [2, -3], [2, 0], [0, 0]]
"""


@pytest.fixture
def folder(tmp_path) -> Path:
    """A run in which person 1 walks from y = 1 to y = -1 in 2 s and stays there for 2 s."""
    rows = [f"{t},{t / 10:.4f},1,1.0,{max(1 - t / 10, -1):.3f},confirmed" for t in range(41)]
    (tmp_path / "tracks.csv").write_text("frame,timestamp_s,id,x_m,y_m,state\n" + "\n".join(rows) + "\n")
    (tmp_path / "rules.toml").write_text(RULES)
    return tmp_path


def test_count_prints_what_it_writes(folder, json_of):
    rules = json_of("count", folder / "tracks.csv", "--rules", folder / "rules.toml")["rules"]
    assert (rules["door"]["left_to_right"], rules["door"]["right_to_left"]) == (1, 0)
    assert (rules["room"]["entries"], rules["room"]["exits"]) == (1, 0)
    assert rules["room"]["mean_dwell_s"] == pytest.approx(3.1)
    assert rules["room"]["mean_occupancy"] == pytest.approx(3.1 / 4.1)
    assert json.loads((folder / "counts.json").read_text())["rules"] == rules
    events = read_events(folder / "events.csv")
    printed = {(e.rule, e.kind, e.direction) for e in events}
    assert printed == {("door", "crossing", "left_to_right"), ("room", "entry", "")}


def test_count_scores_against_true_positions(folder, json_of, shown_by):
    rows = [f"{t},7,1.0,{max(1 - t / 10, -1):.3f},1.7" for t in range(41)]
    (folder / "truth.csv").write_text("frame,id,x_m,y_m,height_m\n" + "\n".join(rows) + "\n")
    words = ("count", folder, "--rules", folder / "rules.toml", "--truth", folder / "truth.csv")
    scores = json_of(*words)["scores"]["rules"]
    assert (scores["door"]["matched"], scores["door"]["strict_accuracy"]) == (1, 1.0)
    assert {g["people"]: g["right_percent"] for g in scores["room"]["groups"] if g["frames"]} == {"0": 100, "1-2": 100}
    assert "1-2 people: 100.0 % right" in " ".join(shown_by(*words).split())


def test_count_scores_against_true_events(folder, json_of):
    header = "frame,timestamp_s,rule,kind,id,direction\n"
    rows = "11,1.1,door,crossing,1,left_to_right\n30,3,door,crossing,2,left_to_right\n"
    (folder / "true.csv").write_text(header + rows)
    words = ("--rules", folder / "rules.toml", "--truth", folder / "true.csv")
    door = json_of("count", folder, *words)["scores"]["rules"]["door"]
    assert (door["matched"], door["recall"], door["timing_mean_s"]) == (1, 0.5, pytest.approx(-0.1))


def test_count_takes_pixels_of_a_camera(folder, refused, json_of):
    keys = "width = 640\nheight = 480\nfocal_px = 400\nheight_m = 4\ntilt_deg = 0"
    (folder / "camera.toml").write_text(f'{keys}\nlens = "pinhole"\n')
    # Straight down: the image's middle row is y = 0, right is +x.
    (folder / "rules.toml").write_text('[[tripwire]]\nname = "row"\nfrom_px = [100, 239.5]\nto_px = [600, 239.5]\n')
    words = ("count", folder, "--rules", folder / "rules.toml")
    assert json_of(*words, "--camera", folder / "camera.toml")["rules"]["row"]["left_to_right"] == 1
    assert "expected tracks with boxes, or with a camera, for rule 'row'" in refused(*words)


def test_foreign_tracks_write_nothing_next_to_them(folder, cli, succeed):
    lab = folder / "lab"
    lab.mkdir()
    (lab / "walk.txt").write_text("".join(f"1 {t} 100 {100 - 10 * t} 170\n" for t in range(21)))
    words = ("count", lab / "walk.txt", "--rules", folder / "rules.toml")
    assert cli(*words)[0] == 0
    assert [path.name for path in lab.iterdir()] == ["walk.txt"]
    succeed(*words, "--out", folder / "new" / "place")
    assert (folder / "new" / "place" / "counts.json").is_file()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--hysteresis", "-1"], "--hysteresis: "),
        (["--interval", "0"], "--interval: "),
        (["--window", "0", "--truth", "tracks.csv"], "--window"),
        (["--truth", "nothing.csv"], "nothing.csv"),
        (["--camera", "a.toml", "--rig", "b.toml"], "a camera and a rig cannot be combined"),
        (["--camera", "a.toml"], "a.toml"),
        (["--out", "rules.toml/x"], "cannot be written"),
    ],
)
def test_bad_options_get_one_sentence(folder, monkeypatch, refused, words, sentence):
    monkeypatch.chdir(folder)
    status = 1 if "--out" in words else 2
    assert sentence in refused("count", "tracks.csv", "--rules", "rules.toml", *words, status=status)


def test_tracks_without_times_are_refused_without_a_rate(folder, refused):
    (folder / "tracks.csv").write_text("frame,id,x_m,y_m\n0,1,0.5,1\n1,1,0.6,1\n")
    for words in (("count", folder, "--rules", folder / "rules.toml"), ("export", folder, "--to", "csv")):
        assert "neither timestamps nor a frame rate; use --fps" in refused(*words)


def test_export_of_tracks_without_times_gives_them_those_of_the_rate(folder, succeed):
    (folder / "tracks.csv").write_text("frame,id,x_m,y_m\n0,1,0.5,1\n1,1,0.6,1\n")
    succeed("export", folder, "--to", "csv", "--fps", 5, "--out", folder / "timed.csv")
    assert read_tracks(folder / "timed.csv").timestamp_s.tolist() == [0.0, 0.2]


@pytest.mark.parametrize("row", ["x,1,a,crossing,1,", "1,1,a,jump,1,", "1,1,a,crossing,1,up"])
def test_odd_events_are_refused_with_their_line(folder, refused, row):
    (folder / "true.csv").write_text(f"frame,timestamp_s,rule,kind,id,direction\n{row}\n")
    printed = refused("count", folder, "--rules", folder / "rules.toml", "--truth", folder / "true.csv")
    assert "true.csv: line 2: expected" in printed


def recording(folder: Path) -> Path:
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
        for i in range(4):
            if (side, i) != ("right", 2):
                cv2.imwrite(str(folder / side / f"{i}.png"), np.zeros((24, 32), np.uint8))
    (folder / "timestamps.csv").write_text("frame,timestamp_s\n0,0\n1,0.1\n2,0.2\n3,0.3\n")
    return folder


def inspected(path: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    check(path, quick=True, json=True)
    found = json.loads(capsys.readouterr().out)
    return found


def test_inspect_tells_what_a_recording_holds(tmp_path, capsys):
    save_rig(toy_rig((32, 24), focal_px=16.0), recording(tmp_path) / "rig.toml")
    found = inspected(tmp_path, capsys)
    assert (found["reader"], found["kind"], found["frames"], found["unpaired"]) == ("folders", "stereo", 4, 1)
    assert found["fps"] == pytest.approx(10.0)
    assert found["size"] == [32, 24]
    assert found["missing"] == []
    calibration = found["calibration"]
    assert calibration["baseline_m"] == pytest.approx(0.12)
    assert calibration["fov_deg"][0] == pytest.approx(90.0)


def test_inspect_names_the_option_that_supplies_what_is_missing(tmp_path, capsys):
    found = inspected(recording(tmp_path), capsys)
    assert found["calibration"] is None
    assert "use --calibration" in str(found["missing"])


def test_times_that_images_lack_are_missing_but_the_rest_is_listed(tmp_path, capsys):
    folder = write_toy_rgbd(tmp_path / "rgbd")
    (folder / "timestamps.csv").unlink(missing_ok=True)
    found = inspected(folder, capsys)
    assert found["fps"] is found["duration_s"] is None
    assert "there is no timestamps.csv; use --fps" in str(found["missing"])
    check(folder, quick=True)
    assert re.search(r"frames +36\n", capsys.readouterr().out)


def test_images_without_times_are_refused_where_people_are_followed(tmp_path, refused, succeed):
    folder = write_toy_rgbd(tmp_path / "rgbd")
    (folder / "timestamps.csv").unlink(missing_ok=True)
    for words in (("run", folder, "--out", tmp_path / "out"), ("check", folder)):
        assert f"{folder}: the frames have no times, and there is no timestamps.csv; use --fps" in refused(*words)
    assert not (tmp_path / "out").exists()
    succeed("calibrate", "floor", folder, "--out", tmp_path / "world.toml")


def street(folder: Path) -> Path:
    """A video of one camera."""
    write_frames(folder / "street.avi", [np.zeros((48, 64, 3), np.uint8)] * 4)
    return folder / "street.avi"


def test_a_run_of_one_camera_names_its_trackers(tmp_path, refused):
    printed = refused("run", street(tmp_path), "--out", tmp_path / "out")
    assert "--tracker ellipse-particle, or --tracker human-model and --calibration camera.toml" in printed


def test_a_quick_check_of_one_camera_advises_what_check_has(tmp_path, refused):
    printed = refused("check", street(tmp_path), "--quick")
    assert "--quick: " in printed
    assert "--tracker" not in printed


def test_a_quick_check_repeats_what_opens_the_recording_in_the_next_command(tmp_path, capsys):
    save_rig(toy_rig((32, 24), focal_px=16.0), tmp_path / "rig.toml")
    folder = recording(tmp_path / "recording")
    check(folder, quick=True, calibration=tmp_path / "rig.toml", fps=5.0)
    opens = f"{folder} --calibration {tmp_path / 'rig.toml'} --fps 5"
    assert f"planview run {opens} --out out" in capsys.readouterr().out


def test_a_parameter_that_is_none_is_refused_by_the_name_of_its_argument():
    with pytest.raises(InputError, match=r"^overrides=: "):
        load_config(overrides=["bogus"])


def test_view_without_a_display_names_the_page(tmp_path, monkeypatch):
    monkeypatch.setattr("planview.output.viewer.has_display", lambda: False)
    monkeypatch.setattr("planview.output.viewer.refuse_broken", lambda part: None)
    (tmp_path / "run.rrd").touch()
    with pytest.raises(WorkError, match="web=True"):
        view(tmp_path)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        *[((text, 0.03, None, None), "board=:") for text in ("9", "2x6", "99x6", "charuco:", "nine by six", "9x6x2")],
        (("charuco:2x2", 0.03, None, None), "board=:"),
        ((None, 0.0001, None, None), "square=:"),
        ((None, 24.23, None, None), "square=:"),
        (("charuco:7x5", 0.03, None, "DICT_9X9"), "dictionary=:"),
        (("charuco:7x5", 0.03, "40mm", None), "markers smaller than the squares"),
    ],
)
def test_board_without_sense_or_in_a_wrong_unit_is_refused(words, named):
    with pytest.raises(InputError, match=named):
        parse_board(*words)


@pytest.mark.parametrize("text", ["25", " 24.23 ", "2,5"])
def test_square_without_unit_is_refused_with_what_to_type(text):
    with pytest.raises(InputError, match=rf"{text.strip()}mm if these are millimetres"):
        parse_square(text)


def test_points_are_pixels_or_metres_but_not_both():
    assert parse_points(["1,2", "3,4", "5,6"]).shape == (3, 2)
    assert parse_points(["1,2,3", "3,4,5", "5,6,7"]).shape == (3, 3)
    with pytest.raises(InputError, match="u,v in pixels"):
        parse_points(["1,2", "3,4,5", "5,6"])


def test_seeds_are_varied_apart_from_parameters():
    assert parse_variations(["maps.cell_m=0.03,0.04", "seed=1,2"]) == ({"maps.cell_m": [0.03, 0.04]}, [1, 2])


def test_sweep_without_a_process_is_refused(tmp_path):
    with pytest.raises(InputError, match="jobs=: expected 1 to"):
        sweep(tmp_path, out=tmp_path / "out", jobs=0)


@pytest.mark.parametrize(
    ("error", "in_python", "typed_as"),
    [
        (InputError("expected a rate", argument="fps"), "fps=: expected a rate", "--fps: expected a rate"),
        (InputError("no floor", remedy="boxes=True"), "no floor; use boxes=True", "no floor; use --boxes"),
        (InputError("/data/fps=: no images"), "/data/fps=: no images", "/data/fps=: no images"),
        (InputError("expected a.b=1", argument="overrides"), "overrides=: expected a.b=1", "--set: expected a.b=1"),
    ],
)
def test_arguments_of_python_are_shown_as_options(error, in_python, typed_as):
    assert (str(error), typed(error)) == (in_python, typed_as)
    assert str(error.about("file")) == in_python.replace(error.args[0], f"file: {error.args[0]}")


def test_lens_without_a_place_names_the_command_that_finds_it():
    hint = "(planview calibrate human VIDEO --auto --focal 410 --out camera.toml writes one)"
    assert typed(NoCameraError("found only a lens", 410.2)).endswith(hint)


@pytest.mark.parametrize("room", ["calib", "stereo", "planview"])
def test_messages_below_the_commands_name_no_option(room):
    root = Path(__file__).parents[4]
    option = re.compile(
        r"(?<![\w<!-])--[a-z]|planview (calibrate|check|count|edit|export|render|replay|report|run|view)\b"
    )
    found = []
    for file in (root / room).rglob("*.py"):
        if file.name != "cli.py" and file.parent.name != "commands":
            calls = (node for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.Call))
            texts = {node for call in calls for node in ast.walk(call) if isinstance(node, ast.Constant)}
            found += [f"{file}:{text.lineno}" for text in texts if option.search(str(text.value))]
    assert not found


def test_parameters_are_listed_by_part_of_a_name(shown_by):
    assert shown_by("params", "maps.cell").startswith("maps.cell_m = 0.04 (from 0.005 to 0.5)\nSide of a cell")
    assert "maps.cell_m" in shown_by("params", "map*cell*")
    assert "joint." in shown_by("params")
    assert "gate_m = 0.5" in shown_by("params", "--all", "EvaluationParams.gate_m")


def test_part_of_no_name_is_refused(refused):
    assert "'no_such_word'" in refused("params", "no_such_word")


def test_printed_configuration_is_the_file_that_config_takes(tmp_path, shown_by):
    settings = ["maps.cell_m=0.05", "seed=3"]
    words = ["--print-config", "--set", settings[0], "--set", settings[1]]
    (tmp_path / "c.toml").write_text(shown_by("run", tmp_path, *words))
    assert load_config(tmp_path / "c.toml") == load_config(None, settings)


def test_run_without_a_folder_says_what_is_missing(tmp_path, refused):
    assert refused("run", tmp_path) == "planview: run needs --out FOLDER for the results"
    assert "--rrd-every: expected 1 to 100000, found 0" in refused("run", tmp_path, "--out", "out", "--rrd-every", 0)
