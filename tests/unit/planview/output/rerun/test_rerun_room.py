"""A rerun recording kept small, and gone on with after a kill."""

import os
import re
import subprocess
import sysconfig
from pathlib import Path

import pytest
import rerun as rr

from calib.errors import InputError
from planview.output.rerun.file import DOUBLED_MAX, RrdFile, quiet_environment, rarer


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
