"""What a run does besides tracking: memory returned, walkers doubted."""

import ctypes
import math
import sys
from types import SimpleNamespace

import pytest

from planview.output.run import return_unused_memory
from planview.output.totals import RunTotals


class CLibrary:
    def __init__(self) -> None:
        self.kept: list[int] = []

    def malloc_trim(self, pad: int) -> None:
        self.kept.append(pad)


@pytest.mark.parametrize(("system", "calls"), [("linux", [0]), ("win32", []), ("darwin", [])])
def test_freed_memory_is_returned_to_linux_and_left_alone_elsewhere(monkeypatch, system, calls):
    library = CLibrary()
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(ctypes, "CDLL", lambda name: library)
    return_unused_memory()
    assert library.kept == calls


def test_c_library_that_cannot_return_memory_is_no_error(monkeypatch):
    asked = []
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(ctypes, "CDLL", lambda name: asked.append(name) or object())
    return_unused_memory()
    assert asked == [None]


@pytest.mark.parametrize(("px_per_s", "doubted"), [(80.0, False), (300.0, True)])
def test_people_without_metres_who_move_faster_than_walkers_are_doubted(px_per_s, doubted):
    totals, nan = RunTotals(), math.nan
    for n in range(20):
        box = (n * px_per_s / 10, 50.0, 40.0, 100.0)
        track = SimpleNamespace(track_id=1, state="confirmed", x_m=nan, box_px=box)
        totals.take(SimpleNamespace(frame=n, timestamp_s=n / 10, tracks=(track,), stages_ms={}))  # type: ignore[arg-type]
    assert totals.remark().startswith("they move 3.0 of their heights a second") == doubted
    assert bool(totals.remark()) == doubted
