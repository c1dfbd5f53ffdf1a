"""open3d is imported where it is used, and asked for in one sentence where it is missing."""

import sys

import pytest

from calib.errors import WorkError
from calib.open3d_import import import_open3d


def test_missing_open3d_is_one_sentence_with_the_purpose(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(WorkError, match=r"^rendering needs open3d \(pip install open3d\)") as told:
        import_open3d("rendering")
    assert "\n" not in str(told.value)
