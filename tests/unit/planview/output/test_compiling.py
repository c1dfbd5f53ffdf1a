"""The line that says that kernels are compiled."""

import io

from numba import njit
from rich.console import Console

from planview.output.progress import compile_notice


def test_compiled_kernels_are_told_and_cached_ones_are_not() -> None:
    kernel = njit(lambda x: x + 1)
    told = io.StringIO()
    with compile_notice(Console(file=told)):
        kernel(1)
    assert "once per installation" in told.getvalue()
    told = io.StringIO()
    with compile_notice(Console(file=told)):
        kernel(1)
    assert told.getvalue() == ""
