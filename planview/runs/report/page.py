"""``report.html``: one self-contained page about a run."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import JsonValue

from calib.errors import InputError
from calib.types import F64
from planview.analytics.clock import Clock
from planview.analytics.events import Event, read_events
from planview.pipeline.info import CameraInfo
from planview.runs.info import RunInfo, read_run_info, write_result
from planview.runs.report import plots
from planview.trajectories.table import Trajectories, read_tracks

_NOT_SHOWN = {"view_m", "world_SE3_left", "name", "at_m", "heads"}
"""Of camera and floor, what is drawn and not listed."""
_UNITS = {"s": "s", "ms": "ms", "m": "m", "px": "px", "deg": "°", "mps": "m/s"}
PEOPLE_MAX = 200
"""Rows of the table of people; tracks.csv has them all."""


class NamedFigure(NamedTuple):
    """A name and its value, ready to print."""

    name: str
    value: str


class Picture(NamedTuple):
    """A PNG as a data URI."""

    title: str
    data: str
    note: str = ""


class _Material(NamedTuple):
    """What the folder holds; empty where a file is missing."""

    info: RunInfo
    has_run: bool
    tracks: Trajectories
    clock: Clock
    events: list[Event]
    counts: dict[str, Any]
    evaluation: dict[str, Any]


def write_report(folder: Path, evaluation: dict[str, Any] | None = None) -> Path:
    """Write ``report.html`` from run.json, tracks.csv, events.csv, counts.json and evaluation.json.

    Only tracks.csv must be there; whatever else is missing is left out of the page. The page makes no outside requests.

    Args:
        folder: output folder of a run.
        evaluation: ``Evaluation.to_json()``; ``evaluation.json`` of the folder where not given.
    Returns:
        The path of the page.
    Raises:
        InputError: no tracks.csv, or a file that is not what its name says.
        WorkError: the page cannot be written.
    """
    page = _render(_material(folder, evaluation), folder)
    path = folder / "report.html"
    write_result(path, page)
    return path


def _material(folder: Path, evaluation: dict[str, Any] | None) -> _Material:
    run, events = folder / "run.json", folder / "events.csv"
    info = read_run_info(run) if run.is_file() else RunInfo()
    tracks = read_tracks(folder / "tracks.csv")
    return _Material(
        info,
        run.is_file(),
        tracks,
        Clock(tracks, 30.0),
        read_events(events) if events.is_file() else [],
        _json(folder / "counts.json") or dict(info.counts),
        _json(folder / "evaluation.json") if evaluation is None else evaluation,
    )


def _json(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected JSON, found {error}") from error
    if not isinstance(value, dict):
        raise InputError(f"{path}: expected a JSON object, found {type(value).__name__}")
    return value


def _render(material: _Material, folder: Path) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("planview.runs.report", ".")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    info = material.info
    people = _people(material)
    return environment.get_template("report.html.j2").render(
        name=Path(info.input).name or folder.resolve().name,
        info=info,
        has_run=material.has_run,
        tiles=_tiles(material),
        pictures=_pictures(material),
        counts=_count_rows(_rules(material)),
        evaluation=_evaluation_rows(material.evaluation),
        errors=material.evaluation.get("significant_error_list") or [],
        people=people[:PEOPLE_MAX],
        more_people=max(0, len(people) - PEOPLE_MAX),
        camera=_camera_rows(info),
        settings=_settings(info.config),
    )


def _tiles(material: _Material) -> list[dict[str, str]]:
    info, tracks = material.info, material.tracks
    confirmed = np.unique(tracks.track_id[tracks.state == "confirmed"])
    tiles = [{"label": "people", "value": f"{len(confirmed)}"}]
    tiles.append({"label": "seconds recorded", "value": f"{_end_s(material):.1f}"})
    if material.has_run:
        tiles.append({"label": "frames read", "value": f"{info.frames_read}"})
        tiles.append({"label": "frames skipped", "value": f"{info.frames_skipped}"})
        if info.elapsed_s > 0:
            tiles.append({"label": "frames per second", "value": f"{info.frames_read / info.elapsed_s:.1f}"})
    if info.floor is not None:
        tiles.append({"label": "camera height", "value": f"{info.floor.height_m:.2f} m"})
    total = (material.evaluation.get("significant_errors") or {}).get("total")
    if total is not None:
        tiles.append({"label": "significant errors", "value": f"{total}"})
    return tiles


def _n_frames(material: _Material) -> int:
    last = int(material.tracks.frame.max()) + 1 if len(material.tracks) else 0
    return max(last, material.info.frames_read + material.info.frames_skipped)


def _end_s(material: _Material) -> float:
    return material.clock.span(_n_frames(material)).duration_s if _n_frames(material) else 0.0


def _rules(material: _Material) -> dict[str, Any]:
    rules = material.counts.get("rules")
    return rules if isinstance(rules, dict) else {}


def _pictures(material: _Material) -> list[Picture]:
    tracks, rules = material.tracks, _rules(material)
    shown = tracks.where((tracks.state != "tentative") & np.isfinite(tracks.x_m) & np.isfinite(tracks.y_m))
    confirmed = shown.where(shown.state == "confirmed")
    pictures = []
    if len(shown):
        note = "Each person from the dot to the square; dotted where only predicted."
        pictures.append(_picture("Floor", plots.floor_plot(shown, material.info.rig, rules), note))
    if len(confirmed):
        note = f"Time that people spent in each cell of {plots.HEAT_CELL_M:.1f} m."
        pictures.append(_picture("Heat map", plots.heat_plot(confirmed, material.clock.frame_s), note))
    if _n_frames(material):
        frames = np.arange(_n_frames(material), dtype=np.int64)
        pictures.append(_picture("People over time", plots.people_plot(tracks, material.clock.at(frames), frames)))
    stages = {stage: ms for stage, ms in material.info.stages_ms.items() if ms is not None}
    if stages:
        pictures.append(_picture("Time per stage", plots.stage_plot(stages)))
    return pictures + _count_pictures(material, rules)


def _count_pictures(material: _Material, rules: dict[str, Any]) -> list[Picture]:
    end_s = material.clock.span(max(1, _n_frames(material))).end_s
    pictures = []
    crossings = {
        name: [(e.timestamp_s, e.direction) for e in material.events if e.rule == name]
        for name, rule in rules.items()
        if rule.get("kind") == "tripwire"
    }
    if crossings:
        pictures.append(_picture("Crossings over time", plots.crossings_plot(crossings, end_s)))
    series = {name: rule.get("occupancy") or rule.get("length") for name, rule in rules.items()}
    known = {name: changes for name, changes in series.items() if changes}
    if known:
        pictures.append(_picture("Occupancy and queues", plots.occupancy_plot(known, end_s)))
    return pictures


def _picture(title: str, png: bytes, note: str = "") -> Picture:
    return Picture(title, "data:image/png;base64," + base64.b64encode(png).decode("ascii"), note)


def _count_rows(rules: dict[str, Any]) -> list[dict[str, str]]:
    rows = []
    for name, rule in rules.items():
        figures = [f"{_words(k)} {_figure(v)}" for k, v in rule.items() if isinstance(v, int | float)]
        rows.append({"name": name, "kind": str(rule.get("kind", "")), "text": ", ".join(figures)})
    return rows


def _evaluation_rows(evaluation: dict[str, Any]) -> list[NamedFigure]:
    rows = [
        NamedFigure(_words(k), _figure(v)) for k, v in evaluation.items() if v is None or isinstance(v, int | float)
    ]
    errors = evaluation.get("significant_errors") or {}
    return rows + [
        NamedFigure(f"significant errors, {_words(kind)}", _figure(number)) for kind, number in errors.items()
    ]


def _people(material: _Material) -> list[list[str]]:
    """One row per person ever confirmed, in the order of the template's columns."""
    tracks = material.tracks.where(material.tracks.state == "confirmed")
    times = material.clock.at(tracks.frame)
    rows = []
    for track_id in np.unique(tracks.track_id):
        mine = tracks.track_id == track_id
        when = times[mine]
        way = _way_m(np.column_stack([tracks.x_m[mine], tracks.y_m[mine]]), when)
        span = float(when[-1] - when[0])
        height = tracks.height_m[mine]
        known = height[np.isfinite(height)]
        rows.append([
            str(track_id), f"{when[0]:.1f}", f"{when[-1]:.1f}", f"{mine.sum() * material.clock.frame_s:.1f}",
            f"{way:.1f}" if np.isfinite(way) else "", f"{way / span:.2f}" if span > 0 and np.isfinite(way) else "",
            f"{np.median(known):.2f}" if len(known) else "",
        ])  # fmt: skip
    return rows


