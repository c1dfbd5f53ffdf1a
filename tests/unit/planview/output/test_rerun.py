"""Rerun recordings: shapes, size, and going on after a kill."""

import math
import subprocess

import numpy as np
import pytest

from calib.errors import InputError
from planview.commands import results as command
from planview.commands.results import quiet_environment
from planview.output.folder import rrd_parts
from planview.output.rerun.log import kept_parts, rarer
from planview.output.rerun.shapes import LABEL_APART_M, label_places, mosaic, outlines
from planview.trajectories.state import TrackState


def test_labels_from_above_stand_beside_people_and_apart():
    people = [TrackState(i, "confirmed", 0.1 * i, 0.0) for i in range(3)]
    places = label_places(people)
    assert all(math.dist(place[:2], (p.x_m, p.y_m)) > 0.3 for place, p in zip(places, people, strict=True))
    assert min(math.dist(a, b) for i, a in enumerate(places) for b in places[:i]) > LABEL_APART_M


def test_foreground_is_outlined_in_pixels_of_the_image():
    mask = np.zeros((60, 80), dtype=np.uint8)
    mask[10:30, 20:40] = 255
    strips = outlines(mask, (160, 120)).strips

    (corners,) = strips.as_arrow_array().to_pylist()
    assert np.array(corners).min(axis=0).tolist() == [40, 20]


def test_viewer_sends_no_statistics(monkeypatch):
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    assert quiet_environment()["CI"] == "1" and "FORCE_RERUN_ANALYTICS" not in quiet_environment()


def test_web_view_listens_on_this_machine_only(tmp_path, monkeypatch, capsys):
    called: list[list[str]] = []

    def run(words: list[str], **_options: object) -> subprocess.CompletedProcess[bytes]:
        called.append(words)
        return subprocess.CompletedProcess(words, 0)

    monkeypatch.setattr(command.subprocess, "run", run)
    (tmp_path / "run.rrd").write_bytes(b"")
    command.view(tmp_path, web=True, web_port=9191)
    assert called[0][1:3] == ["--bind", "127.0.0.1"] and "--serve-web" in called[0]
    assert "http://127.0.0.1:9191" in capsys.readouterr().err


def test_templates_are_side_by_side_in_one_image():
    tiles = {"b": np.full((3, 3), 0.5, dtype=np.float32), "a": np.full((5, 4), 200, dtype=np.uint8)}
    shown = mosaic(tiles)
    assert shown.shape == (5, 4 + 1 + 3 + 1) and (shown[0, 0], shown[0, 5], shown[4, 5]) == (200, 255, 0)


@pytest.mark.parametrize(("written", "step"), [(0, 1), (499, 1), (500, 2), (750, 4), (875, 8), (5000, 4096)])
def test_images_become_rarer_whenever_half_of_the_room_left_is_used(written, step):
    assert rarer(written, room=1000) == step


def test_a_recording_that_ends_before_the_checkpoint_is_refused(tmp_path):
    (tmp_path / "run.rrd").write_bytes(b"12345")
    with pytest.raises(InputError, match="expected 9 bytes before the checkpoint, found 5"):
        kept_parts(tmp_path / "run.rrd", {"parts": 1, "size": 9})


def test_a_resumed_recording_drops_what_was_written_after_the_checkpoint(tmp_path):
    names = ["run.rrd", "run-2.rrd", "run-3.rrd", "run-10.rrd"]
    for name in names:
        (tmp_path / name).write_bytes(b"12345")
    assert [part.name for part in rrd_parts(tmp_path / "run.rrd")] == names
    kept = kept_parts(tmp_path / "run.rrd", {"parts": 2, "size": 3})
    assert [part.name for part in kept] == ["run.rrd", "run-2.rrd", "run-3.rrd"]
    assert {part.name: part.stat().st_size for part in tmp_path.iterdir()} == {"run.rrd": 5, "run-2.rrd": 3}
