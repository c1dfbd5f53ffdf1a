"""``planview calibrate align``: where stereo heads are beside each other, from people who walk."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from calib.errors import InputError
from calib.rigs_file import save_rigs
from planview.calibration.align import align_records, check_inside, rig_entries
from planview.calibration.align_params import AlignParams
from planview.calibration.head_alignment import HeadAlignment
from planview.calibration.head_record import HeadRecord, record_head
from planview.commands.options import JsonFlag
from planview.engine.config import Config, load_config
from planview.output.progress import PlainConsole


@Parameter(name="*")
@dataclass(frozen=True)
class AlignOptions:
    """Where the result is written, and how far clocks may be apart."""

    out: Path | None = None
    """rigs.toml to write, in a folder above all heads; that folder is then a recording of several heads."""
    clock: float = 10.0
    """Largest difference of the times at which the recordings begin [s]; a longer search takes longer."""
    config: Path | None = None
    """TOML file with the parameters of a run."""
    set_: Annotated[Sequence[str], Parameter(name="--set")] = ()
    """One parameter of a run; may be given several times."""
    json_output: JsonFlag = False
    """Print one JSON object to standard output."""


def calibrate_align(first: Path, second: Path, /, *others: Path, options: AlignOptions | None = None) -> None:
    """Find where stereo heads are beside each other from people who walk where both see them. No board, no markers.

    Every head is tracked by itself, above its own floor; heading, place and clock are those at which the people of one
    head meet those of the other. Let one to three people walk around for a minute, with turns, in the floor that the
    heads share: standing people, or one straight line, do not tell, and are refused.

    Example: planview calibrate align hall/north hall/south --out hall/rigs.toml, then planview run hall --out out

    Parameters
    ----------
    first
        Recording of the head whose world and clock become the common ones.
    second
        Recording of the next head.
    others
        Recordings of further heads; each must share floor with a head named before or after it.
    """
    options = options or AlignOptions()
    heads = (first, second, *others)
    if not 0 <= options.clock <= 3600:
        raise InputError(f"--clock: expected 0 to 3600 s, found {options.clock:g}")
    if len({head.resolve() for head in heads}) < len(heads):
        raise InputError(f"expected every head once, found {', '.join(map(str, heads))}")
    if options.out is not None:
        check_inside(heads, options.out.parent)
    console = PlainConsole(stderr=True)
    records = _records(heads, load_config(options.config, options.set_), console)
    alignments = align_records(records, AlignParams(clock_s=options.clock))
    for record, alignment in zip(records[1:], alignments, strict=True):
        console.print(sentence(record.path.name, alignment), highlight=False)
    if options.out is not None:
        written = "found by planview calibrate align from people who walked"
        save_rigs(rig_entries(records, alignments, options.out.parent), options.out, written)
        console.print(f"wrote {options.out}", highlight=False)
    else:
        console.print("no rigs.toml written: --out FILE keeps the result")
    if options.json_output:
        print(json.dumps({"heads": [report(r.path, a) for r, a in zip(records[1:], alignments, strict=True)]}))


def sentence(name: str, a: HeadAlignment) -> str:
    """One alignment with the deviation of each value."""
    return (
        f"{name}: heading {math.degrees(a.heading_rad):.2f} ± {math.degrees(a.heading_std_rad):.2f} degrees, "
        f"camera at x {a.x_m:.3f}, y {a.y_m:.3f} m (± {a.position_std_m:.3f} m where people met), "
        f"clock {a.clock_s:+.3f} ± {a.clock_std_s:.3f} s; people met for {a.shared_s:.0f} s, "
        f"{100 * a.residual_m:.1f} cm apart"
    )


def report(path: Path, a: HeadAlignment) -> dict[str, Any]:
    """One alignment for ``--json``."""
    return {
        "head": str(path),
        "heading_deg": math.degrees(a.heading_rad),
        "heading_std_deg": math.degrees(a.heading_std_rad),
        "x_m": a.x_m,
        "y_m": a.y_m,
        "position_std_m": a.position_std_m,
        "start_s": a.clock_s,
        "start_std_s": a.clock_std_s,
        "residual_m": a.residual_m,
        "shared_s": a.shared_s,
    }


def _records(heads: Sequence[Path], config: Config, console: PlainConsole) -> list[HeadRecord]:
    columns = TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()
    records = []
    with Progress(*columns, console=console, transient=True) as progress:
        for head in heads:
            task = progress.add_task(f"tracking {head.name}", total=None)
            records.append(record_head(head, config, lambda task=task: progress.advance(task)))  # type: ignore[misc]
            progress.update(task, total=1, completed=1)
    return records
