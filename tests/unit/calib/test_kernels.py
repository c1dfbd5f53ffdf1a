"""Compiled kernels are those of the sources that are there."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from calib import kernels

START = """
from planview.toy import scaled
value = scaled(3)
print(value, sum(scaled.dispatcher.stats.cache_hits.values()))
"""


@pytest.fixture
def copy(tmp_path) -> Path:
    """Calib, and a kernel of planview that uses a constant of a file that uses one of another file of stereo."""
    copy = tmp_path / "copy"
    shutil.copytree(kernels.ROOT / "calib", copy / "calib", ignore=shutil.ignore_patterns("__pycache__"))
    kernel = "from calib.kernels import kernel\n@kernel\ndef scaled(x):\n    return FACTOR * x\n"
    for name, source in {
        "stereo/__init__.py": "",
        "stereo/step.py": "STEP = 2\n",
        "planview/__init__.py": "",
        "planview/factor.py": "from stereo import step\nFACTOR = 10 * step.STEP\n",
        "planview/toy.py": f"from planview.factor import (\n    FACTOR,\n)\n{kernel}",
        "planview/reader.py": "from planview.toy import scaled\n",
    }.items():
        (copy / name).parent.mkdir(exist_ok=True)
        (copy / name).write_text(source)
    return copy


def start(copy: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """A process that prints the kernel's value for 3, and how often what was compiled before was used."""
    environment = os.environ | {"PYTHONPATH": "", "PYTHONDONTWRITEBYTECODE": "1", "NUMBA_CACHE_DIR": ""} | environment
    command = [sys.executable, "-c", START]
    return subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=True)


def kept(copy: Path) -> list[str]:
    return sorted(file.name for file in (copy / "planview" / "__pycache__").iterdir())


def test_kernel_is_replaced_when_a_constant_of_another_file_is_edited(copy):
    assert start(copy).stdout == "60 0\n"
    before = kept(copy)
    (copy / "stereo" / "step.py").write_text("STEP = 7\n")
    assert start(copy).stdout == "210 0\n"
    assert len(kept(copy)) == len(before) == 1
    assert not set(before) & set(kept(copy))


def empty(file: Path) -> None:
    file.write_bytes(b"")


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-100])


def overwrite(file: Path) -> None:
    file.write_bytes(os.urandom(5000))


def flip_a_byte(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0x55
    file.write_bytes(content)


def lead_nowhere(file: Path) -> None:
    file.unlink()
    file.symlink_to("gone")


@pytest.mark.parametrize("damage", [empty, cut, overwrite, flip_a_byte, lead_nowhere])
def test_damaged_kernel_is_replaced(copy, damage):
    assert start(copy).stdout == "60 0\n"
    for file in (copy / "planview" / "__pycache__").iterdir():
        damage(file)
    assert start(copy).stdout == "60 0\n"
    assert start(copy).stdout == "60 1\n"


def test_kernel_that_cannot_be_saved_runs_with_a_warning(copy):
    with (copy / "planview" / "toy.py").open("a") as toy:
        toy.write("scaled.dispatcher\nimport shutil\nshutil.rmtree('planview/__pycache__')\n")
        toy.write("open('planview/__pycache__', 'w').close()\n")
    done = start(copy)
    assert done.stdout == "60 0\n"
    assert "kernels cannot be cached" in done.stderr


def test_kernel_is_not_compiled_again_when_a_file_it_does_not_import_is_edited_or_all_are_moved(copy, tmp_path):
    assert start(copy).stdout == "60 0\n"
    (copy / "planview" / "reader.py").write_text("from planview.toy import scaled as toy\n")
    moved = shutil.copytree(copy, tmp_path / "moved", copy_function=shutil.copy)  # with other times
    assert start(moved).stdout == "60 1\n"


def test_kernel_runs_uncached_with_one_warning_where_no_folder_can_be_written(copy):
    (copy / "planview" / "__pycache__").write_text("")
    with (copy / "planview" / "toy.py").open("a") as toy:
        toy.write("kernel(lambda x: x).dispatcher\n")
    done = start(copy, XDG_CACHE_HOME=str(copy / "planview" / "toy.py"))
    assert done.stdout == "60 0\n"
    assert done.stderr.count("set NUMBA_CACHE_DIR to a folder that stays") == 1


def test_kernel_runs_uncached_with_a_warning_where_numba_has_no_such_cache(monkeypatch):
    monkeypatch.delattr("numba.core.caching.FunctionCache")
    with pytest.warns(RuntimeWarning, match="numba"):
        uncached = kernels.kernel(kept).dispatcher
    assert uncached.stats.cache_path is None


def test_kernels_depend_on_constants_of_other_files_but_on_no_reader_or_command():
    root, packages = kernels.ROOT, ("calib", "stereo", "planview")
    files = [file for package in packages for file in (root / package).rglob("*.py") if "@kernel" in file.read_text()]
    rooms = {source.relative_to(root).parent.as_posix() for file in files for source in kernels.sources(file)}
    assert root / "planview/tracking/body.py" in kernels.sources(root / "planview/tracking/explain/_ascent_kernels.py")
    assert not rooms & {"calib/formats", "stereo/readers", "planview/engine", "planview/output", "planview/commands"}


def test_no_kernel_is_cached_otherwise():
    files = [file for package in ("calib", "stereo", "planview") for file in (kernels.ROOT / package).rglob("*.py")]
    assert [file for file in files if "cache=True" in file.read_text()] == []
