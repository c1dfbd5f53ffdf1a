"""A run counts what its folder counts afterwards, for each kind of recording; real walkers are counted exactly."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas
import pytest
from crossing_video import CAMERA, CrossingVideo
from toy_recordings import write_frames
from toy_rgbd import write_toy_rgbd
from toy_run import FEW, run_few

import planview
from calib.ground_camera import save_ground_camera
from planview.counting.rules import RulePlane, parse_rules
from planview.counting.totals import count_tracks
from planview.output.folder import read_run_info
from planview.output.run_folder import RunFolder
from planview.trajectories.formats import load_tracks
from planview.trajectories.table import Trajectories

LINE = '[[tripwire]]\nname = "gate"\nfrom_px = [{0}, 0]\nto_px = [{0}, {1}]\n'
PLACE = '[[zone]]\nname = "room"\npolygon_px = [[{0}, {1}], [{2}, {1}], [{2}, {3}], [{0}, {3}]]\n'
BORDER = '[[tripwire]]\nname = "border"\nfrom_px = [80, 90]\nto_px = [80, 119]\n'


@pytest.fixture(params=["pair", "sensors", "depth", "maps", "camera", "no calibration", "detections"])
def words(request, tmp_path, succeed) -> list[object]:
    """What is run, and how."""
    kind = request.param
    if kind in ("pair", "sensors"):
        return [request.getfixturevalue("recording" if kind == "pair" else "sensors"), "--set", FEW]
    if kind == "depth":
        return [write_toy_rgbd(tmp_path / "depth"), "--set", "analysis.setup_frames=6"]
    if kind == "maps":
        pair = request.getfixturevalue("recording")
        run_few(succeed, pair, tmp_path / "first", "--maps")
        return [tmp_path / "first" / "maps.h5"]
    clip = tmp_path / "clip.avi"
    write_frames(clip, [frame.image for frame in CrossingVideo()])
    if kind == "no calibration":
        return [clip, "--tracker", "ellipse-particle"]
    save_ground_camera(CAMERA, tmp_path / "camera.toml")
    if kind == "camera":
        return [clip, "--tracker", "human-model", "--calibration", tmp_path / "camera.toml"]
    rows = [f"{i + 1},-1,{4 * i - 10},40,16,50,1\n" for i in range(40)]
    (tmp_path / "det.txt").write_text("".join(rows))
    return [clip, "--detections", tmp_path / "det.txt", "--calibration", tmp_path / "camera.toml"]


def test_every_way_to_count_gives_the_same_counts(words, tmp_path, succeed, json_of):
    out, rules = tmp_path / "out", tmp_path / "rules.toml"
    succeed("run", words[0], "--out", tmp_path / "look", *words[1:], "--frames", "3")
    width, height = RunFolder(tmp_path / "look").info.size_px
    rules.write_text(LINE.format(width // 2, height - 1) + PLACE.format(width // 3, height // 3, width - 1, height - 1))
    if not RunFolder(tmp_path / "look").camera:
        rules.write_text(rules.read_text() + BORDER)
    else:  # the pixels of lines show the floor
        rules.write_text(rules.read_text().replace(f"{width // 2}, 0]", f"{width // 2}, {height * 2 // 3}]"))
    succeed("run", words[0], "--out", out, *words[1:], "--rules", rules)
    info = read_run_info(out / "run.json")
    live = info.counts
    assert info.size_px == (width, height)
    assert (info.plane == "floor") == (RunFolder(out).camera is not None)
    assert sum(rule["people"] for rule in live["rules"].values()) >= 1
    again = json_of("count", out, "--rules", rules)
    assert _same(again, live)
    assert _same(json.loads((out / "counts.json").read_text()), live)
    counted = json.loads(json.dumps(planview.count(str(out), str(rules)).to_json()))
    assert _same({name: counted[name] for name in live}, live)


def _same(one: object, other: object) -> bool:
    """Equal but for the digits that tracks.csv leaves out."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_same(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return bool(np.isclose(one, other, atol=0.01))
    return one == other


