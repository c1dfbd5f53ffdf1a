"""The folder of a run: files, maps, progress."""

import math
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from full_disk import fill_disk_after

from calib.errors import InputError, WorkError
from calib.ground_camera import GroundCamera
from planview.output.folder import (
    LOCK_NAME,
    PRODUCTS,
    RunInfo,
    check_folder,
    folder_lock,
    prepare_folder,
    read_run_info,
    refuse_held,
    write_run_info,
)
from planview.output.run_folder import RunFolder
from planview.output.tables import FrameFile
from planview.trajectories.table import people_of


def finish(folder: Path, finished: bool = True) -> None:
    write_run_info(RunInfo(input="x", finished=finished), folder / "run.json")


def test_a_new_folder_is_made_with_its_parents_where_no_file_is_in_its_place(tmp_path):
    prepare_folder(tmp_path / "a" / "b", overwrite=False)
    assert (tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="expected a folder"):
        check_folder(tmp_path / "file", overwrite=True)
    with pytest.raises(WorkError, match="cannot be written"):
        prepare_folder(tmp_path / "file" / "out", overwrite=False)


@pytest.mark.parametrize(
    ("run_json", "sentence"),
    [
        ('{"finished": true}', "contains a finished run$"),
        ('{"input": "x"}', "contains an unfinished run$"),
        ("{half", "contains a run of another version"),
        (None, r"contains tracks\.csv but no run\.json, so it was not written by planview"),
    ],
)
def test_results_in_the_folder_are_kept(tmp_path, run_json, sentence):
    if run_json is not None:
        (tmp_path / "run.json").write_text(run_json)
    (tmp_path / "tracks.csv").write_text("precious")
    with pytest.raises(InputError, match=sentence):
        prepare_folder(tmp_path, overwrite=False)
    assert (tmp_path / "tracks.csv").read_text() == "precious"


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="/proc, where nobody can make files, is Linux's")
def test_a_folder_that_takes_no_files_is_refused_with_the_reason_before_the_work():
    with pytest.raises(WorkError, match="cannot be written"):
        check_folder(Path("/proc/self/out"), overwrite=False)


def test_overwriting_removes_products_alone(tmp_path):
    for name in PRODUCTS:
        (tmp_path / name.replace("[0-9]*", "2")).write_text("old")
    (tmp_path / "notes.txt").write_text("mine")
    prepare_folder(tmp_path, overwrite=True)
    assert [file.name for file in tmp_path.iterdir()] == ["notes.txt"]


VIEWS = ["plot.png", "scene.webm", "frame-200.png", "replay-7.png", "tracks_csv.csv", "tracks_online_pedpy.txt"]


def touch(folder: Path, names: list[str]) -> None:
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).write_text("old")


def test_overwriting_a_run_removes_what_was_made_of_it(tmp_path):
    out = tmp_path / "out"
    touch(out, [*VIEWS, "frame-of-a-door.png", "tracks_mine.csv"])
    finish(out)
    prepare_folder(out, overwrite=True, recording=tmp_path / "recording")
    assert sorted(file.name for file in out.iterdir()) == ["frame-of-a-door.png", "tracks_mine.csv"]


def test_pictures_next_to_no_run_are_kept(tmp_path):
    touch(tmp_path, VIEWS)
    prepare_folder(tmp_path, overwrite=True)
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(VIEWS)


@pytest.mark.parametrize("recorded_by", ["earlier", "new"])
def test_images_of_a_recording_that_is_its_own_output_folder_are_kept(tmp_path, recorded_by):
    images = [f"frame-{n}.png" for n in range(3)]
    touch(tmp_path, images)
    earlier = tmp_path if recorded_by == "earlier" else tmp_path / ".." / "other"
    write_run_info(RunInfo(input=str(earlier), finished=True), tmp_path / "run.json")
    prepare_folder(tmp_path, overwrite=True, recording=tmp_path if recorded_by == "new" else None)
    assert sorted(file.name for file in tmp_path.iterdir()) == images


@pytest.mark.parametrize("name", ["run.lock", "tracks.csv", "checkpoint.npz"])
def test_a_pipe_in_the_place_of_a_file_is_not_waited_for(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match=name):
        prepare_folder(tmp_path, overwrite=True)


