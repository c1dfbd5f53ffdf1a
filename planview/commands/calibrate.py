"""``planview calibrate``: what its commands print."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from rich.table import Table

from calib.board.solve import BoardCalibration
from planview.api import calibrate_pair as api
from planview.commands.options import say
from planview.commands.shell import JSON, Call, command
from planview.evaluation.paths import RigAlignment
from planview.output.progress import PlainConsole


@command(api.align, own=JSON)
def calibrate_align(call: Call) -> None:
    found, files = call()
    names = [Path(sensor) for sensor in call["sensors"][1:]]
    for path, alignment in zip(names, found, strict=True):
        say(sentence(path.name, alignment))
    say(f"wrote {files[0]}" if files else "no rigs.toml written: --out FILE keeps the result")
    call.prints_json({"sensors": [report(path, one) for path, one in zip(names, found, strict=True)]})


def sentence(name: str, a: RigAlignment) -> str:
    """One alignment with the deviation of each value."""
    return (
        f"{name}: heading {math.degrees(a.heading_rad):.2f} ± {math.degrees(a.heading_std_rad):.2f} degrees, "
        f"camera at x {a.x_m:.3f}, y {a.y_m:.3f} m (± {a.position_std_m:.3f} m where people met), "
        f"clock {a.clock_s:+.3f} ± {a.clock_std_s:.3f} s; people met for {a.shared_s:.0f} s, "
        f"{100 * a.residual_m:.1f} cm apart"
    )


def report(path: Path, a: RigAlignment) -> dict[str, Any]:
    """One alignment for ``--json``."""
    values = {name: getattr(a, name) for name in ("x_m", "y_m", "position_std_m", "residual_m", "shared_s")}
    heading = {"heading_deg": math.degrees(a.heading_rad), "heading_std_deg": math.degrees(a.heading_std_rad)}
    return {"sensor": str(path), **heading, **values, "start_s": a.clock_s, "start_std_s": a.clock_std_s}


@command(api.board, options=["square"], own=JSON)
def calibrate_board(call: Call) -> None:
    found, files = call()
    _print_summary(found)
    say(f"wrote {', '.join(map(str, files))}")
    call.prints_json(_as_json(found, files))


def _print_summary(result: BoardCalibration) -> None:
    rig = result.rig
    std = result.std
    for one in result.rejected:
        say(f"not used: {one.name}: {one.why}")
    title = f"{result.board.name}, {len(result.views)} pairs, {rig.left.width}x{rig.left.height}"
    table = Table("", "left", "right", title=title)
    for key in ("fx", "fy", "cx", "cy"):
        cells = [f"{getattr(getattr(rig, s), key):.2f} ± {std[f'{s} {key}']:.2f} px" for s in ("left", "right")]
        table.add_row(key, *cells)
    table.add_row("image covered", *(f"{100 * result.coverage_share(s):.0f} %" for s in ("left", "right")))
    PlainConsole(stderr=True).print(table)
    for lens in result.lenses:
        chosen = "  <- chosen" if lens is result.chosen_lens else ""
        say(f"{lens.name}: {lens.held_out_px:.4f} px on views left out{chosen}")
    say(
        f"baseline {1000 * rig.baseline_m:.2f} ± {1000 * std['baseline']:.2f} mm "
        f"({result.baseline_squares:.3f} squares), stereo rms {result.fit.rms_px:.3f} px, "
        f"rows after rectification {result.row_rms_px:.3f} px"
    )


def _as_json(result: BoardCalibration, files: list[Path]) -> dict[str, Any]:
    return {
        "stereo_rms_px": result.fit.rms_px,
        "baseline_m": result.rig.baseline_m,
        "baseline_squares": result.baseline_squares,
        "baseline_std_m": result.std["baseline"],
        "views_used": len(result.views),
        "views_rejected": [{"name": one.name, "why": one.why} for one in result.rejected],
        "row_rms_px": result.row_rms_px,
        "board": result.board.name,
        "model": result.rig.left.model,
        "lenses": [{"name": one.name, "held_out_px": one.held_out_px} for one in result.lenses],
        "views": {v.name: float(r) for v, r in zip(result.views, result.fit.view_rms_px(), strict=True)},
        "std": result.std,
        "coverage": {side: result.coverage_share(side) for side in ("left", "right")},
        "files": [str(path) for path in files],
    }


@command(api.convert, names={"source": "IN", "target": "OUT"}, own=JSON)
def calibrate_convert(call: Call) -> None:
    rig, files = call()
    say(f"{rig.source}: baseline {rig.baseline_m:.4f} m, {rig.left.width}x{rig.left.height}")
    say(f"wrote {', '.join(map(str, files))}")
    found = {"source": rig.source, "baseline_m": rig.baseline_m, "width": rig.left.width, "height": rig.left.height}
    call.prints_json(found | {"model": rig.left.model, "files": [str(path) for path in files]})


@command(api.ui)
def calibrate_ui(call: Call) -> None:
    call()
