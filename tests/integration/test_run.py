"""``planview run`` over a small exact world: the contract of its folder, and everything that can go wrong."""

import csv
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from toy_stereo import ToyWorld, toy_rig, walking, write_toy_recording

from calib.errors import WorkError
from calib.rig import StereoRig, save_rig
from calib.types import U8
from planview.cli import main
from planview.config import load_config
from planview.engines import open_engine
from planview.output import prepare_folder
from planview.pipeline import FrameResult, Pipeline
from planview.run import run
from planview.run_info import read_run_info
from planview.tracks import read_tracks

FRAMES = 36
EMPTY = 10
FEW = "analysis.setup_frames=4"
Pair = tuple[U8, U8]
Say = Callable[..., tuple[int, str]]


@pytest.fixture(scope="module")
def pairs() -> list[Pair]:
    """An empty room, and from frame EMPTY on somebody who walks through it."""
    world, rig = ToyWorld(), toy_rig()
    return [world.pair(rig, walking(i - EMPTY) if i >= EMPTY else (), i) for i in range(FRAMES)]


@pytest.fixture(scope="module")
def recording(pairs: list[Pair], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_toy_recording(tmp_path_factory.mktemp("toy") / "recording", toy_rig(), pairs)


@pytest.fixture(scope="module")
def engine(recording: Path) -> Pipeline:
    """Floor found once; iterating it anew gives the same frames."""
    engine = open_engine(recording, config=load_config(None, [FEW]))
    assert isinstance(engine, Pipeline)
    return engine


@pytest.fixture
def copy(recording: Path, engine: Pipeline, tmp_path: Path) -> Path:
    """A recording to be damaged; its floor is given, so that only the damage is tried."""
    folder = tmp_path / "copy"
    shutil.copytree(recording, folder)
    write_world(engine, folder)
    return folder


@pytest.fixture
def say(capsys: pytest.CaptureFixture[str]) -> Say:
    """Run a command in this process: exit status and what it says on stderr."""

    def command(*argv: object) -> tuple[int, str]:
        try:
            main([str(word) for word in argv])
        except SystemExit as left:
            return int(left.code or 0), capsys.readouterr().err
        return 0, capsys.readouterr().err

    return command


def write_world(engine: Pipeline, folder: Path) -> None:
    from calib.world_file import save_world

    save_world(engine.setup.floor, folder / "world.toml")


def one_sentence(told: str) -> str:
    """The last line; a refusal is one line that follows no traceback."""
    assert "Traceback" not in told
    lines = [line for line in told.splitlines() if line.startswith("planview: ")]
    assert len(lines) == 1
    return lines[0]


def run_few(say: Say, recording: Path, out: Path, *more: object) -> tuple[int, str]:
    return say("run", recording, "--out", out, "--set", FEW, *more)


# What a run leaves


@pytest.fixture(scope="module")
def folder(engine: Pipeline, recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with everything: rules, decisions and the rerun recording, by the command."""
    out = tmp_path_factory.mktemp("run")
    rules = out.parent / "rules.toml"
    rules.write_text('[[tripwire]]\nname = "gate"\nfrom_m = [-0.6, 1.0]\nto_m = [-0.6, 6.0]\n')
    words = ["run", str(recording), "--out", str(out), "--set", FEW, "--rules", str(rules), "--rrd", "--debug"]
    with pytest.raises(SystemExit) as left:
        main(words)
    assert left.value.code in (0, None)
    return out


def test_tracks_have_the_columns_of_the_contract(folder: Path) -> None:
    first = (folder / "tracks.csv").read_text().splitlines()[0]
    assert first == "frame,timestamp_s,id,x_m,y_m,vx_mps,vy_mps,height_m,state,left_px,top_px,width_px,height_px"


def test_the_walker_is_tracked_once_where_he_is(folder: Path) -> None:
    tracks = read_tracks(folder / "tracks.csv")
    sure = tracks.where(tracks.state == "confirmed")
    assert set(sure.track_id) == {1}
    assert len(sure) > FRAMES - EMPTY - 12
    truth = np.array([(walking(int(f) - EMPTY)[0].x_m, walking(int(f) - EMPTY)[0].y_m) for f in sure.frame])
    assert np.median(np.hypot(sure.x_m - truth[:, 0], sure.y_m - truth[:, 1])) < 0.15
    assert np.median(sure.height_m) == pytest.approx(1.75, abs=0.06)


def test_run_json_says_what_was_done(folder: Path, recording: Path) -> None:
    info = json.loads((folder / "run.json").read_text())
    assert info["input"] == str(recording)
    assert info["finished"] is True
    assert (info["frames_read"], info["frames_skipped"], info["people"]) == (FRAMES, 0, 1)
    assert info["config"]["analysis"]["setup_frames"] == 4
    assert {"planview", "python", "numpy"} <= info["versions"].keys()
    assert info["floor"]["height_m"] == pytest.approx(2.5, abs=0.03)
    assert info["floor"]["tilt_deg"] == pytest.approx(50.0, abs=0.5)
    assert info["rig"]["baseline_m"] == pytest.approx(0.12, abs=1e-6)
    assert list(info["stages_ms"]) == ["read", "rectify", "match", "foreground", "maps", "track"]


def test_the_report_is_one_page_that_asks_for_nothing(folder: Path) -> None:
    page = (folder / "report.html").read_text()
    assert page.rstrip().endswith("</html>")
    assert 'src="http' not in page and 'href="http' not in page


def test_events_name_the_crossing(folder: Path) -> None:
    with (folder / "events.csv").open() as file:
        events = list(csv.DictReader(file))
    assert list(events[0]) == ["frame", "timestamp_s", "rule", "kind", "id", "direction"]
    assert [(event["rule"], event["id"]) for event in events] == [("gate", "1")]


def test_decisions_have_reasons_from_birth_on(folder: Path) -> None:
    with (folder / "decisions.csv").open() as file:
        decisions = list(csv.DictReader(file))
    assert decisions[0]["kind"] == "born"
    assert all(decision["reason"] for decision in decisions)
    assert "confirmed" in {decision["kind"] for decision in decisions}


def test_the_rerun_recording_passes_its_own_verification(folder: Path) -> None:
    rerun = Path(sysconfig.get_path("scripts")) / "rerun"
    done = subprocess.run([rerun, "rrd", "verify", folder / "run.rrd"], capture_output=True, timeout=60)
    assert done.returncode == 0, done.stderr.decode()


def test_nothing_half_written_is_left(folder: Path) -> None:
    assert [file.name for file in folder.iterdir() if file.suffix == ".part"] == []


def test_same_input_and_configuration_give_the_same_tracks(engine: Pipeline, folder: Path, tmp_path: Path) -> None:
    run(engine, tmp_path)
    assert (tmp_path / "tracks.csv").read_bytes() == (folder / "tracks.csv").read_bytes()


def test_a_finished_run_is_not_overwritten_unasked(say: Say, folder: Path, recording: Path) -> None:
    before = (folder / "tracks.csv").read_bytes()
    status, told = run_few(say, recording, folder)
    assert status == 2
    assert "--overwrite" in one_sentence(told)
    assert (folder / "tracks.csv").read_bytes() == before


def test_overwriting_leaves_foreign_files_alone(say: Say, copy: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run_few(say, copy, out, "--frames", 2)[0] == 0
    (out / "notes.txt").write_text("mine")
    assert run_few(say, copy, out, "--frames", 3, "--overwrite")[0] == 0
    assert (out / "notes.txt").read_text() == "mine"
    assert read_run_info(out / "run.json").frames_read == 3


def test_colour_is_tracked_like_grey(pairs: list[Pair], engine: Pipeline, tmp_path: Path) -> None:
    tint = np.array([0.8, 1.0, 0.9])
    coloured = [tuple((image[..., None] * tint).astype(np.uint8) for image in pair) for pair in pairs[:26]]
    recording = write_toy_recording(tmp_path / "colour", toy_rig(), coloured)  # type: ignore[arg-type]
    write_world(engine, recording)
    results = list(open_engine(recording, config=load_config(None, [FEW])))
    assert results[0].observation.image is not None and results[0].observation.image.ndim == 3
    assert [track.state for track in results[-1].tracks] == ["confirmed"]


def test_json_is_one_object_on_stdout_whatever_the_tracker(
    copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["run", str(copy), "--out", str(tmp_path / "[/out]"), "--tracker", "ellipse-particle", "--json"]
    with pytest.raises(SystemExit):
        main([*words, "--set", FEW])
    info = json.loads(capsys.readouterr().out)
    assert (info["tracker"], info["finished"], info["frames_read"]) == ("ellipse-particle", True, FRAMES)


# Bad input


def test_frames_that_cannot_be_used_are_skipped_counted_and_bridged(say: Say, copy: Path, tmp_path: Path) -> None:
    (copy / "left" / "000024.png").unlink()
    broken = copy / "right" / "000025.png"
    broken.write_bytes(broken.read_bytes()[:500])
    (copy / "left" / "000026.png").write_bytes(b"no image")
    out = tmp_path / "out"
    status, told = run_few(say, copy, out)
    assert status == 0, told
    info = read_run_info(out / "run.json")
    assert [skipped.index for skipped in info.skipped] == [24, 25, 26]
    assert info.frames_read == FRAMES - 3
    assert "3 skipped" in " ".join(told.split())
    tracks = read_tracks(out / "tracks.csv")
    assert set(tracks.track_id) == {1}
    assert not set(tracks.frame) & {24, 25, 26}
    assert tracks.frame.max() == FRAMES - 1
    after = tracks.where(tracks.frame == 27)
    assert after.timestamp_s[0] == pytest.approx(27 / 15, abs=1e-3)


def test_sides_of_different_lengths_are_refused(say: Say, copy: Path, tmp_path: Path) -> None:
    for i in range(20, FRAMES):
        (copy / "right" / f"{i:06d}.png").unlink()
    status, told = run_few(say, copy, tmp_path / "out")
    assert status == 2
    assert "36 left, 20 right" in one_sentence(told)


def test_sides_of_different_sizes_are_refused(say: Say, copy: Path, tmp_path: Path) -> None:
    for file in (copy / "right").iterdir():
        cv2.imwrite(str(file), np.zeros((120, 160), dtype=np.uint8))
    status, told = run_few(say, copy, tmp_path / "out")
    assert status == 2
    assert "320x240" in one_sentence(told) and "160x120" in told


def test_a_calibration_for_another_image_is_refused(say: Say, copy: Path, tmp_path: Path) -> None:
    save_rig(toy_rig((400, 240)), copy / "rig.toml")
    status, told = run_few(say, copy, tmp_path / "out")
    assert status == 2
    assert "400x240" in one_sentence(told) and "320x240" in told


def test_swapped_folders_are_told(say: Say, recording: Path, tmp_path: Path) -> None:
    swapped = tmp_path / "swapped"
    shutil.copytree(recording, swapped)
    (swapped / "left").rename(swapped / "l")
    (swapped / "right").rename(swapped / "left")
    (swapped / "l").rename(swapped / "right")
    status, told = run_few(say, swapped, tmp_path / "out")
    assert status == 1
    assert "swapped" in one_sentence(told)
    assert not (tmp_path / "out").exists()


def test_a_calibration_with_the_right_camera_on_the_left_is_told(say: Say, copy: Path, tmp_path: Path) -> None:
    rig = toy_rig()
    save_rig(StereoRig(rig.right, rig.left, rig.right_SE3_left.inverse(), "swapped"), copy / "rig.toml")
    status, told = run_few(say, copy, tmp_path / "out")
    assert status in (1, 2)
    assert "swapped" in one_sentence(told)


def test_a_calibration_of_another_rig_is_told(say: Say, pairs: list[Pair], tmp_path: Path) -> None:
    other = toy_rig(rotation_deg=(1.5, 0.0, 0.0))
    recording = write_toy_recording(tmp_path / "moved", toy_rig(), pairs[:4], claimed=other)
    status, told = run_few(say, recording, tmp_path / "out")
    assert status == 1
    assert "another rig's" in one_sentence(told)


def test_cameras_that_saw_different_things_are_told(say: Say, pairs: list[Pair], tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (FRAMES, 240, 320), dtype=np.uint8)
    strangers = [(left, other) for (left, _), other in zip(pairs[:6], noise, strict=False)]
    recording = write_toy_recording(tmp_path / "strangers", toy_rig(), strangers)
    status, told = run_few(say, recording, tmp_path / "out")
    assert status == 1
    assert "calibration" in one_sentence(told) or "floor" in told


def test_no_floor_in_view_is_a_failure_told_in_one_sentence(say: Say, tmp_path: Path) -> None:
    world, rig = ToyWorld(tilt_deg=60.0, wall_y_m=1.0), toy_rig()
    recording = write_toy_recording(tmp_path / "wall", rig, [world.pair(rig, (), i) for i in range(4)])
    status, told = run_few(say, recording, tmp_path / "out")
    assert status == 1
    assert "floor" in one_sentence(told)


def test_frames_that_are_all_unusable_are_a_failure(engine: Pipeline, recording: Path, tmp_path: Path) -> None:
    class Empty:
        path, n_frames, fps, rig, skipped = recording, 3, 15.0, engine.recording.rig, ()

        def __iter__(self) -> Iterator[FrameResult]:
            return iter(())

    nothing = Pipeline(Empty(), engine.setup, engine.config)  # type: ignore[arg-type]
    with pytest.raises(WorkError, match="none of 3 frames can be used"):
        run(nothing, tmp_path)
    assert not read_run_info(tmp_path / "run.json").finished


def test_a_truncated_video_is_tracked_to_its_end(say: Say, pairs: list[Pair], copy: Path, tmp_path: Path) -> None:
    for number, side in enumerate(("left", "right")):
        shutil.rmtree(copy / side)
        writer = cv2.VideoWriter(str(copy / f"{side}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 15.0, (320, 240), False)
        assert writer.isOpened()
        for pair in pairs[:24]:
            writer.write(pair[number])
        writer.release()
    video = copy / "right.avi"
    video.write_bytes(video.read_bytes()[: video.stat().st_size * 2 // 3])
    out = tmp_path / "out"
    status, told = run_few(say, copy, out)
    assert status == 0, told
    info = read_run_info(out / "run.json")
    assert 8 <= info.frames_read < 24
    assert info.frames_skipped == 24 - info.frames_read
    assert "Traceback" not in told


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--set", "maps.no_such=1"], "maps.no_such"),
        (["--set", "maps.cell_m=7"], "maps.cell_m"),
        (["--tracker", "telepathy"], "telepathy"),
        (["--tracker", "human-model"], "--camera"),
        (["--frames", "-1"], "--frames"),
        (["--rules", "none.toml"], "none.toml"),
        (["--config", "none.toml"], "none.toml"),
        (["--calibration", "none.toml"], "none.toml"),
        (["--camera", "none.toml", "--tracker", "human-model"], "none.toml"),
    ],
)
def test_wrong_words_are_refused_by_name(say: Say, copy: Path, tmp_path: Path, words: list[str], named: str) -> None:
    path = copy / "left" if "human-model" in words else copy
    status, told = run_few(say, path, tmp_path / "out", *words)
    assert status == 2
    assert named in one_sentence(told)
    assert not (tmp_path / "out").exists()


def test_a_recording_that_is_not_there_is_refused(say: Say, tmp_path: Path) -> None:
    status, told = run_few(say, tmp_path / "nothing", tmp_path / "out")
    assert status == 2
    assert "nothing" in one_sentence(told)


# A full disk


def test_tracks_end_with_a_whole_frame_when_the_disk_fills_up(
    say: Say, copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left, write = [1500], os.write

    def limited(descriptor: int, data: bytes) -> int:
        if descriptor < 3:
            return write(descriptor, data)
        if left[0] == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        n = write(descriptor, data[: left[0]])
        left[0] -= n
        return n

    monkeypatch.setattr(os, "write", limited)
    out = tmp_path / "out"
    status, told = run_few(say, copy, out)
    assert status == 1
    assert "No space left on device" in one_sentence(told)
    assert (out / "tracks.csv").read_bytes().endswith(b"\n")
    tracks = read_tracks(out / "tracks.csv")
    assert 5 < len(tracks) < FRAMES - EMPTY
    assert not read_run_info(out / "run.json").finished
    assert not (out / "report.html").exists()


@pytest.fixture
def tiny_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 32 kB, where one may be mounted."""
    place = tmp_path / "tiny"
    place.mkdir()
    mount = shutil.which("mount")
    done = mount and subprocess.run([mount, "-t", "tmpfs", "-o", "size=32k", "none", place], capture_output=True)
    if not done or done.returncode:
        pytest.skip("a tiny file system may not be mounted here")
    yield place
    subprocess.run(["umount", "-l", place], check=True)


def test_a_disk_without_room_for_the_report_leaves_no_half_page(say: Say, copy: Path, tiny_disk: Path) -> None:
    status, told = run_few(say, copy, tiny_disk / "out")
    assert status == 1
    assert "No space left" in one_sentence(told)
    left = {file.name for file in (tiny_disk / "out").iterdir()}
    assert left <= {"tracks.csv", "run.json"}
    read_tracks(tiny_disk / "out" / "tracks.csv")
    read_run_info(tiny_disk / "out" / "run.json")


def test_a_full_disk_from_the_start_is_told(say: Say, copy: Path, tiny_disk: Path) -> None:
    (tiny_disk / "ballast").write_bytes(bytes(32 * 1024))
    status, told = run_few(say, copy, tiny_disk / "out")
    assert status == 1
    assert "No space left" in one_sentence(told)
    assert "run.json" not in {file.name for file in (tiny_disk / "out").iterdir()}


def test_rerun_is_stopped_before_the_disk_is_full(
    engine: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from planview import rerun_log

    room = iter([200 << 20] * 4 + [10 << 20] * 100)
    monkeypatch.setattr(rerun_log.shutil, "disk_usage", lambda _: SimpleNamespace(free=next(room)))
    with pytest.raises(WorkError, match=r"run\.rrd: expected at least 64 MB of free disk, found 10"):
        run(engine, tmp_path, log=rerun_log.RerunLog(engine, tmp_path / "run.rrd"))
    assert not read_run_info(tmp_path / "run.json").finished
    rerun = Path(sysconfig.get_path("scripts")) / "rerun"
    assert subprocess.run([rerun, "rrd", "verify", tmp_path / "run.rrd"], timeout=60).returncode == 0


# Interruption


def test_interruption_leaves_valid_files_and_says_so(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["run", str(recording), "--out", str(out), "--set", FEW, "--rrd"]
    # Slow frames, so that the signal meets the run in its middle on any machine.
    program = (
        "import sys, time\nfrom planview.progress import FrameProgress\nfrom planview.cli import main\n"
        "shown = FrameProgress.__call__\n"
        "FrameProgress.__call__ = lambda self, result: (shown(self, result), time.sleep(0.2))[0]\n"
        f"main({words!r})\n"
    )
    process = subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.PIPE, text=True)
    waited = time.monotonic() + 120
    while time.monotonic() < waited and process.poll() is None and rows_in(out / "tracks.csv") < 3:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 130
    assert one_sentence(told) == "planview: interrupted"
    info = read_run_info(out / "run.json")
    assert not info.finished and 0 < info.frames_read < FRAMES
    tracks = read_tracks(out / "tracks.csv")
    assert len(tracks) >= 3 and tracks.frame.max() < FRAMES - 1
    assert not (out / "report.html").exists()
    rerun = Path(sysconfig.get_path("scripts")) / "rerun"
    assert subprocess.run([rerun, "rrd", "verify", out / "run.rrd"], timeout=60).returncode == 0


def rows_in(file: Path) -> int:
    return file.read_text().count("\n") - 1 if file.exists() else 0


# Demo, sweep and view


def test_demo_tracks_its_clip_and_prints_the_metrics(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clip, out = tmp_path / "clip", tmp_path / "out"
    shutil.copytree(recording, clip)
    cards = [(i, walking(i - EMPTY)[0]) for i in range(EMPTY, FRAMES)]
    truth = "".join(f"{i},1,{card.x_m:.3f},{card.y_m:.3f},1.75\n" for i, card in cards)
    (clip / "truth.csv").write_text("frame,id,x_m,y_m,height_m\n" + truth)
    monkeypatch.setattr("planview.commands.demo.CLIP", clip)
    with pytest.raises(SystemExit):
        main(["demo", "--out", str(out), "--json"])
    metrics = json.loads(capsys.readouterr().out)
    assert metrics["significant_errors"]["total"] == 0
    assert metrics["position_error_mean_m"] < 0.15
    assert {"tracks.csv", "run.json", "run.rrd", "report.html", "decisions.csv"} <= {f.name for f in out.iterdir()}


def test_demo_without_its_clip_is_refused(say: Say, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planview.commands.demo.CLIP", tmp_path / "none")
    status, told = say("demo", "--out", tmp_path / "out")
    assert status == 2
    assert "demo clip" in one_sentence(told)


def test_sweep_keeps_finished_runs_and_refuses_those_of_other_parameters(say: Say, copy: Path, tmp_path: Path) -> None:
    out, config = tmp_path / "sweep", tmp_path / "c.toml"
    config.write_text("[analysis]\nsetup_frames = 4\n")
    words = ["sweep", copy, "--out", out, "--config", config, "--vary", "maps.cell_m=0.03,0.05"]
    assert say(*words)[0] == 0
    tracks = sorted(out.glob("copy/*/tracks.csv"))
    assert [file.parent.name for file in tracks] == ["maps.cell_m-0.03", "maps.cell_m-0.05"]
    made = [file.stat().st_mtime_ns for file in tracks]
    assert say(*words)[0] == 0
    assert [file.stat().st_mtime_ns for file in tracks] == made
    config.write_text("[analysis]\nsetup_frames = 5\n")
    status, told = say(*words)
    assert status == 2
    assert "other parameters" in one_sentence(told)


@pytest.mark.parametrize("vary", ["maps.no_such=1,2", "maps.cell_m", "maps.cell_m=0.03,0.03"])
def test_sweep_refuses_wrong_settings_before_it_runs(say: Say, copy: Path, tmp_path: Path, vary: str) -> None:
    status, told = say("sweep", copy, "--out", tmp_path / "sweep", "--vary", vary)
    assert status == 2
    assert one_sentence(told)
    assert not (tmp_path / "sweep").exists()


def test_view_of_a_run_without_rerun_recording_is_refused(say: Say, tmp_path: Path) -> None:
    prepare_folder(tmp_path / "out", overwrite=False)
    status, told = say("view", tmp_path / "out")
    assert status == 2
    assert "--rrd" in one_sentence(told)
