"""``planview evaluate`` and ``count``: tracks against truth, and what they count."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calib.errors import printable
from planview.api import scores
from planview.api.result import aligned
from planview.commands.shell import JSON, Call, command
from planview.evaluation.result import Evaluation
from planview.output.report.page import evaluation_rows
from planview.output.run_folder import RunFolder
from planview.output.words import figure_text
from planview.trajectories.formats import file_pairs

PUBLISHED = ("hota", "misses", "false_positives", "fragmentations", "mostly_tracked", "mostly_lost")
"""What papers print besides MOTA, IDF1, id switches and MOTP, the position error, which are in the headline."""
HEADLINE = (
    "mota", "idf1", "switches", "people", "tracked_people", "motp_m", "position_error_mean_m",
    "height_error_mean_m", "truth_rows", "ignored_rows",
)  # fmt: skip
"""Figures that stand above the table."""


@command(scores.evaluate, own=JSON | {"all": "Print all figures, and errors by group."})
def evaluate(call: Call) -> None:
    """Example: planview evaluate out

    Example of another truth: planview evaluate out/tracks.csv recording/truth.csv --json

    Example on PETS: planview evaluate out/tracks.csv gt.txt --gate 1 --align --frames 0:399

    Example on MOTChallenge: planview evaluate trackers/mine gt --boxes --fps 25
    """
    result: Evaluation = call()
    pairs = file_pairs(call["tracks"], call["truth"] or scores.truth_of(call["tracks"]))
    results = result.recordings or {pairs[0].name: result}
    each = {
        pair.name: {"tracks": str(pair.tracks), "refined": _refined(pair.tracks), **results[pair.name].to_json()}
        for pair in pairs
    }
    if call.prints_json({**result.to_json(), "recordings": each} if len(each) > 1 else each[pairs[0].name]):
        return
    for pair in pairs:
        kind = {True: " (refined)", False: " (online)", None: ""}[_refined(pair.tracks)]
        print_evaluation(results[pair.name], f"{pair.tracks}{kind}", every=call.own["all"])
    if len(pairs) > 1:
        print_evaluation(result, f"{len(pairs)} recordings together", listed=False, every=call.own["all"])


def _refined(tracks: Path) -> bool | None:
    """Whether the tracks of a run are refined; None without a run.json."""
    run = RunFolder.around(tracks) if tracks.name in ("tracks.csv", "tracks_online.csv") else None
    return None if run is None else tracks.name == "tracks.csv" and run.info.refined


def print_evaluation(result: Evaluation, title: str, *, listed: bool = True, every: bool = False) -> None:
    """The main figures in a line, those that papers print as a table, then every significant error; with ``every`` all
    figures, and position errors by group."""
    values = result.to_json()
    shown = values.keys() - HEADLINE if every else PUBLISHED
    lines = [f"{title}: {result.headline}"]
    lines.append(aligned(evaluation_rows({name: value for name, value in values.items() if name in shown})))
    if every:
        lines += [GROUPS_NOTE, _groups_text(values)]
    if result.alignment is not None:
        lines.append(f"tracks laid over the truth: {values['alignment']}")
    for error in result.significant if listed else []:
        lines.append(f"frame {error.frame}: {error.kind}: {error.who}: {error.note}")
    print(printable("\n".join(lines)))


GROUPS_NOTE = (
    "id switches: every id change, including brief ones between people in contact; lasting identity changes: two when "
    "two people swap ids, and ids that pass to another person; at most: with 95 % confidence"
)


def _groups_text(values: dict[str, Any]) -> str:
    rows = [("group", "positions", "matched [%]", "position error [m]", "standard deviation [m]")]
    for key, text in (("by_distance", "{} m away"), ("by_visibility", "{} visible"), ("by_people", "{} people")):
        for row in values[key]:
            if row["truth_rows"]:
                matched = f"{100 * row['matches'] / row['truth_rows']:.1f}"
                mean, std = (figure_text(row[f"position_error_{name}_m"]) for name in ("mean", "std"))
                rows.append((text.format(row["group"]), f"{row['truth_rows']:,}", matched, mean, std))
    return aligned(rows)


@command(scores.count, options=["rules"], own=JSON)
def count(call: Call) -> None:
    """Example: planview count out/tracks.csv --rules rules.toml --json

    Example of rules.toml:
        [[tripwire]]
        name = "door"
        from_m = [0, 2]
        to_m = [1, 2]
    """
    result = call()
    if not call.prints_json(result.to_json()):
        print(result)
