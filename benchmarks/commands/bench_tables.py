"""``python -m benchmarks tables``."""

from __future__ import annotations

import json
import tempfile
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.commands.options import JsonFlag
from benchmarks.tables import LIMIT_MB, LIMIT_S, measure
from calib.errors import InputError


def bench_tables(*, rows: int = 500_000, people: float = 17.0, json_output: JsonFlag = False) -> None:
    """Time count, evaluate and report of a run of many rows, and give their peak memory.

    Example: python -m benchmarks tables --rows 500000

    Parameters
    ----------
    rows
        Rows of the truth; the tracks have a few fewer.
    people
        Mean number of people in view.
    json_output
        Print one JSON object.
    """
    if rows < 1000 or people < 1:
        raise InputError(f"--rows, --people: expected at least 1000 and 1, found {rows} and {people:g}")
    messages = Console(stderr=True, markup=False, highlight=False)
    with tempfile.TemporaryDirectory(prefix="planview-tables-") as folder:
        costs = measure(Path(folder), rows, people, messages.print)
    if json_output:
        print(json.dumps({name: asdict(cost) for name, cost in costs.items()}, indent=2))
        return
    asked = f"{LIMIT_S:g} s and {LIMIT_MB:g} MB asked for of 500,000 rows"
    table = Table("command", "processor [s]", "elapsed [s]", "peak [MB]", title=f"{rows} rows ({asked})")
    for name, cost in costs.items():
        table.add_row(name, f"{cost.processor_s:.1f}", f"{cost.elapsed_s:.1f}", f"{cost.peak_mb:.0f}")
    Console(markup=False, highlight=False).print(table)
