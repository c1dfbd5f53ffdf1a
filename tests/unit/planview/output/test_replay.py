"""Pictures of a run: stills, videos, rerun recordings, and a run again with a parameter changed."""

import json
import math
import re
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import planview.tracking
from calib.errors import InputError
from planview.api.view import view
from planview.counting.events import Event
from planview.drawing.people import ARROW_M, AXIS_M
from planview.drawing.style import as_bgr
from planview.engine.config import Config, load_config
from planview.engine.open import open_engine
from planview.output.folder import RunInfo, read_run_info, rrd_parts, write_run_info
from planview.output.render import tally
from planview.output.replay import difference_text, replay_run
from planview.output.report.page import write_report
from planview.output.rerun_shapes import MAP_LAYERS, facing_shapes, mosaic, outlines
from planview.output.run import run
from planview.output.run_folder import RunFolder
from planview.output.run_spec import RunSpec
from planview.output.viewer import quiet_environment
from planview.trajectories.plot import person_rgb
from planview.trajectories.state import TrackState
from stereo.readers import OpenOptions

TRACKER = "ellipse-particle"


@pytest.fixture
def ellipses(street, tmp_path) -> Path:
    """A run of the ellipse tracker over the street, in which a white block walks."""
    video = tmp_path / "street"
    for n, file in enumerate(sorted(video.glob("*.png"))):
        image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        image[:] = 90
        if n >= 8:
            image[40:90, 30 + 2 * n : 48 + 2 * n] = 250
        cv2.imwrite(str(file), image)
    out = tmp_path / "ellipses"
    out.mkdir()
    run(open_engine(video, TRACKER, options=OpenOptions(fps=30.0)), RunSpec(out))
    return out


def test_run_repeated_with_its_own_parameters_has_the_same_tracks(ellipses):
    results = RunFolder(ellipses)
    replayed = replay_run(results, load_config(None, (), None), 25)
    assert replayed.source == ellipses.parent / "street"
    assert difference_text(results, replayed, 25)[0] == "tracks are the same up to this frame"


def test_tracks_before_refinement_or_edits_are_those_of_the_tracker(tmp_path):
    for name, rows in (("tracks_online.csv", 3), ("tracks_before.csv", 2), ("tracks.csv", 1)):
        write_tracks(tmp_path / name, rows)
    for refined, rows in ((True, 3), (False, 2)):
        write_run_info(RunInfo(refined=refined), tmp_path / "run.json")
        assert len(RunFolder(tmp_path).as_tracked.tracks) == rows
    (tmp_path / "tracks_before.csv").unlink()
    assert len(RunFolder(tmp_path).as_tracked.tracks) == 1


def write_tracks(path: Path, n_rows: int) -> None:
    rows = "".join(f"{n},{n / 10},1,0,5,1.7,confirmed\n" for n in range(n_rows))
    path.write_text("frame,timestamp_s,id,x_m,y_m,height_m,state\n" + rows)


@pytest.mark.parametrize("part", ["matcher", "tracker", "sensor"])
def test_a_run_with_parts_that_its_folder_does_not_keep_is_not_replayed(ellipses, refused, part):
    info = read_run_info(ellipses / "run.json")
    write_run_info(info.model_copy(update={"own_parts": {part: "Mine"}}), ellipses / "run.json")
    assert f"your own {part} Mine" in refused("replay", ellipses, "--frame", 25)


def test_command_draws_what_differs(ellipses, tmp_path, shown_by):
    words = ["--frame", "25", "--set", "single_camera.foreground.gaussians=2", "--out", tmp_path / "both.png"]
    assert "tracks" in shown_by("replay", ellipses, *words)
    picture = cv2.imread(str(tmp_path / "both.png"))
    assert picture.shape[0] > 2 * 480


def test_frame_beyond_the_run_is_refused(ellipses, refused):
    assert "expected 0 to 29" in refused("replay", ellipses, "--frame", 99)


def test_recording_that_is_gone_is_named(ellipses):
    info = json.loads((ellipses / "run.json").read_text())
    (ellipses / "run.json").write_text(json.dumps({**info, "input": "gone", "recording": ""}))
    with pytest.raises(InputError, match="gone"):
        replay_run(RunFolder(ellipses), Config(), 5)


