"""``planview export --cloud``: the static scene in metres on the axes of the tracks."""

from pathlib import Path

import numpy as np
import pytest
from say import Refused, Say

from planview.engine.engine import Engine
from planview.engine.setup import scene_cloud, set_up


def test_most_points_of_an_empty_room_lie_on_its_floor(engine: Engine) -> None:
    cloud = scene_cloud(engine.recording, set_up(engine.recording, engine.config), engine.config)
    assert cloud.points_m.shape == cloud.colours.shape
    assert np.median(np.abs(cloud.points_m[:, 2])) < 0.03


def test_cloud_of_a_recording_is_a_ply_file(say: Say, recording: Path, tmp_path: Path) -> None:
    pytest.importorskip("open3d")
    status, told = say("export", recording, "--cloud", tmp_path / "new" / "scene.ply")
    assert status == 0, told
    assert (tmp_path / "new" / "scene.ply").read_bytes()[:3] == b"ply"


@pytest.mark.parametrize("words", [["--cloud", "scene.txt"], [], ["--cloud", "a.ply", "--to", "csv"]])
def test_export_without_a_known_format_is_refused(refused: Refused, recording: Path, words: list[str]) -> None:
    assert "expected" in refused("export", recording, *words)
