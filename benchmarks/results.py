"""``docs/results.md`` from the JSON of suite and ablation."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.suite import JUDGING_SEED
from calib.errors import InputError
from calib.text import reason
from planview.evaluation.result import KINDS

WAYS = {"online": "online", "refined": "refined (`planview edit --refine`)", "peer": "naive engine"}
"""Ways of tracking, as the tables call them."""
SAME_S = 2.0
"""A refined error of the same kind and person begins within so much of the online one [s]."""
PAPER = "| Harville 2002, section 5 | about 10 | 1 | | 0, 0, 1, 0 | | | 18 ± 14 | | |"


@dataclass(frozen=True)
class Failure:
    """A significant error of the online tracks.

    Attributes:
        scene: its entry in the suite's JSON.
        error: its entry in the scene's list of errors.
        refined: whether the refined tracks still have it; None when these were not scored.
        picture: file name of its picture; None for one without.
    """

    scene: dict[str, Any]
    error: dict[str, Any]
    refined: bool | None
    picture: str | None = None


def load_report(path: Path, key: str) -> dict[str, Any]:
    """A JSON file of ``python -m benchmarks``.

    Args:
        key: what must be in it ("online" of the suite, "variants" of the ablation).
    Raises:
        InputError: unreadable, cut off, or something else.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"{path}: expected the JSON of a bench, found {reason(error)}") from error
    if not isinstance(found, dict) or key not in found or "commit" not in found:
        raise InputError(f"{path}: expected the JSON of a bench with {key!r}, found {_names(found)}")
    return found


def _names(found: Any) -> str:
    return ", ".join(found) or "nothing" if isinstance(found, dict) else type(found).__name__


def failures(suite: dict[str, Any]) -> list[Failure]:
    """All significant errors of the online tracks, in the order of scenes and frames."""
    refined = suite.get("refined")
    later = {(s["scene"], s["seed"]): s for s in refined["scenes"]} if refined else {}
    found = []
    for scene in suite["online"]["scenes"]:
        rest = later.get((scene["scene"], scene["seed"]))
        for error in scene["significant_error_list"]:
            found.append(Failure(scene, error, None if rest is None else _has(rest, error, scene)))
    return found


def _has(scene: dict[str, Any], error: dict[str, Any], online: dict[str, Any]) -> bool:
    frames = SAME_S * online["frames"] / online["duration_s"]
    return any(
        (e["kind"], e["truth_id"]) == (error["kind"], error["truth_id"]) and abs(e["frame"] - error["frame"]) <= frames
        for e in scene["significant_error_list"]
    )


def shown(found: Sequence[Failure], limit: int) -> list[Failure]:
    """At most so many failures: of every kind in turn those that last longest."""
    by_kind = [
        sorted((f for f in found if f.error["kind"] == kind), key=lambda f: -(f.error["duration_s"] or 0.0))
        for kind in ("swapped", "lost", "false_track", "missed")
    ]
    turns = [f for turn in range(len(found)) for of_kind in by_kind for f in of_kind[turn : turn + 1]]
    chosen = turns[:limit]
    return [f for f in found if any(f is c for c in chosen)]


def results_page(suite: dict[str, Any], ablation: dict[str, Any] | None, found: Sequence[Failure]) -> str:
    """The page; ``found`` are all failures, those with a picture among them."""
    parts = [_head(suite), _ways(suite), _scenes(suite)]
    parts += [_ablation(ablation)] if ablation else []
    return "\n\n".join([*parts, _failures(found)]) + "\n"


def _head(suite: dict[str, Any]) -> str:
    seeds = ", ".join(f"{s} ({'judging' if s >= JUDGING_SEED else 'worked on'})" for s in suite["seeds"])
    return (
        "# Results\n\nWritten by `python -m benchmarks results`; figures of `suite --refine --peer` and "
        f"`ablation`.\nSeeds: {seeds}. Commit {suite['commit']}, {suite['date']}. Every seed is another "
        "recording of every scene;\nseeds from 100 on are run once and never worked on. What is an error: "
        "`planview/evaluation/significant.py`."
    )


