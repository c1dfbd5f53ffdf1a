"""What a run does besides tracking: memory returned."""

import ctypes
import sys

import pytest

from planview.output.run import return_unused_memory


class CLibrary:
    def __init__(self) -> None:
        self.kept: list[int] = []

    def malloc_trim(self, pad: int) -> None:
        self.kept.append(pad)


@pytest.mark.parametrize(("system", "calls"), [("linux", [0]), ("win32", []), ("darwin", [])])
def test_freed_memory_is_returned_to_linux_and_left_alone_elsewhere(
    monkeypatch: pytest.MonkeyPatch, system: str, calls: list[int]
) -> None:
    library = CLibrary()
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(ctypes, "CDLL", lambda name: library)
    return_unused_memory()
    assert library.kept == calls


def test_c_library_that_cannot_return_memory_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(ctypes, "CDLL", lambda name: asked.append(name) or object())
    return_unused_memory()
    assert asked == [None]
