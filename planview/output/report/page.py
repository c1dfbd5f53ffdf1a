"""``report.html`` of a run: one file, which needs no other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import JsonValue

from calib.errors import InputError, WorkError
from calib.types import F64
from planview.counting.events import way_words
from planview.drawing.style import page_of
from planview.engine.info import CameraInfo, FloorInfo
from planview.evaluation.result import LABELS, Evaluation
from planview.output.folder import RunInfo, write_result
from planview.output.report import plots
from planview.output.report.plots import Picture, picture
from planview.output.report.snapshots import DECISIONS_MAX, ERRORS_MAX, read_decision_log, scene_pictures
from planview.output.run_folder import RunFolder
from planview.output.words import figure_text, figures_of, flat_settings, words_of
from planview.trajectories.plot import person_hex
from planview.trajectories.table import Trajectories

SCORED_ROWS_MAX = 60_000
"""Rows of tracks and truth up to which they are scored: more would take longer than the page."""


def scores_of(results: RunFolder) -> Evaluation | None:
    """The scores of the frames that were tracked; None without truth."""
    truth = results.truth
    if truth is None or not results.has_run or len(results.tracks) + len(truth) > SCORED_ROWS_MAX:
        return None
    try:
        return results.evaluate()
    except (InputError, WorkError):
        return None  # truth in another world, or without positions: the page does without


_NOT_SHOWN = {"view_m", "world_SE3_left", "name", "at_m", "sensors", "center_px", "focal_v_px"}
"""Fields of camera and floor that the page shows as a picture."""
PEOPLE_MAX = 200
"""Rows of the table of people; tracks.csv has them all."""
Figure = tuple[str, str]
"""A name and its value, ready to print."""


def write_report(folder: Path, truth: Path | None = None) -> Path:
    """Write ``report.html`` from the files of a run's folder, with pictures from its recording; it makes no outside
    requests.

    Only tracks.csv must be there; whatever else is missing, the recording too, is left out of the page.

    Args:
        truth: file of the true people; ``truth.csv`` of the recording where not given.
    Raises:
        InputError: no tracks.csv, or a file that cannot be read.
        WorkError: the page cannot be written.
    """
    results = RunFolder(folder, truth).read_all()
    info = results.info
    scores = scores_of(results)
    errors = () if scores is None else scores.significant
    evaluation = {} if scores is None else scores.to_json()
    recorded_s = 0.0
    if results.n_frames:
        recorded_s = results.clock.span(results.n_frames).duration_s
    page = page_of(
        "planview.output.report",
        "report.html.j2",
        run=results,
        info=info,
        title=Path(info.input).name or results.path.resolve().name,
        recorded_s=recorded_s,
        scenes=scene_pictures(results, errors),
        identities=plots.identity_pictures(results, errors),
        pictures=_pictures(results),
        figures=figures_of,
        evaluation=evaluation,
        scores=evaluation_rows(evaluation),
        errors=errors,
        errors_max=ERRORS_MAX,
        decisions_max=DECISIONS_MAX,
        n_people=len(results.people),
        people=_people(results),
        camera=_camera_rows(info),
        stages={stage: ms for stage, ms in info.stages_ms.items() if ms is not None},
        settings=changed_settings(info.config),
    )
    path = folder / "report.html"
    write_result(path, page)
    return path


def _pictures(results: RunFolder) -> list[Picture]:
    """Pictures of the floor, and of numbers over time."""
    pictures = _curves(results)
    end_s = results.clock.span(max(1, results.n_frames)).end_s
    crossings = _crossings(results)
    if crossings:
        pictures.append(picture("Crossings over time", plots.plot_steps(crossings, end_s, "crossings")))
    inside = {}
    for name, rule in results.rule_counts.items():
        changes = rule.get("occupancy") or rule.get("length")
        if changes:
            inside[name] = changes
    if inside:
        pictures.append(picture("Occupancy and queues", plots.plot_steps(inside, end_s, "people")))
    return pictures


def _curves(results: RunFolder) -> list[Picture]:
    """The panels of ``planview plot``; none where nobody has a place."""
    tracks = results.tracks.where(results.of_people)
    is_on_floor = bool(np.isfinite(tracks.x_m).any())
    if not is_on_floor and not np.isfinite(tracks.box_px).any():
        return []
    pictures = [picture("Paths", plots.plot_run(results, "paths"))]
    if is_on_floor:
        pictures.append(picture("Density", plots.plot_run(results, "density"), keep_colours=True))
    pictures.append(picture("Over time", plots.plot_run(results, "speed", "count")))
    return pictures


def _crossings(results: RunFolder) -> dict[str, list[tuple[float, int]]]:
    """Times [s] and numbers of crossings, by line and direction."""
    crossings = {}
    for name, rule in results.rule_counts.items():
        if rule.get("kind") != "tripwire":
            continue
        for way in ("left_to_right", "right_to_left"):
            events = [event for event in results.events if event.rule == name and event.direction == way]
            times_s = sorted(event.timestamp_s for event in events)
            title = f"{name}, {way_words(way, rule.get('inward'))}"
            crossings[title] = [(0.0, 0), *((time_s, n) for n, time_s in enumerate(times_s, 1))]
    return crossings


def _people(run: RunFolder) -> list[dict[str, Any]]:
    """Colour, decisions, times [s], way [m], mean speed [m/s] and median height [m] of people; empty where unknown."""
    ids = run.people[:PEOPLE_MAX].tolist()
    logs = read_decision_log(run.path / "decisions.csv", set(ids))
    confirmed = run.tracks.where(run.of_people)
    rows = []
    for track_id in ids:
        person = confirmed.where(confirmed.track_id == track_id)
        times_s = run.clock.at(person.frame)
        span_s = float(times_s[-1] - times_s[0])
        way_m = _way_m(person, times_s)
        speed = way_m / span_s if span_s > 0 else math.nan
        heights_m = person.height_m[np.isfinite(person.height_m)]
        height_m = float(np.median(heights_m)) if len(heights_m) else math.nan
        rows.append({
            "track_id": track_id,
            "colour": person_hex(track_id),
            "decisions": logs.get(track_id),
            "first": f"{times_s[0]:.1f}",
            "last": f"{times_s[-1]:.1f}",
            "observed": f"{len(person) * run.clock.frame_s:.1f}",
            "way": _number_text(way_m, ".1f"),
            "speed": _number_text(speed, ".2f"),
            "height": _number_text(height_m, ".2f"),
        })  # fmt: skip
    return rows


def _way_m(person: Trajectories, times_s: F64) -> float:
    """Length of a person's way over places half a second apart, so that noise does not add up."""
    begins = np.diff(np.floor((times_s - times_s[0]) / 0.5)) > 0
    places = person.where(np.concatenate([[True], begins]))
    return float(np.hypot(np.diff(places.x_m), np.diff(places.y_m)).sum())


