"""The rules and the program of docs/counting.md work as they stand there."""

import re
from pathlib import Path

import numpy as np
import pytest

from planview.counting.rules import load_rules
from planview.counting.totals import count_tracks
from planview.trajectories.table import Trajectories, positions_table, write_table

PAGE = Path(__file__).resolve().parents[4] / "docs" / "counting.md"
METRES, PIXELS = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture
def nearer() -> Trajectories:
    """Somebody who walks towards the camera through the door of the page."""
    frame = np.arange(40)
    xy = np.column_stack([np.zeros(40), 5.0 - 0.1 * frame])
    return positions_table(frame, np.ones(40, dtype=np.int64), xy, np.full(40, 1.7), 0.1 * frame)


def test_coming_towards_the_camera_is_in(nearer, tmp_path):
    (tmp_path / "rules.toml").write_text(METRES)
    door = count_tracks(nearer, load_rules(tmp_path / "rules.toml")).to_json()["rules"]["door"]
    assert (door["in"], door["out"]) == (1, 0)


def test_walking_up_the_image_is_in(tmp_path):
    (tmp_path / "rules.toml").write_text(PIXELS)
    frame = np.arange(40)
    box = np.column_stack([np.full(40, 300.0), 350.0 - 6 * frame, np.full(40, 30.0), np.full(40, 60.0)])
    up = positions_table(frame, np.ones(40, dtype=np.int64), np.full((40, 2), np.nan), None, 0.1 * frame, box)
    edge = count_tracks(up, load_rules(tmp_path / "rules.toml")).to_json()["rules"]["platform edge"]
    assert (edge["in"], edge["out"]) == (1, 0)


def test_the_program_runs(nearer, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rules.toml").write_text(METRES)
    (tmp_path / "out").mkdir()
    with (tmp_path / "out" / "tracks.csv").open("w") as file:
        write_table(file, nearer)
    found = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert found
    exec(found.group(1), {})
    assert "'door'" in capsys.readouterr().out
