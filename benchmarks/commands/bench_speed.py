"""``python -m benchmarks speed``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from benchmarks.commands.options import JsonFlag
from benchmarks.curve_plot import write_plot
from benchmarks.curves import CURVES
from benchmarks.speed import LIMITS, USUAL, Speed, measure
from calib.errors import InputError
from calib.io import write_whole

Part = Literal[
    "engine",
    "foreground",
    "after-disparity",
    "single",
    "start",
    "worst-case",
    "full-resolution",
    "curves",
    "pixels",
    "disparities",
    "rate",
    "people",
]


@Parameter(name="*")
@dataclass(frozen=True)
class SpeedOptions:
    """What is timed, and what becomes of the figures."""

    recording: Path | None = None
    """A stereo recording; the committed clip by default. Its first frames should show no person."""
    frames: int = 200
    """Medians over so many frames, after 100 in which the background is learned."""
    part: Annotated[Sequence[Part], Parameter(negative="", show_default=False)] = ()
    """Measure only this; repeat for more: engine, foreground, after-disparity, single (one camera beside MOG2: human
    model with five people at 320x240, eight and thirty at 640x480, ellipses with eight at 480x360 and thirty at
    640x480), start (of planview run to its first frame, over 100 frames of the yardstick in colour on all cores),
    worst-case (eight people near the camera, rendered once), full-resolution (the real overhead pair of the shared
    recordings), curves (pixels, disparities, rate, people: each can be named; one core). All but the curves when not
    given."""
    set_: Annotated[Sequence[str], Parameter(name="--set", negative="", show_default=False)] = ()
    """Set one parameter of the engine, like analysis.width_px=1280; repeat for more."""
    out: Path | None = None
    """Keep the figures in this JSON file, beside those of other parts that it holds."""
    plot: Path | None = None
    """Draw the curves to this PNG or SVG file."""
    memory: Path | None = None
    """Figures of python -m benchmarks memory --json, whose course is drawn too."""
    against: Path | None = None
    """Compare with the figures kept in this file: a ratio differs when its quartiles lie apart."""
    json_output: JsonFlag = False
    """Print one JSON object."""


def bench_speed(*, options: SpeedOptions | None = None) -> None:
    """Time the engine side by side with plain OpenCV on the same frames.

    The yardstick is OpenCV's remap and StereoSGBM of both cameras at the recorded size, with no setting of the engine:
    three-way, block 5, 64 disparities up to 640 px, 128 beyond.

    Example: python -m benchmarks speed --json

    Example of an overhead camera at full resolution: python -m benchmarks speed --recording my_recording --frames 100
    --part engine --set rectify.working_px=0 --set analysis.width_px=1280
    """
    o = options or SpeedOptions()
    if o.frames < 10:
        raise InputError(f"--frames: expected at least 10, found {o.frames}")
    earlier = _kept(o.against) if o.against else None
    messages = Console(stderr=True, markup=False)
    speed = measure(o.recording, o.frames, lambda text: messages.print(text, highlight=False), _parts(o.part), o.set_)
    if o.out is not None:
        speed = _keep(speed, o.out)
    if o.plot is not None:
        write_plot(o.plot, speed.ratios, speed.quartiles, _course(o.memory))
    if o.json_output:
        print(json.dumps(asdict(speed), indent=2))
    else:
        print_speed(speed, Console(markup=False), earlier)


def _keep(speed: Speed, out: Path) -> Speed:
    """Written beside the parts that the file holds; all of them."""
    speed = merged(_kept(out), speed) if out.is_file() else speed
    write_whole(out, json.dumps(asdict(speed), indent=2) + "\n")
    return speed


def _kept(path: Path) -> Speed:
    try:
        return Speed(**json.loads(path.read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{path}: expected figures that --out kept, found {error}") from error


def _parts(asked: Sequence[Part]) -> Sequence[str]:
    named = [name for part in asked or USUAL for name in (CURVES if part == "curves" else (part,))]
    return list(dict.fromkeys(named))


def merged(before: Speed, now: Speed) -> Speed:
    """What was measured now, and of before what was not measured again."""
    return Speed(*({**asdict(before)[part.name], **asdict(now)[part.name]} for part in fields(Speed)))


def _course(path: Path | None) -> list[tuple[int, float]]:
    """Frames and megabytes of a kept figure of memory."""
    if path is None:
        return []
    try:
        return [(int(frame), float(megabytes)) for frame, megabytes in json.loads(path.read_text())["course"]]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path}: expected figures of python -m benchmarks memory --json, found {error}") from error


def print_changes(speed: Speed, before: Speed, console: Console) -> None:
    """What is faster or slower than before; quartiles that overlap are noise."""
    for name, (low, high) in speed.quartiles.items():
        if name not in before.quartiles:
            continue
        old_low, old_high = before.quartiles[name]
        word = "slower" if low > old_high else "faster" if high < old_low else "the same within noise"
        old, now = before.ratios | before.times_ms, speed.ratios | speed.times_ms
        ratio = f"{old[name]:.3f} -> {now[name]:.3f}"
        console.print(f"{name.replace('_', ' ')}: {ratio}, {word}", highlight=False)


def print_speed(speed: Speed, console: Console, earlier: Speed | None = None) -> None:
    """The times of the stages, the ratios beside what they must keep, and what changed since an earlier measurement."""
    if speed.stages_ms:
        stages = Table(title=f"{speed.details['recording']}, {speed.details.get('image', '')}: median times")
        stages.add_column("stage")
        stages.add_column("ms", justify="right")
        for name, value in speed.stages_ms.items():
            stages.add_row(name, f"{value:.2f}")
        console.print(stages)
    console.print(_figures("ours / OpenCV, same frames, same run", "ratio", speed.ratios, speed))
    if speed.times_ms:
        console.print(_figures("one frame of a tracker of one camera, one core", "ms", speed.times_ms, speed))
    for name, detail in speed.details.items():
        if isinstance(detail, float):
            console.print(f"{name.replace('_', ' ')}: {detail:g}", highlight=False)
    if earlier is not None:
        print_changes(speed, earlier, console)


def _figures(title: str, unit: str, medians: dict[str, float], speed: Speed) -> Table:
    """Medians beside their quartiles and limits."""
    table = Table(title=title)
    for column in (unit, "median", "quartiles", "at most"):
        table.add_column(column, justify="left" if column == unit else "right")
    for name, value in medians.items():
        spread = " to ".join(f"{quartile:.3f}" for quartile in speed.quartiles.get(name, ())) or "-"
        limit = f"{LIMITS[name]:g}" if name in LIMITS else "-"
        table.add_row(name.replace("_", " "), f"{value:.3f}", spread, limit)
    return table
