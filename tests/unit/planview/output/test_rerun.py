"""Rerun recordings: shapes, size, and going on after a kill."""

import math
import os
import re
import subprocess
import sysconfig
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from calib.errors import InputError
from planview.commands import results as command
from planview.output.rerun.file import DOUBLED_MAX, RrdFile, quiet_environment, rarer
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


@pytest.mark.parametrize(("written", "step"), [(0, 1), (499, 1), (500, 2), (750, 4), (875, 8)])
def test_images_become_rarer_whenever_half_of_the_room_left_is_used(written: int, step: int) -> None:
    assert rarer(written, room=1000) == step


def test_images_stay_when_the_room_is_used_up() -> None:
    assert rarer(5000, room=1000) == 2**DOUBLED_MAX


def written(path: Path, first: int, last: int) -> int:
    """Log frames as a run does; the size before the table of contents."""
    stream = rr.RecordingStream("planview", recording_id="run")
    stream.save(str(path))
    for frame in range(first, last):
        stream.set_time("frame", sequence=frame)
        stream.log("people", rr.Points2D([[frame, 0]]))
    stream.flush()
    size = path.stat().st_size
    stream.disconnect()
    return size


def rows_of(path: Path) -> int:
    rerun = Path(sysconfig.get_path("scripts")) / "rerun"
    command = [str(rerun), "rrd", "stats", str(path)]
    told = subprocess.run(command, env=quiet_environment(), capture_output=True, text=True, check=True).stdout
    found = re.search(r"num_rows = (\d+)", told)
    assert found
    return int(found[1])


@pytest.mark.parametrize("closed", [True, False])
def test_a_recording_that_was_stopped_twice_holds_all_frames(tmp_path: Path, closed: bool) -> None:
    path = tmp_path / "run.rrd"
    file = RrdFile(path)
    end = written(file.open_path, 0, 5)
    size_of_properties = rows_of(path) - 5
    resumed = RrdFile(path, {"whole": end, "rest": 0})
    rest = written(resumed.open_path, 5, 8)
    os.truncate(resumed.open_path, rest)
    position = resumed.position()
    assert position == {"whole": end, "rest": rest}
    if closed:
        resumed.close(rest)
    again = RrdFile(path, position)
    assert path.stat().st_size == end + rest
    again.close(written(again.open_path, 8, 10))
    assert rows_of(path) - 3 * size_of_properties == 10
    assert [file.name for file in tmp_path.iterdir()] == ["run.rrd"]


def test_a_recording_that_ends_before_the_checkpoint_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run.rrd").write_bytes(b"12345")
    with pytest.raises(InputError, match="expected 9 bytes before the checkpoint, found 5"):
        RrdFile(tmp_path / "run.rrd", {"whole": 4, "rest": 5})
