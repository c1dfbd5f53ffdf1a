"""``python -m benchmarks calibration``: board, floor and human calibration against known truth."""

from __future__ import annotations

import importlib
import json
import math
from typing import Literal

from rich.console import Console
from rich.table import Table

from benchmarks.commands.options import JsonFlag
from benchmarks.rows import Row

Family = Literal["board", "floor", "human"]
FAMILIES: tuple[Family, ...] = ("board", "floor", "human")


def bench_calibration(
    *,
    only: Family | None = None,
    json_: JsonFlag = False,
) -> None:
    """Score board, floor and human calibration against known truth.

    Example: python -m benchmarks calibration --only board

    Parameters
    ----------
    only
        One family: board, floor or human.
    json_
        Print one JSON object on stdout.
    """
    console = Console(stderr=True)
    rows: list[Row] = []
    for family in FAMILIES if only is None else (only,):
        with console.status(f"measuring {family} calibration"):
            rows += importlib.import_module(f"benchmarks.calibration_{family}").measure()
    (Console(stderr=True) if json_ else Console()).print(_table(rows))
    if json_:
        listed = [
            {
                "name": row.name,
                "value": row.value if math.isfinite(row.value) else None,
                "unit": row.unit,
                "limit": row.limit if math.isfinite(row.limit) else None,
                "ok": row.ok,
            }
            for row in rows
        ]
        print(json.dumps({"ok": all(row.ok for row in rows), "rows": listed}))


def _table(rows: list[Row]) -> Table:
    table = Table("measured", "value", "limit", "")
    for row in rows:
        limit = f"{row.limit:g} {row.unit}" if math.isfinite(row.limit) else ""
        table.add_row(row.name, f"{row.value:.4g} {row.unit}", limit, "ok" if row.ok else "no")
    return table
