"""Pictures and videos of a run."""

import json

import cv2
import numpy as np
import pytest

from planview.cli import main
from planview.counting.events import Event
from planview.drawing.style import as_bgr, person_rgb
from planview.output.render import Tally
from planview.output.report.page import write_report


def render(*words: object) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["render", *map(str, words)])


def test_the_usual_video_plays_in_browsers_and_has_a_picture_per_frame_at_the_rate_of_the_run(street, tmp_path):
    render(street, "--video", tmp_path / "new" / "scene.mp4", "--frames", "5:14")
    capture = cv2.VideoCapture(str(tmp_path / "new" / "scene.mp4"))
    assert int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little") == b"VP90"  # which browsers play
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == 10
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(10)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["scene.mp4"]
    render(street, "--frames", "5:7")
    assert (street / "scene.webm").is_file()


def test_without_a_floor_there_is_no_plan_of_it(street, tmp_path):
    info = json.loads((street / "run.json").read_text())
    (street / "run.json").write_text(json.dumps({**info, "rig": None, "floor": None}))
    rows = "".join(f"{n},{n / 10:.4f},4,,,,confirmed,20,10,20,60\n" for n in range(30))
    header = "frame,timestamp_s,id,x_m,y_m,height_m,state,left_px,top_px,width_px,height_px\n"
    (street / "tracks.csv").write_text(header + rows)
    render(street, "--frame", "4", "--png", tmp_path / "still.png", "--no-truth")
    picture = cv2.imread(str(tmp_path / "still.png"))
    assert picture.shape[1] == 640
    page = write_report(street).read_text()
    assert "Boxes: people" in page and "metres" not in page


def test_still_shows_the_image_beside_the_floor(street, tmp_path):
    render(street, "--frame", "4", "--png", tmp_path / "still.png", "--no-truth")
    picture = cv2.imread(str(tmp_path / "still.png"))
    assert picture.shape[1] == 640 + 360
    people = (picture == as_bgr(person_rgb(4))).all(axis=2)
    assert people[:, :640].any() and people[:, 640:].any() and int(np.median(picture[40:, :200])) == 104


def test_floor_alone_is_drawn_when_the_recording_is_gone(street, tmp_path, capsys):
    info = json.loads((street / "run.json").read_text())
    (street / "run.json").write_text(json.dumps({**info, "input": "gone"}))
    render(street, "--frame", "4", "--png", tmp_path / "still.png")
    assert "the floor alone is drawn" in capsys.readouterr().err
    assert cv2.imread(str(tmp_path / "still.png")) is not None


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--frame", "30"], "--frame"), (["--png", "x.png"], "--frame"), (["--video", "x.txt"], "x.txt"),
        (["--frames", "9:3"], "--frames"), (["--frames", "40:50"], "frames from 40"), (["--every", "0"], "--every"),
    ],
)  # fmt: skip
def test_wrong_options_are_refused_by_name(street, words, named, refused):
    assert named in refused("render", street, *words)


def test_tally_counts_what_happened_up_to_a_frame():
    events = [
        Event(3, 0.3, "gate", "crossing", 1, "left_to_right"), Event(5, 0.5, "gate", "crossing", 2, "right_to_left"),
        Event(2, 0.2, "room", "entry", 1), Event(6, 0.6, "room", "exit", 1),
    ]  # fmt: skip
    tally = Tally(events)
    assert tally.lines(4) == ["room: 1 inside, 1 entries", "gate: 1 to its right, 0 to its left"]
    assert Tally(events, {"gate": "right_to_left"}).lines(6)[1] == "gate: 1 out, 1 in"
    assert tally.lines(6)[0] == "room: 0 inside, 1 entries"