def test_count_says_what_it_replaces(tmp_path, cli):
    rows = "".join(f"{i},{i / 10},1,{i / 10 - 1:.1f},2,confirmed\n" for i in range(30))
    (tmp_path / "tracks.csv").write_text("frame,timestamp_s,id,x_m,y_m,state\n" + rows)
    (tmp_path / "rules.toml").write_text('[[tripwire]]\nname = "door"\nfrom_m = [0, 0]\nto_m = [0, 4]\n')
    _, first = cli("count", tmp_path, "--rules", tmp_path / "rules.toml")
    _, second = cli("count", tmp_path, "--rules", tmp_path / "rules.toml")
    assert "replaced" not in first
    assert "replaced" in second
    assert "events.csv" in second


def test_line_in_pixels_whose_image_size_is_not_known_is_told(tmp_path, cli):
    rows = "".join(f"{i},{i / 10},1,,,confirmed,{5 * i},40,16,40\n" for i in range(30))
    header = "frame,timestamp_s,id,x_m,y_m,state,left_px,top_px,width_px,height_px\n"
    (tmp_path / "tracks.csv").write_text(header + rows)
    (tmp_path / "rules.toml").write_text(BORDER)
    _, printed = cli("count", tmp_path, "--rules", tmp_path / "rules.toml")
    assert "the size of the images is not known" in " ".join(printed.split())


def test_python_takes_tables_of_pandas(tmp_path):
    rows = [(i, i / 10, 1, i / 10 - 1, 2.0) for i in range(30)]
    frame = pandas.DataFrame(rows, columns=["frame", "timestamp_s", "id", "x_m", "y_m"])
    (tmp_path / "rules.toml").write_text('[[tripwire]]\nname = "door"\nfrom_m = [0, 0]\nto_m = [0, 4]\n')
    counts = planview.count(frame, str(tmp_path / "rules.toml"))
    assert counts.to_dataframe().people.tolist() == [1]
    assert len(counts.value.events) == 1
    scores = planview.evaluate(frame, frame)
    assert scores.clear.mota == 1.0
    assert all(len(repr(value)) <= 200 for value in (scores, planview.Trajectories.from_dataframe(frame)))
    with pytest.raises(planview.InputError, match="truth"):
        planview.evaluate(frame)
    with pytest.raises(planview.InputError, match="'x_m'"):
        planview.evaluate(frame.drop(columns="x_m"), frame)
    with pytest.raises(planview.InputError, match="config"):
        planview.run(tmp_path, config={"maps": {"cell_m": -1}})


RULES = {"tripwire": [{"name": "y = 0", "from_m": [-10, 0], "to_m": [10, 0]}]}
EXACT = [("uo-050-180-180.txt", 61, 0), ("boa-300-frei.txt", 25, 25)]
"""File, crossings towards -y (left to right along +x), crossings towards +y."""


def counted(tracks: Trajectories) -> tuple[int, int]:
    wire = count_tracks(tracks, parse_rules(RULES, RulePlane(), "rules")).to_json()["rules"]["y = 0"]
    return wire["left_to_right"], wire["right_to_left"]


def read(shared_data: Path, name: str) -> Trajectories:
    path = shared_data / "trajectories" / name
    if not path.is_file():
        pytest.skip(f"{path} is not here")
    return load_tracks(path)


@pytest.mark.parametrize(("name", "down", "up"), EXACT)
def test_counts_of_measured_heads_are_exact(shared_data, name, down, up):
    assert counted(read(shared_data, name)) == (down, up)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("name", "down", "up"), EXACT)
def test_counts_of_noisy_tracks_stay_exact(shared_data, name, down, up, seed):
    tracks = read(shared_data, name)
    rng = np.random.default_rng(seed)
    noise = rng.normal(0.0, 0.10, (len(tracks), 2))
    noisy = replace(tracks, x_m=tracks.x_m + noise[:, 0], y_m=tracks.y_m + noise[:, 1])
    dropped = rng.random(int(tracks.frame.max()) + 1) < 0.3
    assert counted(noisy.where(~dropped[noisy.frame])) == (down, up)
