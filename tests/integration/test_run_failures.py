"""``planview run``: what can be wrong with a recording or a disk, in one sentence each."""

import gc
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Iterator
from copy import copy as same_parts
from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from cli import one_sentence
from full_disk import fill_disk_after, report_free_mb
from toy_run import EMPTY, FEW, FRAMES, is_whole, rows_in, run_few
from toy_stereo import ToyWorld, toy_rig, write_toy_recording

import planview
from calib.errors import WorkError
from calib.types import U8
from planview.output.folder import read_run_info
from planview.output.run import run
from planview.output.run_spec import RunSpec
from planview.trajectories.table import read_tracks
from stereo.recording import OpenOptions


def test_frames_that_cannot_be_used_are_bridged(succeed, copy, tmp_path):
    (copy / "left" / "000024.png").unlink()
    broken = copy / "right" / "000025.png"
    broken.write_bytes(broken.read_bytes()[:500])
    (copy / "left" / "000026.png").write_bytes(b"no image")
    out = tmp_path / "out"
    printed = run_few(succeed, copy, out)
    info = read_run_info(out / "run.json")
    assert [skipped.index for skipped in info.skipped] == [24, 25, 26]
    assert info.frames_read == FRAMES - 3
    assert "3 skipped" in " ".join(printed.split())
    tracks = read_tracks(out / "tracks.csv")
    confirmed = tracks.where(tracks.state == "confirmed")
    assert set(confirmed.track_id) == {1}
    assert not set(tracks.frame) & {24, 25, 26}
    assert tracks.frame.max() == FRAMES - 1
    after = tracks.where(tracks.frame == 27)
    assert after.timestamp_s[0] == pytest.approx(27 / 15, abs=1e-3)


def test_a_span_of_frames_ends_where_it_says_however_many_are_unreadable(copy, tmp_path):
    for n in (8, 9, 10, 17, 18):
        (copy / "left" / f"{n:06d}.png").write_bytes(b"no image")
    seen = []
    tracks = planview.run(copy, frames="9:16", watch=lambda result: seen.append(result.frame))
    assert (seen, tracks.tracked) == ([11, 12, 13, 14, 15, 16], (9, 16))
    kept = planview.run(copy, frames="9:16", out=tmp_path / "out")
    info = read_run_info(tmp_path / "out" / "run.json")
    assert ([frame.index for frame in info.skipped], kept.tracked) == ([9, 10], (9, 16))


STRANGE = np.random.default_rng(0).integers(0, 255, (6, 240, 320), dtype=np.uint8)
BARE = ToyWorld(tilt_deg=60.0, wall_y_m=1.0)


def compressed(image: U8) -> U8:
    """The image as JPEG of the lowest quality gives it."""
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 2])[1], 0)


@pytest.mark.parametrize(
    ("images", "named"),
    [
        (lambda pairs: [(pairs[i][0], STRANGE[i]) for i in range(6)], "no floor found in 4"),
        (lambda pairs: [BARE.pair(toy_rig(), (), i) for i in range(4)], "no floor found"),
        (lambda pairs: [(compressed(a), compressed(b)) for a, b in pairs[:4]], "compression: expected at most 2"),
    ],
    ids=["different scenes", "no floor in view", "compressed"],
)
def test_images_without_a_floor_are_a_failure_told_in_one_sentence(refused, pairs, tmp_path, images, named):
    recording = write_toy_recording(tmp_path / "recording", toy_rig(), images(pairs))
    sentence = refused("run", recording, "--out", tmp_path / "out", "--set", FEW, status=1)
    assert named in sentence
    assert "--out pictures draws its rows, depth and floor" in sentence
    assert not (tmp_path / "out").exists()


