import shutil
from pathlib import Path

import pytest

import planview
from calib.errors import InputError
from planview.output.resume import code_version, content_key
from planview.sweep.jobs import files_beside


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    for side in ("left", "right"):
        (tmp_path / "a" / side).mkdir(parents=True)
        (tmp_path / "a" / side / "0.png").write_bytes(side.encode())
    (tmp_path / "a" / "rig.toml").write_text("focal = 1")
    return tmp_path / "a"


def test_key_of_a_copy_elsewhere_is_the_same(recording: Path, tmp_path: Path) -> None:
    assert content_key(Path(shutil.copytree(recording, tmp_path / "b"))) == content_key(recording)


@pytest.mark.parametrize("change", ["left/0.png", "rig.toml", "left/1.png"])
def test_key_changes_with_the_content(change: str, recording: Path) -> None:
    before = content_key(recording)
    (recording / change).write_text("tfel" if change == "left/0.png" else "focal = 2")
    assert content_key(recording) != before


def test_key_does_not_change_with_truth_hidden_files_or_results(recording: Path) -> None:
    before = content_key(recording)
    (recording / "truth.csv").write_text("frame,id\n")
    (recording / ".cache").write_text("x")
    (recording / "out").mkdir()
    (recording / "out" / "run.json").write_text("{}")
    assert content_key(recording) == before


def test_key_of_a_large_file_depends_on_its_first_and_last_bytes_and_size(tmp_path: Path) -> None:
    path, size = tmp_path / "left.mp4", 40 * 64 * 1024
    keys = set()
    for place in (None, 0, size - 1, size):
        content = bytearray(size + (place == size))
        if place is not None:
            content[place] = 1
        path.write_bytes(content)
        keys.add(content_key(path))
    assert len(keys) == 4


def test_files_beside_a_video_are_calibrations_and_times(tmp_path: Path) -> None:
    for name in ("a.mp4", "b.mp4", "calib.json", "timestamps.csv", "truth.csv", "study.toml"):
        (tmp_path / name).touch()
    assert [file.name for file in files_beside(tmp_path / "a.mp4")] == ["calib.json", "timestamps.csv"]


def test_key_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file or folder"):
        content_key(tmp_path / "none")


def test_version_changes_with_the_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(Path(planview.__file__).parent / "checks", tmp_path / "planview" / "checks")
    monkeypatch.setattr(planview, "__file__", str(tmp_path / "planview" / "__init__.py"))
    before = code_version.__wrapped__()
    with next((tmp_path / "planview").rglob("[a-z]*.py")).open("a") as file:
        file.write("# changed\n")
    assert code_version.__wrapped__() != before