@pytest.mark.parametrize("damaged", [b"frame\n1\n", b"\xff", b"frame,timestamp_s,id,kind,reason\n,0,1,born,x\n"])
def test_decisions_that_are_damaged_are_refused(ellipses, refused, damaged):
    (ellipses / "decisions.csv").write_bytes(damaged)
    assert "decisions.csv: expected" in refused("replay", ellipses, "--frame", 25)


def test_the_usual_video_has_a_picture_per_frame(street, tmp_path, shown_by):
    shown_by("render", street, "--out", tmp_path / "new" / "scene.mp4", "--frames", "5:14")
    capture = cv2.VideoCapture(str(tmp_path / "new" / "scene.mp4"))
    assert int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little") == b"VP90"  # which browsers play
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == 10
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(10)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["scene.mp4"]
    shown_by("render", street, "--frames", "5:7")
    assert (street / "scene.webm").is_file()


def test_without_a_floor_there_is_no_plan_of_it(street, tmp_path, shown_by):
    info = json.loads((street / "run.json").read_text())
    (street / "run.json").write_text(json.dumps({**info, "rig": None, "floor": None}))
    rows = "".join(f"{n},{n / 10:.4f},4,,,,confirmed,20,10,20,60\n" for n in range(30))
    header = "frame,timestamp_s,id,x_m,y_m,height_m,state,left_px,top_px,width_px,height_px\n"
    (street / "tracks.csv").write_text(header + rows)
    shown_by("render", street, "--frame", "4", "--out", tmp_path / "still.png", "--no-truth")
    picture = cv2.imread(str(tmp_path / "still.png"))
    assert picture.shape[1] == 640
    page = write_report(street).read_text()
    assert "Boxes: people" in page
    assert "metres" not in page


def test_still_shows_the_image_next_to_the_floor(street, tmp_path, shown_by):
    shown_by("render", street, "--frame", "4", "--out", tmp_path / "still.png", "--no-truth")
    picture = cv2.imread(str(tmp_path / "still.png"))
    assert picture.shape[1] == 640 + 360
    people = (picture == as_bgr(person_rgb(4))).all(axis=2)
    assert people[:, :640].any()
    assert people[:, 640:].any()
    assert int(np.median(picture[40:, :200])) == 104


def test_floor_alone_is_drawn_when_the_recording_is_gone(street, tmp_path, cli):
    info = json.loads((street / "run.json").read_text())
    (street / "run.json").write_text(json.dumps({**info, "input": "gone", "recording": ""}))
    status, printed = cli("render", street, "--frame", "4", "--out", tmp_path / "still.png")
    assert status == 0
    assert "no images, only the floor" in printed
    assert cv2.imread(str(tmp_path / "still.png")) is not None


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--frame", "30"], "--frame"), (["--out", "x.png"], "--frame"), (["--out", "x.txt"], "x.txt"),
        (["--frames", "9:3"], "--frames"), (["--frames", "40:50"], "frames from 40"), (["--every", "0"], "--every"),
    ],
)  # fmt: skip
def test_wrong_options_are_refused_by_name(street, words, named, refused):
    assert named in refused("render", street, *words)


def test_a_folder_that_is_no_run_is_refused_in_one_sentence(tmp_path, refused):
    missing = tmp_path / "none"
    assert refused("render", missing).startswith(f"planview: {missing}: no such file or folder")


def test_tally_counts_what_happened_up_to_a_frame():
    events = [
        Event(3, 0.3, "gate", "crossing", 1, "left_to_right"), Event(5, 0.5, "gate", "crossing", 2, "right_to_left"),
        Event(2, 0.2, "room", "entry", 1), Event(6, 0.6, "room", "exit", 1),
    ]  # fmt: skip
    assert tally(events, {}, 4) == ["room: 1 inside, 1 entries", "gate: 1 to its right, 0 to its left"]
    assert tally(events, {"gate": {"inward": "right_to_left"}}, 6) == ["room: 0 inside, 1 entries", "gate: 1 out, 1 in"]


def test_viewer_sends_no_statistics(monkeypatch):
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    assert quiet_environment()["CI"] == "1"
    assert "FORCE_RERUN_ANALYTICS" not in quiet_environment()


