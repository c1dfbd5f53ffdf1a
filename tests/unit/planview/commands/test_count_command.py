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


def run(*words: object) -> int:
    try:
        main(["count", *map(str, words)])
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def test_count_prints_the_agreed_keys_and_writes_its_files(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(folder / "tracks.csv", "--rules", folder / "rules.toml", "--json") == 0
    rules = json.loads(capsys.readouterr().out)["rules"]
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


def test_count_scores_against_true_positions(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [f"{t},7,1.0,{max(1 - t / 10, -1):.3f},1.7" for t in range(41)]
    (folder / "truth.csv").write_text("frame,id,x_m,y_m,height_m\n" + "\n".join(rows) + "\n")
    words = ("--rules", folder / "rules.toml", "--truth", folder / "truth.csv")
    assert run(folder, *words, "--json") == 0
    scores = json.loads(capsys.readouterr().out)["scores"]["rules"]
    assert (scores["door"]["matched"], scores["door"]["strict_accuracy"]) == (1, 1.0)
    assert {g["people"]: g["right_percent"] for g in scores["room"]["groups"] if g["frames"]} == {"0": 100, "1-2": 100}
    assert run(folder, *words) == 0
    assert "1-2 people: 100.0 % right" in " ".join(capsys.readouterr().out.split())


def test_count_scores_against_true_events(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    header = "frame,timestamp_s,rule,kind,id,direction\n"
    (folder / "true.csv").write_text(
        header + "11,1.1,door,crossing,1,left_to_right\n30,3,door,crossing,2,left_to_right\n"
    )
    assert run(folder, "--rules", folder / "rules.toml", "--truth", folder / "true.csv", "--json") == 0
    door = json.loads(capsys.readouterr().out)["scores"]["rules"]["door"]
    assert (door["matched"], door["recall"], door["timing_mean_s"]) == (1, 0.5, pytest.approx(-0.1))


def test_count_takes_pixels_of_a_camera(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "camera.toml").write_text(
        'width = 640\nheight = 480\nfocal_px = 400\nheight_m = 4\ntilt_deg = 0\nlens = "pinhole"\n'
    )
    # Straight down: the image's middle row is y = 0, right is +x.
    (folder / "rules.toml").write_text('[[tripwire]]\nname = "row"\nfrom_px = [100, 239.5]\nto_px = [600, 239.5]\n')
    words = (folder, "--rules", folder / "rules.toml", "--json")
    assert run(*words, "--camera", folder / "camera.toml") == 0
    assert json.loads(capsys.readouterr().out)["rules"]["row"]["left_to_right"] == 1
    assert run(*words) == 2
    assert "expected tracks with boxes (or --camera) for rule 'row'" in capsys.readouterr().err


def test_foreign_tracks_write_nothing_beside_them(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lab = folder / "lab"
    lab.mkdir()
    (lab / "walk.txt").write_text("".join(f"1 {t} 100 {100 - 10 * t} 170\n" for t in range(21)))
    words = (lab / "walk.txt", "--rules", folder / "rules.toml")
    assert run(*words) == 0
    assert [path.name for path in lab.iterdir()] == ["walk.txt"]
    assert run(*words, "--out", folder / "new" / "place") == 0
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
def test_bad_options_get_one_sentence(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], sentence: str
) -> None:
    monkeypatch.chdir(folder)
    assert run("tracks.csv", "--rules", "rules.toml", *words) in (1, 2)
    err = capsys.readouterr().err
    assert sentence in err
    assert "Traceback" not in err


def test_tracks_without_rows_count_nothing(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "tracks.csv").write_text("frame,timestamp_s,id,x_m,y_m,state\n")
    assert run(folder, "--rules", folder / "rules.toml", "--json") == 0
    rules = json.loads(capsys.readouterr().out)["rules"]
    assert (rules["door"]["left_to_right"], rules["room"]["mean_occupancy"]) == (0, 0.0)


@pytest.mark.parametrize("row", ["x,1,a,crossing,1,", "1,1,a,jump,1,", "1,1,a,crossing,1,up"])
def test_odd_events_are_refused_with_their_line(folder: Path, capsys: pytest.CaptureFixture[str], row: str) -> None:
    (folder / "true.csv").write_text(f"frame,timestamp_s,rule,kind,id,direction\n{row}\n")
    assert run(folder, "--rules", folder / "rules.toml", "--truth", folder / "true.csv") == 2
    assert "true.csv: line 2: expected" in capsys.readouterr().err