def _ways(suite: dict[str, Any]) -> str:
    lines = [
        "## Challenge suite\n",
        "| tracks | minutes | significant errors per 10 min | strict per 10 min | lost, missed, swapped, false | MOTA "
        "| IDF1 | position cm | height cm | switches |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for way, name in WAYS.items():
        if way in suite:
            t = suite[way]["totals"]
            kinds = ", ".join(str(t["significant"][kind]) for kind in KINDS)
            lines.append(
                f"| {name} | {t['minutes']:.1f} | {t['significant_per_10_min']:.1f} | {t['strict_per_10_min']:.1f} "
                f"| {kinds} | {number(t['mota'], 1, 3)} | {number(t['idf1'], 1, 3)} "
                f"| {number(t['position_error_m'])} ± {number(t['position_std_m'])} "
                f"| {number(t['height_error_m'])} | {t['switches']} |"
            )
    return "\n".join([*lines, PAPER])


def _scenes(suite: dict[str, Any]) -> str:
    ways = [way for way in WAYS if way in suite]
    lines = [
        "### By scene\n",
        f"| scene | seed | {' | '.join(f'errors, {way}' for way in ways)} | MOTA | position cm |",
    ]
    lines.append("|---" * (len(ways) + 4) + "|")
    for scenes in zip(*(suite[way]["scenes"] for way in ways), strict=True):
        first = scenes[0]
        counts = " | ".join(str(scene["significant_errors"]["total"]) for scene in scenes)
        figures = f"{number(first['mota'], 1, 3)} | {number(first['position_error_mean_m'])}"
        lines.append(f"| {first['scene']} | {first['seed']} | {counts} | {figures} |")
    return "\n".join(lines)


def _ablation(ablation: dict[str, Any]) -> str:
    lines = [
        "## Ablation\n",
        f"{len(ablation['recordings'])} recordings: {', '.join(ablation['recordings'])}. Commit {ablation['commit']}, "
        f"{ablation['date']}. In brackets 95 % bootstrap intervals over recordings.\n",
        "| variant | `--set` | significant errors per 10 min | change | the paper's errors in 10 min | misses % "
        "| false positives % | position cm |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for v in ablation["variants"]:
        paper = v["paper_significant_errors"]
        figures = [interval(v["per_10_min"]), interval(v["change_per_10_min"]), "" if paper is None else str(paper)]
        figures += [interval(v[name], 100) for name in ("misses", "false_positives", "position_error_m")]
        settings = ", ".join(f"`{s}`" for s in v["settings"])
        lines.append(f"| {v['variant']} | {settings} | {' | '.join(figures)} |")
    return "\n".join(lines)


def _failures(found: Sequence[Failure]) -> str:
    kinds = ", ".join(f"{sum(f.error['kind'] == kind for f in found)} {kind}" for kind in KINDS)
    pictured = [f for f in found if f.picture]
    lines = [f"## Failures of the online tracks\n\n{len(found)} in all ({kinds}); {len(pictured)} with a picture."]
    if pictured:
        lines[0] += (
            " Left the floor from 2 s before to 3 s after the\nbeginning (truth grey, the person concerned black, "
            "tracks coloured, the camera's view green), right the image."
        )
    for f in found:
        e, after = (
            f.error,
            "" if f.refined is None else (", still there" if f.refined else ", gone") + " after refinement",
        )
        where = f"{f.scene['scene']} ({f.scene['seed']}), frame {e['frame']}"
        text = f"**{e['kind']}**, {where}: person {e['truth_id']}, track {e['track_id']}: {e['note']}{after}"
        lines.append(f"{text}\n\n![{e['kind']}, {where}](results/{f.picture})" if f.picture else f"- {text}")
    return "\n\n".join(lines)


def interval(values: Sequence[float | None], factor: float = 1.0) -> str:
    """A figure with its interval; "-" without one."""
    value, low, high = values
    return "-" if value is None else f"{factor * value:.1f} [{number(low, factor)}, {number(high, factor)}]"


def number(value: float | None, factor: float = 100.0, digits: int = 1) -> str:
    """A figure, by default metres as centimetres; "-" for one that is not known."""
    return "-" if value is None else f"{factor * value:.{digits}f}"
