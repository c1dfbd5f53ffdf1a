from pathlib import Path

import pytest

from calib import kernel_cache


def test_first_writable_place_is_taken(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert kernel_cache.first_writable([tmp_path / "file" / "cache", tmp_path / "b"]) == tmp_path / "b"


def test_temporary_cache_is_used_and_told_where_no_place_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(kernel_cache, "usual_places", lambda: [tmp_path / "file" / "cache"])
    monkeypatch.delitem(kernel_cache.sys.modules, "numba", raising=False)
    monkeypatch.setattr(kernel_cache.tempfile, "mkdtemp", lambda prefix: str(tmp_path / prefix))
    monkeypatch.setenv(kernel_cache.VARIABLE, "")
    monkeypatch.delenv(kernel_cache.VARIABLE)
    with pytest.warns(RuntimeWarning, match="costs a minute at each start"):
        kernel_cache.prepare_kernel_cache()
    assert kernel_cache.os.environ[kernel_cache.VARIABLE] == str(tmp_path / "planview-kernels-")