def test_web_view_listens_on_this_machine_only(tmp_path, monkeypatch, caplog):
    called = []

    def started(words, **_):
        called.append(words)
        return SimpleNamespace(wait=lambda: 0, pid=2**30)  # of no process

    monkeypatch.setattr(subprocess, "Popen", started)
    major, minor = map(int, version("rerun-sdk").split(".")[:2])
    (tmp_path / "run.rrd").write_bytes(b"RRF2" + bytes([major, minor, 0, 0]) + b"RRF2FOOT" + bytes(4))
    view(tmp_path, web=True, web_port=9191)
    assert called[0][1:3] == ["--bind", "127.0.0.1"]
    assert "--serve-web" in called[0]
    assert "http://127.0.0.1:9191" in caplog.text


def test_viewer_ends_with_the_command(tmp_path):
    (tmp_path / "child.py").write_text(
        "import os, pathlib, time\n"
        "pathlib.Path(__file__).with_name('pid').write_text(str(os.getpid()))\n"
        "time.sleep(60)\n"
    )
    (tmp_path / "rerun").write_text(f"#!/bin/sh\n{sys.executable} {tmp_path / 'child.py'}\n")
    (tmp_path / "rerun").chmod(0o755)
    code = "from planview.output import viewer; from planview.cli import _stop_on_signals; _stop_on_signals()\n"
    code += f"viewer.sysconfig.get_path = lambda _: {str(tmp_path)!r}; viewer.Viewer().wait()"
    command_line = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    until = time.monotonic() + 30
    while not (tmp_path / "pid").is_file() or not (tmp_path / "pid").read_text():
        assert time.monotonic() < until
        time.sleep(0.05)
    started = int((tmp_path / "pid").read_text())
    command_line.terminate()
    command_line.wait(timeout=20)
    while Path(f"/proc/{started}/status").is_file() and "Z (" not in Path(f"/proc/{started}/status").read_text():
        assert time.monotonic() < until
        time.sleep(0.05)


def test_templates_are_drawn_side_by_side():
    tiles = {"b": np.full((3, 3), 0.5, np.float32), "a": np.full((5, 4), 200, np.uint8)}
    shown = mosaic(tiles)
    assert shown.shape == (5, 4 + 1 + 3 + 1)
    assert (shown[0, 0], shown[0, 5], shown[4, 5]) == (200, 255, 0)


def test_foreground_is_drawn_in_pixels_of_the_image():
    mask = np.zeros((60, 80), np.uint8)
    mask[10:30, 20:40] = 255
    strips = outlines(mask, (160, 120)).strips
    (corners,) = strips.as_arrow_array().to_pylist()
    assert np.array(corners).min(axis=0).tolist() == [40, 20]


def test_parts_of_a_rerun_recording_are_in_the_order_of_their_numbers(tmp_path):
    names = ["run.rrd", "run-2.rrd", "run-3.rrd", "run-10.rrd"]
    for name in names:
        (tmp_path / name).touch()
    assert [part.name for part in rrd_parts(tmp_path / "run.rrd")] == names


def test_the_maps_show_every_shape_that_a_tracker_draws_on_the_floor():
    sources = Path(planview.tracking.__path__[0]).rglob("*.py")
    names = {name for path in sources for name in re.findall(r'Drawing\("(\w+)", "floor"', path.read_text("utf-8"))}
    assert {"bodies", "footprints"} <= names
    assert {f"plan/{name}" for name in names} <= set(MAP_LAYERS)


def test_rerun_shows_an_arrow_where_somebody_surely_faces():
    people = [
        TrackState(number, "confirmed", 1.0, 5.0, facing_deg=90.0, facing_confidence=confidence)
        for number, confidence in ((4, 0.95), (5, 0.6), (6, math.nan))
    ]
    (arrows, lines), (above, below) = facing_shapes([*people, TrackState(7, "confirmed", 1.0, 5.0)], None)
    assert arrows.vectors is not None
    assert lines.strips is not None
    np.testing.assert_allclose(arrows.vectors.as_arrow_array().to_pylist(), [[0.0, ARROW_M, 0.0]] * 2, atol=1e-6)
    ends = [[1.0, 5.0 - AXIS_M, 0.05], [1.0, 5.0 + AXIS_M, 0.05]]
    np.testing.assert_allclose(lines.strips.as_arrow_array().to_pylist(), [ends], atol=1e-6)
    assert above.vectors is not None
    assert len(above.vectors) == 0
    assert below.strips is not None
    assert len(below.strips) == 0