def test_a_frame_that_does_not_fit_on_the_disk_is_cut_off(tmp_path, monkeypatch):
    file = FrameFile(tmp_path / "t.csv", lambda f: f.write("a,b\n"))
    file.add(lambda f: f.write("1,one\n"))
    with monkeypatch.context() as patch:
        fill_disk_after(patch, 9)
        with pytest.raises(WorkError, match=r"t\.csv.*no space left"):
            file.add(lambda f: f.write("2,two\n2,too\n"))
    assert (tmp_path / "t.csv").read_text() == "a,b\n1,one\n"  # on the disk before the file is closed
    file.add(lambda f: f.write("3,three\n"))
    file.close()
    assert (tmp_path / "t.csv").read_text() == "a,b\n1,one\n3,three\n"


def test_run_json_is_kept_when_its_successor_does_not_fit(tmp_path):
    if not Path("/dev/full").exists():
        pytest.skip("/dev/full, a disk that is always full, is Linux's")
    finish(tmp_path, finished=False)
    (tmp_path / "run.json.part").symlink_to("/dev/full")
    with pytest.raises(WorkError, match="no space left"):
        finish(tmp_path)
    assert not read_run_info(tmp_path / "run.json").finished
    assert [file.name for file in tmp_path.iterdir()] == ["run.json"]


HOLD = """
import sys, time
from pathlib import Path
from planview.output.folder import folder_lock
with folder_lock(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@contextmanager
def another_process_holding(folder: Path) -> Iterator["subprocess.Popen[str]"]:
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def test_a_folder_that_another_process_holds_is_refused_with_its_process(tmp_path):
    with another_process_holding(tmp_path) as process:
        with pytest.raises(InputError, match=f"process {process.pid} on .* is writing into it"):
            refuse_held(tmp_path)
        with pytest.raises(InputError, match="is writing into it"), folder_lock(tmp_path):
            pass


def test_the_lock_of_a_killed_process_is_free(tmp_path):
    with another_process_holding(tmp_path):
        pass
    with folder_lock(tmp_path):
        assert f"process {os.getpid()} on" in (tmp_path / LOCK_NAME).read_text()
    assert not (tmp_path / LOCK_NAME).exists()


@pytest.mark.parametrize("spelling", ["out", "./out", "link", "out/../out"])
def test_a_folder_belongs_to_one_call_of_a_process_under_any_name(tmp_path, monkeypatch, spelling):
    monkeypatch.chdir(tmp_path)
    Path("link").symlink_to("out")
    with folder_lock(tmp_path / "out"):
        with pytest.raises(InputError, match="is writing into it"), folder_lock(Path(spelling)):
            pass
        with pytest.raises(InputError, match="is writing into it"):
            refuse_held(Path(spelling))
    with folder_lock(Path(spelling)):
        pass


@pytest.mark.parametrize(
    "words", [["edit", "--delete", "5"], ["refine"], ["edit", "--undo-all"], ["count", "--rules", "rules.toml"]]
)
def test_results_that_another_call_holds_are_not_changed(street, refused, monkeypatch, words):
    monkeypatch.chdir(street)
    Path("rules.toml").write_text('[[zone]]\nname = "all"\npolygon_m = [[-20, 0], [20, 0], [20, 20], [-20, 20]]\n')
    with folder_lock(street):
        before = {file.name: file.read_bytes() for file in street.iterdir()}
        command, *options = words
        assert "is writing into it" in refused(command, street, *options)
        assert {file.name: file.read_bytes() for file in street.iterdir()} == before


def test_person_is_confirmed_for_half_a_second(street):
    run = RunFolder(street)  # at 10 frames per second track 4 is confirmed in 15 frames, track 5 in 3
    assert run.people.tolist() == [4]
    assert people_of(run.tracks, 1 / 6).tolist() == [4, 5], "at 6 frames per second, 3 frames are half a second"


def test_all_commands_give_the_same_number_of_people(street, cli, json_of):
    assert " of 1 people" in cli("export", street, "--to", "csv")[1]
    figures = json_of("edit", street, "--delete", "5")
    assert (figures["people_before"], figures["people"]) == (1, 1)
    assert RunFolder(street).info.people == 1
    assert ">1<" in (street / "report.html").read_text()
    (street / "rules.toml").write_text('[[zone]]\nname = "all"\npolygon_m = [[-20, 0], [20, 0], [20, 20], [-20, 20]]\n')
    assert json_of("count", street, "--rules", street / "rules.toml")["rules"]["all"]["people"] == 1


def test_camera_of_a_run_is_the_one_that_made_it(street):
    assert RunFolder(street).rule_plane.camera == GroundCamera(160, 120, 120.0, 3.0, math.radians(60.0))
