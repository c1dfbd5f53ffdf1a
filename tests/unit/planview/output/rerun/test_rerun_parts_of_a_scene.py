"""What a rerun recording is made of."""

import math
import subprocess
from pathlib import Path

import numpy as np
import pytest

from planview.commands import results as command
from planview.output.rerun.file import quiet_environment
from planview.output.rerun.shapes import LABEL_APART_M, label_places, mosaic, outlines
from planview.trajectories.state import TrackState


def test_labels_from_above_stand_beside_people_and_apart() -> None:
    people = [TrackState(i, "confirmed", 0.1 * i, 0.0) for i in range(3)]
    places = label_places(people)
    assert all(math.dist(place[:2], (p.x_m, p.y_m)) > 0.3 for place, p in zip(places, people, strict=True))
    assert min(math.dist(a, b) for i, a in enumerate(places) for b in places[:i]) > LABEL_APART_M


def test_foreground_is_outlined_in_pixels_of_the_image() -> None:
    mask = np.zeros((60, 80), dtype=np.uint8)
    mask[10:30, 20:40] = 255
    strips = outlines(mask, (160, 120)).strips
    assert strips is not None
    (corners,) = strips.as_arrow_array().to_pylist()
    assert np.array(corners).min(axis=0).tolist() == [40, 20]


def test_viewer_sends_no_statistics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    assert quiet_environment()["CI"] == "1"
    assert "FORCE_RERUN_ANALYTICS" not in quiet_environment()


def test_web_view_listens_on_this_machine_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    called: list[list[str]] = []

    def run(words: list[str], **_options: object) -> subprocess.CompletedProcess[bytes]:
        called.append(words)
        return subprocess.CompletedProcess(words, 0)

    monkeypatch.setattr(command.subprocess, "run", run)
    (tmp_path / "run.rrd").write_bytes(b"")
    command.view(tmp_path, web=True, web_port=9191)
    assert called[0][1:3] == ["--bind", "127.0.0.1"]
    assert "--serve-web" in called[0]
    assert "http://127.0.0.1:9191" in capsys.readouterr().err


def test_templates_are_side_by_side_in_one_image() -> None:
    tiles = {"b": np.full((3, 3), 0.5, dtype=np.float32), "a": np.full((5, 4), 200, dtype=np.uint8)}
    shown = mosaic(tiles)
    assert shown.shape == (5, 4 + 1 + 3 + 1)
    assert (shown[0, 0], shown[0, 5], shown[4, 5]) == (200, 255, 0)
