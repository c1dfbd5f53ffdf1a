"""A pair given as two recordings of one camera each, opened again from the folder of its run."""

import shutil
from pathlib import Path

import pytest
from cli import Cli, JsonOf, Refused
from toy_recordings import video_pair
from toy_run import FEW

import planview
from planview.output.run_folder import RunFolder
from planview.output.scene import open_frames
from stereo.readers import OpenOptions, open_recording


@pytest.fixture(scope="module")
def two(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Folders of the left and the right camera in different places, and the calibration in a third one."""
    place = tmp_path_factory.mktemp("two")
    left, right, rig = place / "north" / "images", place / "south" / "pictures", place / "rigs" / "toy.toml"
    for target, source in ((left, recording / "left"), (right, recording / "right")):
        shutil.copytree(source, target)
    rig.parent.mkdir()
    shutil.copy(recording / "rig.toml", rig)
    return left, right, rig


@pytest.fixture(scope="module")
def out(two: tuple[Path, Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out") / "run"
    options = OpenOptions(str(two[2]), right=str(two[1]))  # type: ignore[arg-type]
    planview.run(str(two[0]), str(folder), options=options, config={"analysis": {"setup_frames": 4}})
    return folder


def test_run_of_two_folders_tracks_what_their_common_folder_gives(two, out, recording, cli: Cli, tmp_path: Path):
    left, right, rig = two
    status, printed = cli("run", left, right, "--calibration", rig, "--out", tmp_path / "two", "--set", FEW)
    assert status == 0, printed
    assert cli("run", recording, "--fps", 30, "--out", tmp_path / "one", "--set", FEW)[0] == 0
    tracks = [(folder / "tracks.csv").read_bytes() for folder in (tmp_path / "two", tmp_path / "one")]
    assert tracks[0] == tracks[1] and tracks[0].count(b"\n") > 10


def test_images_of_the_run_are_found_again(out: Path) -> None:
    image = next(iter(open_frames(RunFolder(out)).at([20]))).image
    assert image.max() > 0


def test_render_draws_the_images_of_both_paths(out: Path, cli: Cli, tmp_path: Path) -> None:
    status, printed = cli("render", out, "--frame", 20, "--out", tmp_path / "a.png")
    assert status == 0 and "only the floor" not in printed and (tmp_path / "a.png").is_file()


def test_replay_tracks_both_paths_again(out: Path, cli: Cli, tmp_path: Path) -> None:
    status, printed = cli("replay", out, "--frame", 20, "--out", tmp_path / "a.png")
    assert status == 0 and "tracked from" in printed and (tmp_path / "a.png").is_file()


def test_check_takes_two_paths(two: tuple[Path, Path, Path], json_of: JsonOf) -> None:
    left, right, rig = two
    found = json_of("check", left, right, "--quick", "--calibration", rig)
    assert found["kind"] == "stereo" and found["frames"] == 36 and found["missing"] == []


def test_two_videos_are_the_pair_of_their_folder(tmp_path: Path) -> None:
    (tmp_path / "pair").mkdir()
    folder = video_pair(tmp_path / "pair", (6, 6))
    frames = [frame.left for frame in open_recording(folder)]
    found = [frame.left for frame in open_recording(folder / "left.avi", OpenOptions(right=folder / "right.avi"))]
    assert len(found) == len(frames) and all((a == b).all() for a, b in zip(found, frames, strict=True))


def test_a_second_path_with_nothing_there_is_named(two: tuple[Path, Path, Path], refused: Refused) -> None:
    assert "gone: expected a video or a folder of images" in refused("run", two[0], "gone", "--out", "out")