def _number_text(value: float, form: str) -> str:
    """A number as text; empty where it is NaN."""
    return "" if math.isnan(value) else format(value, form)


def evaluation_rows(evaluation: dict[str, Any]) -> list[Figure]:
    """The scores of an evaluation, ready to print."""
    rows: list[tuple[str, object]] = []
    for name, value in evaluation.items():
        if name != "alignment" and (value is None or isinstance(value, int | float)):
            rows.append((LABELS.get(name) or words_of(name), value))
    for people, facing in evaluation.get("facing", {}).items():
        title = f"facing of {people}:"
        rows.append((f"{title} share shown with an arrow", facing["sure_share"]))
        rows.append((f"{title} share of these not back to front", facing["sure_right_share"]))
        rows.append((f"{title} median difference of these [deg]", facing["median_deg"]))
        rows.append((f"{title} with front and back alike [deg]", facing["median_modulo_180_deg"]))
    for kind, count in evaluation.get("significant_errors", {}).items():
        rows.append((f"significant errors, {words_of(kind)}", count))
    return [(name, figure_text(value)) for name, value in rows]


def _camera_rows(info: RunInfo) -> list[Figure]:
    """Figures of the camera, or of those of several sensors, and of the floor."""
    parts: list[tuple[str, CameraInfo | FloorInfo]] = []
    if info.rig is not None:
        for camera in info.rig.sensors or [info.rig]:
            parts.append((f"{camera.name}: " if camera.name else "", camera))
    if info.floor is not None:
        parts.append(("", info.floor))
    rows = []
    for owner, part in parts:
        for name, value in part.model_dump(exclude=_NOT_SHOWN).items():
            if value is not None:
                rows.append((owner + words_of(name), figure_text(value)))
    return rows


def changed_settings(config: dict[str, JsonValue]) -> list[tuple[str, str, str]]:
    """Parameters that differ from the defaults, their values, and the defaults, ready to print."""
    from planview.engine.config import Config  # takes 2 s and 80 MB

    defaults = flat_settings(Config().model_dump(mode="json"))
    rows = []
    for name, value in flat_settings(config).items():
        default = defaults.get(name)
        if value != default:
            rows.append((name, figure_text(value), figure_text(default)))
    return rows


_WHOLE = ("recording", "opened", "fps", "first_frame", "frames_read", "tracker", "own_parts", "refined", "versions")
_GIVEN: Any = dict.fromkeys((*_WHOLE, "config"), True) | {"rig": {"calibration", "focal_px", "baseline_m", "lens"}}
"""Fields of run.json that runs were given."""


def differing_settings(runs: Sequence[RunInfo]) -> list[tuple[str, list[str]]]:
    """Names of what runs were given and differs between them, with the value of each run, ready to print."""
    tables = [flat_settings(run.model_dump(mode="json", include=_GIVEN)) for run in runs]
    names = dict.fromkeys(name for table in tables for name in table)
    rows = []
    for name in names:
        values = [table.get(name) for table in tables]
        if any(value != values[0] for value in values):
            texts = ["-" if value is None else str(value) for value in values]
            rows.append((name.removeprefix("config."), texts))
    return rows
