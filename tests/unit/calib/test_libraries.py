"""What libraries need of the machine, told in one sentence where it is missing."""

import sys

import pytest

from calib import libraries
from calib.errors import WorkError
from calib.libraries import import_open3d


def test_first_writable_place_is_taken(tmp_path):
    (tmp_path / "file").write_text("")
    assert libraries.first_writable([tmp_path / "file" / "cache", tmp_path / "b"]) == tmp_path / "b"
    assert not (tmp_path / "b").exists()


def test_temporary_cache_is_used_and_told_where_no_place_can_be_written(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(libraries, "usual_places", lambda: [tmp_path / "file" / "cache"])
    monkeypatch.delitem(libraries.sys.modules, "numba", raising=False)
    monkeypatch.setattr(libraries.tempfile, "mkdtemp", lambda prefix: str(tmp_path / prefix))
    monkeypatch.setenv(libraries.VARIABLE, "")
    monkeypatch.delenv(libraries.VARIABLE)
    with pytest.warns(RuntimeWarning, match="costs a minute at each start"):
        libraries.prepare_kernel_cache()
    assert libraries.os.environ[libraries.VARIABLE] == str(tmp_path / "planview-kernels-")


def test_missing_open3d_is_one_sentence_with_the_purpose(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(WorkError, match=r"^rendering needs open3d \(pip install open3d\)") as told:
        import_open3d("rendering")
    assert "\n" not in str(told.value)