def test_frames_that_are_all_unusable_are_a_failure(engine, recording, tmp_path):
    class Empty:
        path, n_frames, fps, parts, skipped = recording, 3, 15.0, engine.recording.parts, ()
        notes, files, options, is_live = (), (), OpenOptions(), False

        def __iter__(self):
            return iter(())

    nothing = same_parts(engine)
    nothing.recording = Empty()
    with pytest.raises(WorkError, match="none of 3"):
        run(nothing, RunSpec(tmp_path))
    assert not read_run_info(tmp_path / "run.json").finished


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--topics", "a"], "--topics"),
        (["--tracker", "human-model"], "--calibration"),
        (["--rules", "none.toml"], "none.toml"),
        (["--config", "none.toml"], "none.toml"),
        (["--calibration", "none.toml"], "none.toml"),
        (["--camera", "none.toml", "--tracker", "human-model"], "none.toml"),
    ],
)
def test_wrong_words_are_refused_by_name(refused, copy, tmp_path, words, named):
    path = copy / "left" if "human-model" in words else copy
    assert named in run_few(refused, path, tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()


def test_tracks_end_with_a_whole_frame_when_the_disk_fills_up(refused, copy, tmp_path, monkeypatch):
    fill_disk_after(monkeypatch, 1500)
    out = tmp_path / "out"
    assert "no space left on the disk" in refused("run", copy, "--out", out, "--set", FEW, status=1)
    assert (out / "tracks.csv").read_bytes().endswith(b"\n")
    tracks = read_tracks(out / "tracks.csv")
    assert 5 < len(tracks) < FRAMES - EMPTY
    assert not read_run_info(out / "run.json").finished
    assert not (out / "report.html").exists()


@pytest.fixture
def tiny_disk(tmp_path) -> Iterator[Path]:
    """A file system of 32 kB, where one may be mounted."""
    place = tmp_path / "tiny"
    place.mkdir()
    mount = shutil.which("mount")
    done = mount and subprocess.run([mount, "-t", "tmpfs", "-o", "size=32k", "none", place], capture_output=True)
    if not done or done.returncode:
        pytest.skip("a tiny file system may not be mounted here")
    yield place
    subprocess.run(["umount", "-l", place], check=True)


def test_a_disk_without_room_for_the_report_leaves_no_half_page(refused, copy, tiny_disk):
    assert "no space left" in refused("run", copy, "--out", tiny_disk / "out", "--set", FEW, status=1)
    left = {file.name for file in (tiny_disk / "out").iterdir()}
    assert left <= {"tracks.csv", "decisions.csv", "run.json"}
    read_tracks(tiny_disk / "out" / "tracks.csv")
    read_run_info(tiny_disk / "out" / "run.json")


def test_a_full_disk_from_the_start_is_told(refused, copy, tiny_disk):
    (tiny_disk / "ballast").write_bytes(bytes(32 * 1024))
    assert "no space left" in refused("run", copy, "--out", tiny_disk / "out", "--set", FEW, status=1)
    assert "run.json" not in {file.name for file in (tiny_disk / "out").iterdir()}


def test_rerun_is_stopped_before_the_disk_is_full(engine, tmp_path, monkeypatch):
    report_free_mb(monkeypatch, *[200] * 4, *[10] * 100)
    with pytest.raises(WorkError, match="64 MB"):
        run(engine, RunSpec(tmp_path, rrd_every=1))
    assert not read_run_info(tmp_path / "run.json").finished
    assert is_whole(tmp_path / "run.rrd")


def test_rerun_that_cannot_write_is_not_waited_for(engine, tmp_path, monkeypatch):
    from planview.output import rerun_log

    unregistered = []
    monkeypatch.setattr(rerun_log.rr, "unregister_shutdown", lambda: unregistered.append(True))
    log = rerun_log.RerunLog(engine, tmp_path / "run.rrd")
    stream = weakref.ref(log._stream)
    log._stream.flush = Mock(side_effect=RuntimeError("Flush timed out"))
    with pytest.raises(WorkError, match=r"run\.rrd: cannot be written"):
        log.mark()
    del log
    gc.collect()
    assert unregistered
    assert stream() is not None


@pytest.mark.parametrize("room", [30_000, 300_000])
def test_rerun_without_room_ends_the_run_in_a_sentence(engine, copy, tmp_path, room):
    list(engine)  # numba's caches are written while there is room
    out, no_checkpoints = tmp_path / "out", ("--checkpoint-every", "0")  # which would end a slow run early
    output = subprocess.run(
        [sys.executable, "-m", "planview", "run", copy, "--out", out, "--set", FEW, *no_checkpoints, "--rrd"],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (room, room)),  # of a process of its own
        stderr=subprocess.PIPE, text=True, timeout=300,
    )  # fmt: skip
    assert output.returncode == 1 and re.search(r"run\.rrd.*cannot be written", one_sentence(output.stderr)), (
        output.stderr
    )
    assert len(read_tracks(out / "tracks.csv"))
    assert not read_run_info(out / "run.json").finished


# Interruption


def test_interruption_leaves_valid_files(recording, tmp_path):
    out = tmp_path / "out"
    words = ["run", str(recording), "--out", str(out), "--set", FEW, "--rrd"]
    # Slow frames, so that the signal meets the run in its middle on any machine; background jobs of a shell ignore it.
    program = (
        "import signal, time\nfrom planview.commands.console import Bar\nfrom planview.cli import main\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "shown = Bar.__call__\n"
        "Bar.__call__ = lambda self, done, total: (shown(self, done, total), time.sleep(0.2))[0]\n"
        f"main({words!r})\n"
    )
    process = subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.PIPE, text=True)
    waited = time.monotonic() + 120
    while time.monotonic() < waited and process.poll() is None and rows_in(out / "tracks.csv") < 3:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, output = process.communicate(timeout=60)
    assert process.returncode == 130
    assert one_sentence(output) == "planview: interrupted"
    info = read_run_info(out / "run.json")
    assert not info.finished
    assert 0 < info.frames_read < FRAMES
    tracks = read_tracks(out / "tracks.csv")
    assert len(tracks) >= 3
    assert tracks.frame.max() < FRAMES - 1
    assert not (out / "report.html").exists()
    assert (out / "checkpoint.npz").is_file()
    assert is_whole(out / "run.rrd")
