"""``planview replay``: a run again with a parameter changed."""

import json
from pathlib import Path

import cv2
import pytest

from calib.errors import InputError
from planview.cli import main
from planview.engine.config import Config, load_config
from planview.engine.open import open_engine
from planview.output.replay import difference_text, replay_run
from planview.output.results import read_results
from planview.output.run import RunOptions, run

TRACKER = "ellipse-particle"


@pytest.fixture
def ellipses(street: Path, tmp_path: Path) -> Path:
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
    run(open_engine(video, TRACKER, Config()), out, RunOptions(TRACKER))
    return out


def test_run_repeated_with_its_own_parameters_has_the_same_tracks(ellipses):
    results = read_results(ellipses)
    replayed = replay_run(results, load_config(None, (), None), 25)
    assert replayed.source == ellipses.parent / "street"
    assert difference_text(results, replayed, 25)[0] == "tracks are the same up to this frame"


def test_command_draws_both_and_says_what_differs(ellipses, tmp_path, capsys):
    words = ["--frame", "25", "--set", "single_camera.foreground.gaussians=2", "--png", str(tmp_path / "both.png")]
    with pytest.raises(SystemExit, match="0"):
        main(["replay", str(ellipses), *words])
    assert "tracks" in capsys.readouterr().out
    picture = cv2.imread(str(tmp_path / "both.png"))
    assert picture.shape[0] > 2 * 480


def test_frame_beyond_the_run_is_refused_and_a_recording_that_is_gone_named(ellipses, refused):
    assert "from 0 to 29" in refused("replay", ellipses, "--frame", 99)
    info = json.loads((ellipses / "run.json").read_text())
    (ellipses / "run.json").write_text(json.dumps({**info, "input": "gone"}))
    with pytest.raises(InputError, match="gone"):
        replay_run(read_results(ellipses), Config(), 5)


@pytest.mark.parametrize("damaged", [b"frame\n1\n", b"\xff", b"frame,timestamp_s,id,kind,reason\n,0,1,born,x\n"])
def test_decisions_that_are_damaged_are_refused(ellipses, refused, damaged):
    (ellipses / "decisions.csv").write_bytes(damaged)
    assert "decisions.csv: expected" in refused("replay", ellipses, "--frame", 25)