def _way_m(xy: F64, times: F64) -> float:
    """Length of a way from places half a second apart, so that noise does not add up [m]."""
    ticks = np.floor((times - times[0]) / 0.5)
    picked = xy[np.concatenate([[True], np.diff(ticks) > 0])]
    return float(np.hypot(*np.diff(picked, axis=0).T).sum())


def _camera_rows(info: RunInfo) -> list[NamedFigure]:
    cameras = (info.rig.heads or [info.rig]) if info.rig is not None else []
    rows = []
    for part in (*cameras, info.floor):
        if part is None:
            continue
        head = f"{part.name}: " if isinstance(part, CameraInfo) and part.name else ""
        for name, value in part.model_dump(exclude=_NOT_SHOWN).items():
            if value is not None:
                rows.append(NamedFigure(head + _words(name), _figure(value)))
    return rows


def _settings(config: dict[str, JsonValue]) -> list[dict[str, Any]]:
    """Tables of the configuration; values outside of any table come first, opened."""
    single = [NamedFigure(key, _figure(value)) for key, value in config.items() if not isinstance(value, dict)]
    tables: list[dict[str, Any]] = [{"name": "general", "open": True, "rows": single}] if single else []
    for key, value in config.items():
        if isinstance(value, dict):
            tables.append({"name": key, "open": False, "rows": [NamedFigure(k, _figure(v)) for k, v in value.items()]})
    return tables


def _words(name: str) -> str:
    """A key as people read it, its unit in brackets: mean_dwell_s -> mean dwell [s]."""
    words = name.split("_")
    if len(words) > 1 and words[-1] in _UNITS:
        words[-1] = f"[{_UNITS[words[-1]]}]"
    return " ".join(words)


def _figure(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"
    return value if isinstance(value, str) else json.dumps(value)
