"""``planview count`` from files to files."""

import json
from pathlib import Path

import pytest

from planview.cli import main
from planview.counting.events import read_events

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
def folder(tmp_path: Path) -> Path:
    """A run in which person 1 walks from y = 1 to y = -1 in 2 s and stays there for 2 s."""
    rows = [f"{t},{t / 10:.4f},1,1.0,{max(1 - t / 10, -1):.3f},confirmed" for t in range(41)]
    (tmp_path / "tracks.csv").write_text("frame,timestamp_s,id,x_m,y_m,state\n" + "\n".join(rows) + "\n")
    (tmp_path / "rules.toml").write_text(RULES)
    return tmp_path


def test_count_prints_the_agreed_keys_and_writes_its_files(folder, json_of):
    rules = json_of("count", folder / "tracks.csv", "--rules", folder / "rules.toml")["rules"]
    assert (rules["door"]["left_to_right"], rules["door"]["right_to_left"]) == (1, 0)
    assert (rules["room"]["entries"], rules["room"]["exits"]) == (1, 0)
    assert rules["room"]["mean_dwell_s"] == pytest.approx(3.1)
    assert rules["room"]["mean_occupancy"] == pytest.approx(3.1 / 4.1)
    assert json.loads((folder / "counts.json").read_text())["rules"] == rules
    events = read_events(folder / "events.csv")
    assert {(e.rule, e.kind, e.direction) for e in events} == {
        ("door", "crossing", "left_to_right"),
        ("room", "entry", ""),
    }


def test_count_scores_against_true_positions(folder, json_of, capsys):
    rows = [f"{t},7,1.0,{max(1 - t / 10, -1):.3f},1.7" for t in range(41)]
    (folder / "truth.csv").write_text("frame,id,x_m,y_m,height_m\n" + "\n".join(rows) + "\n")
    words = ("count", folder, "--rules", folder / "rules.toml", "--truth", folder / "truth.csv")
    scores = json_of(*words)["scores"]["rules"]
    assert (scores["door"]["matched"], scores["door"]["strict_accuracy"]) == (1, 1.0)
    assert {g["people"]: g["right_percent"] for g in scores["room"]["groups"] if g["frames"]} == {"0": 100, "1-2": 100}
    with pytest.raises(SystemExit, match="0"):
        main([*map(str, words)])
    assert "1-2 people: 100.0 % right" in " ".join(capsys.readouterr().out.split())


def test_count_scores_against_true_events(folder, json_of):
    header = "frame,timestamp_s,rule,kind,id,direction\n"
    (folder / "true.csv").write_text(
        header + "11,1.1,door,crossing,1,left_to_right\n30,3,door,crossing,2,left_to_right\n"
    )
    words = ("--rules", folder / "rules.toml", "--truth", folder / "true.csv")
    door = json_of("count", folder, *words)["scores"]["rules"]["door"]
    assert (door["matched"], door["recall"], door["timing_mean_s"]) == (1, 0.5, pytest.approx(-0.1))


def test_count_takes_pixels_of_a_camera(folder, refused, json_of):
    (folder / "camera.toml").write_text(
        'width = 640\nheight = 480\nfocal_px = 400\nheight_m = 4\ntilt_deg = 0\nlens = "pinhole"\n'
    )
    # Straight down: the image's middle row is y = 0, right is +x.
    (folder / "rules.toml").write_text('[[tripwire]]\nname = "row"\nfrom_px = [100, 239.5]\nto_px = [600, 239.5]\n')
    words = ("count", folder, "--rules", folder / "rules.toml")
    assert json_of(*words, "--camera", folder / "camera.toml")["rules"]["row"]["left_to_right"] == 1
    assert "expected tracks with boxes (or --camera) for rule 'row'" in refused(*words)


def test_foreign_tracks_write_nothing_beside_them(folder, say):
    lab = folder / "lab"
    lab.mkdir()
    (lab / "walk.txt").write_text("".join(f"1 {t} 100 {100 - 10 * t} 170\n" for t in range(21)))
    words = ("count", lab / "walk.txt", "--rules", folder / "rules.toml")
    assert say(*words)[0] == 0
    assert [path.name for path in lab.iterdir()] == ["walk.txt"]
    assert say(*words, "--out", folder / "new" / "place")[0] == 0
    assert (folder / "new" / "place" / "counts.json").is_file()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--hysteresis", "-1"], "hysteresis_m"),
        (["--interval", "0"], "interval_s"),
        (["--window", "0", "--truth", "tracks.csv"], "--window"),
        (["--truth", "nothing.csv"], "nothing.csv"),
        (["--camera", "a.toml", "--rig", "b.toml"], "--camera or --rig"),
        (["--camera", "a.toml"], "a.toml"),
        (["--out", "rules.toml/x"], "could not write"),
    ],
)
def test_bad_options_get_one_sentence(folder, monkeypatch, refused, words, sentence):
    monkeypatch.chdir(folder)
    status = 1 if "--out" in words else 2
    assert sentence in refused("count", "tracks.csv", "--rules", "rules.toml", *words, status=status)


def test_tracks_without_rows_count_nothing(folder, json_of):
    (folder / "tracks.csv").write_text("frame,timestamp_s,id,x_m,y_m,state\n")
    rules = json_of("count", folder, "--rules", folder / "rules.toml")["rules"]
    assert (rules["door"]["left_to_right"], rules["room"]["mean_occupancy"]) == (0, 0.0)


@pytest.mark.parametrize("row", ["x,1,a,crossing,1,", "1,1,a,jump,1,", "1,1,a,crossing,1,up"])
def test_odd_events_are_refused_with_their_line(folder, refused, row):
    (folder / "true.csv").write_text(f"frame,timestamp_s,rule,kind,id,direction\n{row}\n")
    told = refused("count", folder, "--rules", folder / "rules.toml", "--truth", folder / "true.csv")
    assert "true.csv: line 2: expected" in told
