"""All scores of tracks against truth, by distance, by visibility and by the number of people, and as JSON."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence as Items
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any, get_args

import numpy as np

from calib.doubt import Finding
from calib.types import F64, I64, Bool
from planview.evaluation.align import FloorAlignment
from planview.evaluation.metrics import (
    ClearScores,
    HotaScores,
    Sequence,
    clear_scores,
    hota_scores,
    idf1,
    joined_rows,
)
from planview.evaluation.significant import ErrorKind, SignificantError, poisson_upper

FEW = 0.5
"""A smaller share of matched rows needs explaining (our choice)."""
PEOPLE_GROUPS = (("0", 0, 0.0), ("1-2", 1, 2.0), ("3-5", 3, 5.0), ("6-9", 6, 9.0), ("10+", 10, math.inf))
"""(name, first, last): numbers of people as table 4 of Zhang et al. 2008 groups them."""


WALKING_MPS = 0.5
"""Speed of the true person above which somebody walks, else stands [m/s]. Shuffling on the spot is slower."""


@dataclass(frozen=True, eq=False)
class FacingErrors:
    """Differences of every match whose track faces somewhere, (K,) each.

    Attributes:
        to_truth_deg: to where the truth faces, 0 to 180; NaN where it has none.
        to_walk_deg: to where the true person moves, 0 to 180; NaN where that is unknown.
        speed_mps: of the true person; NaN where unknown.
        sure: True if front and back differ surely, as everywhere in a table without confidence.
    """

    to_truth_deg: F64
    to_walk_deg: F64
    speed_mps: F64
    sure: Bool

    def to_json(self) -> dict[str, Any]:
        """Figures of walkers and of standers with a true facing: rows, the share that is sure, how many of these are
        not back to front and their median difference [deg], and the median of all with front and back alike; empty
        without any."""
        has_truth = np.isfinite(self.to_truth_deg)
        groups = {"walkers": self.speed_mps > WALKING_MPS, "standers": self.speed_mps <= WALKING_MPS}
        figures = {}
        for name, members in groups.items():
            differences = self.to_truth_deg[members & has_truth]
            sure = self.to_truth_deg[members & has_truth & self.sure]
            if len(differences):
                figures[name] = {
                    "rows": len(differences),
                    "sure_share": len(sure) / len(differences),
                    "sure_right_share": float((sure < 90.0).mean()) if len(sure) else None,
                    "median_deg": float(np.median(sure)) if len(sure) else None,
                    "median_modulo_180_deg": float(np.median(np.minimum(differences, 180.0 - differences))),
                }
        return figures

    @property
    def walkers_deg(self) -> float | None:
        """Median difference of walkers who surely face somewhere to the truth, or where that has no facing, to the
        direction in which they walk; None without any."""
        differences = self.to_truth_deg if np.isfinite(self.to_truth_deg).any() else self.to_walk_deg
        differences = differences[self.sure & (self.speed_mps > WALKING_MPS)]
        differences = differences[np.isfinite(differences)]
        return float(np.median(differences)) if len(differences) else None


@dataclass(frozen=True, eq=False)
class TruthRows:
    """Every truth row that counts, (N,) each.

    Attributes:
        distance_m: from the origin of the truth's floor frame (below the camera in our own recordings) [m]; may be NaN.
        visible: unoccluded fraction.
        people: people that count in the same frame.
        matched: whether a track matches.
        position_error_m: floor distance to it [m]; NaN where there is none.
    """

    distance_m: F64
    visible: F64
    people: I64
    matched: Bool
    position_error_m: F64


DISTANCES_M = (0, 2, 4, 6, 8, 12, math.inf)
"""Edges of the groups by distance: the depth noise of a stereo pair grows with the square of it."""
SHARES = (0, 0.25, 0.5, 0.75, math.nextafter(1, 2))
"""Edges of the groups by visibility; fully visible belongs to the last."""


def breakdown_json(rows: TruthRows) -> dict[str, list[dict[str, Any]]]:
    """Three tables by their keys: truth rows of each group, how many are matched, and their position error [m], None
    without any; without people in a frame there are no rows of it."""
    by_people = []
    for name, low, high in PEOPLE_GROUPS[1:]:
        by_people.append(_group_json(rows, name, (rows.people >= low) & (rows.people <= high)))
    return {
        "by_distance": _groups_between(rows, rows.distance_m, DISTANCES_M),
        "by_visibility": _groups_between(rows, rows.visible, SHARES),
        "by_people": by_people,
    }


def _groups_between(rows: TruthRows, values: F64, edges: tuple[float, ...]) -> list[dict[str, Any]]:
    groups = []
    for low, high in pairwise(edges):
        name = f"{low:g}+" if math.isinf(high) else f"{low:g}-{high:g}"
        groups.append(_group_json(rows, name, (values >= low) & (values < high)))
    return groups


def _group_json(rows: TruthRows, name: str, members: Bool) -> dict[str, Any]:
    errors = rows.position_error_m[members]
    errors = errors[np.isfinite(errors)]
    return {
        "group": name,
        "truth_rows": int(members.sum()),
        "matches": int(rows.matched[members].sum()),
        "position_error_mean_m": _mean(errors),
        "position_error_std_m": _std(errors),
    }


_CLEAR = ("fragmentations", "mostly_tracked", "mostly_lost", "misses", "false_positives")
KINDS: tuple[ErrorKind, ...] = get_args(ErrorKind)
LABELS = {
    "people": "people in the truth", "tracked_people": "people tracked", "truth_rows": "positions in the truth",
    "mota": "MOTA", "motp_m": "MOTP [m]", "idf1": "IDF1", "hota": "HOTA", "det_a": "detection accuracy (HOTA)",
    "ass_a": "association accuracy (HOTA)", "switches": "id switches", "switches_per_minute": "id switches per minute",
    "fragmentations": "interruptions of tracks", "mostly_tracked": "people tracked for 80 % of their time or more",
    "mostly_lost": "people tracked for less than 20 %", "misses": "positions missed",
    "false_positives": "positions where nobody is", "position_error_mean_m": "position error, mean [m]",
    "position_error_std_m": "position error, standard deviation [m]", "height_error_mean_m": "height error, mean [m]",
    "significant_errors_per_10_min": "significant errors in 10 min",
    "significant_errors_per_10_min_upper": "significant errors in 10 min, at most",
    "events": "moments with such errors",
    "events_per_10_min": "such moments in 10 min", "events_per_10_min_upper": "such moments in 10 min, at most",
    "strict_identity_changes": "lasting identity changes", "strict_per_10_min": "lasting identity changes in 10 min",
    "ignored_rows": "positions too hidden to count", "track_rows": "positions tracked", "matches": "positions matched",
    "judged_share": "share of the positions tracked that the truth covers",
    "duration_s": "duration [s]", "track_frames": "frames with tracks",
    "covered_frames": "frames with tracks and truth",
}  # fmt: skip
"""Names for people of the figures of ``Evaluation.to_json``."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Scores of one run, or of several together.

    Attributes:
        sequence, clear: truth and track rows that count, side by side, and their CLEAR scores.
        rows: every truth row that counts. Position errors are unknown for boxes without alignment, since the world
            frames may then differ.
        ignored_rows: truth rows that are too little visible.
        height_error_m: (K,) absolute height difference of every match whose heights are known.
        facing: differences of direction, of every match whose track faces somewhere.
        significant, events: errors by frame, and from how many moments they come (``grouped_events``).
        strict_identity_changes: every persistent change of an identity, also after coming back.
        duration_s: time scored [s].
        tracked_people: tracks that count as people (``people_of``), near somebody or not.
        track_frames, covered_frames: frames with confirmed tracks, and those of them in which the truth has rows.
        height_ratio: median height of matched people of the truth, in heights of their tracks; NaN where unknown.
        cause: what would make a bad score good; None where nothing would.
        alignment: the motion applied to the tracks; None without ``align``.
        unjudged_rows: confirmed rows outside of what the truth covers.
        limits: why the truth does not cover them, a clause each.
        strangers: tracks that are near nobody of the truth and yet walk as people do.
        unplaced_rows: truth rows and confirmed rows without what they are matched on, which are left out.
        recordings: scores of each of several recordings, by name; empty for one.
    """

    sequence: Sequence
    clear: ClearScores
    rows: TruthRows
    ignored_rows: int
    height_error_m: F64
    facing: FacingErrors
    significant: list[SignificantError]
    events: int
    strict_identity_changes: int
    duration_s: float
    tracked_people: int
    track_frames: int
    covered_frames: int
    alignment: FloorAlignment | None
    height_ratio: float = math.nan
    cause: Finding | None = None
    unjudged_rows: int = 0
    limits: tuple[str, ...] = ()
    strangers: tuple[int, ...] = ()
    unplaced_rows: int = 0
    recordings: dict[str, Evaluation] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Evaluation({self.headline})"

    @property
    def headline(self) -> str:
        """The figures that matter most, in one line."""
        rows = self.sequence.truth_rows
        people = f"{_count_text(self.sequence.n_truth, 'person', 'people')} in the truth"
        people += f" ({rows:,} of {rows + self.ignored_rows:,} positions judged)"
        if self.cause is not None:
            people += f" (do they fit if {self.cause.names}?)"
        parts = [people, f"{self.tracked_people} tracked"]
        for name, score in (("MOTA", self.mota), ("IDF1", self.idf1)):
            if score is not None:
                parts.append(f"{name} {score:.3f}")
        for name, mean_m in (("position", self.position_error_mean_m), ("height", self.height_error_mean_m)):
            if mean_m is not None:
                parts.append(f"{name} error {100 * mean_m:.1f} cm")
        parts.append(_count_text(self.switches, "switch of any length", "switches of any length"))
        parts.append(
            _count_text(len(self.significant), "significant error of 1 s or more", "significant errors of 1 s or more")
        )
        return ", ".join(parts)

    def _repr_html_(self) -> str:
        import pandas  # half a second

        figures = [(name, value) for name, value in self.to_json().items() if isinstance(value, int | float)]
        return str(pandas.DataFrame(figures, columns=["figure", "value"]).to_html(index=False))

    @property
    def doubts(self) -> str:
        """A sentence on what of truth and tracks does not fit together; empty where all does."""
        sentences = []
        if self.unjudged_rows:
            why = ", and ".join(self.limits)
            share = f"{self.judged_share:.0%} of the tracks' rows are judged"
            sentences.append(f"{share}: the truth does not cover the others, since {why}")
        if self.unplaced_rows:
            sentences.append(f"{self.unplaced_rows} rows without a finite position or box are left out")
        sentences.append(self._misfit())
        return "; ".join(filter(None, sentences))

    @property
    def judged_share(self) -> float | None:
        """Share of the tracks' rows that the truth covers."""
        rows = self.sequence.track_rows + self.unjudged_rows
        return self.sequence.track_rows / rows if rows else None

    def _misfit(self) -> str:
        if self.cause is not None:
            return str(self.cause)
        if 2 * self.covered_frames < self.track_frames:
            return (
                f"the truth covers {self.covered_frames} of {self.track_frames} frames with tracks: in the others "
                "every track counts as false"
            )
        matches = len(self.clear.matches)
        truth_rows = self.sequence.truth_rows
        track_rows = self.sequence.track_rows
        strange_rows = int(np.isin(self.sequence.tracks, self.strangers).sum())
        if matches > FEW * truth_rows and strange_rows > (1.0 - FEW) * track_rows / 2:
            mota = 1.0 - (self.clear.misses + track_rows - strange_rows - matches + self.switches) / truth_rows
            return (
                f"{len(self.strangers)} of {self.sequence.n_tracks} tracks walk where the truth has nobody: are they "
                f"false, or does it hold some people only? Without them MOTA is {mota:.3f}"
            )
        if truth_rows and track_rows and matches < FEW * max(truth_rows, track_rows):
            return (
                f"{matches} of {truth_rows} truth rows and {track_rows} track rows match, and no change of axes, "
                "units, places, frames, ids, boxes or people that was tried explains it"
            )
        return ""

    @cached_property
    def _hota(self) -> HotaScores:
        return hota_scores(self.sequence)

    @property
    def mota(self) -> float | None:
        """None without truth that counts, as is every score that the data cannot give."""
        return self.clear.mota

    @cached_property
    def idf1(self) -> float | None:
        return idf1(self.sequence)

    @property
    def hota(self) -> float | None:
        return self._hota.hota

    @property
    def switches(self) -> int:
        """Every change of a person's id."""
        return self.clear.switches

    @property
    def position_error_mean_m(self) -> float | None:
        return _mean(self.position_error_m)

    @property
    def height_error_mean_m(self) -> float | None:
        return _mean(self.height_error_m)

    @property
    def position_error_m(self) -> F64:
        """(K,) floor distance of every match whose positions are known [m]."""
        return self.rows.position_error_m[np.isfinite(self.rows.position_error_m)]

    def to_json(self) -> dict[str, Any]:
        """All figures by name; a score that the data cannot give is None."""
        by_kind = Counter(error.kind for error in self.significant)
        facing = self.facing.to_json()
        return {
            "people": self.sequence.n_truth,
            "tracked_people": self.tracked_people,
            "truth_rows": self.sequence.truth_rows,
            "mota": self.mota,
            "motp_m": self.position_error_mean_m,
            "idf1": self.idf1,
            "hota": self.hota,
            "det_a": self._hota.deta,
            "ass_a": self._hota.assa,
            "switches": self.switches,
            "switches_per_minute": self._per(60.0, self.switches),
            **{name: getattr(self.clear, name) for name in _CLEAR},
            "position_error_mean_m": self.position_error_mean_m,
            "position_error_std_m": _std(self.position_error_m),
            "height_error_mean_m": self.height_error_mean_m,
            **({"facing": facing} if facing else {}),
            "significant_errors": {"total": len(self.significant), **{kind: by_kind[kind] for kind in KINDS}},
            **self._per_10_min("significant_errors", len(self.significant)),
            "events": self.events,
            **self._per_10_min("events", self.events),
            "strict_identity_changes": self.strict_identity_changes,
            "strict_per_10_min": self._per(600.0, self.strict_identity_changes),
            "significant_error_list": [asdict(error) for error in self.significant],
            "ignored_rows": self.ignored_rows,
            "track_rows": self.sequence.track_rows,
            "matches": len(self.clear.matches),
            "judged_share": self.judged_share,
            "duration_s": self.duration_s,
            "track_frames": self.track_frames,
            "covered_frames": self.covered_frames,
            **breakdown_json(self.rows),
            "alignment": self.alignment and self.alignment.to_json(),
        }

    def _per(self, seconds: float, count: float) -> float | None:
        return count * seconds / self.duration_s if self.duration_s > 0 else None

    def _per_10_min(self, name: str, count: int) -> dict[str, float | None]:
        key = f"{name}_per_10_min"
        return {key: self._per(600.0, count), f"{key}_upper": self._per(600.0, poisson_upper(count))}


_SUMS = (
    "ignored_rows", "events", "strict_identity_changes", "duration_s", "tracked_people", "track_frames",
    "covered_frames", "unjudged_rows", "unplaced_rows",
)  # fmt: skip


def pool(parts: Items[Evaluation]) -> Evaluation:
    """Several recordings scored as one: counts and rows add up, people and tracks of different ones never match."""
    sequence = Sequence.joined([part.sequence for part in parts])
    return Evaluation(
        sequence=sequence,
        clear=clear_scores(sequence),
        rows=joined_rows([part.rows for part in parts]),
        height_error_m=np.concatenate([part.height_error_m for part in parts]),
        facing=joined_rows([part.facing for part in parts]),
        significant=[error for part in parts for error in part.significant],
        **{name: sum(getattr(part, name) for part in parts) for name in _SUMS},
        alignment=None,
    )


def _mean(values: F64) -> float | None:
    return float(values.mean()) if len(values) else None


def _std(values: F64) -> float | None:
    return float(values.std()) if len(values) else None


def _count_text(number: int, one: str, many: str) -> str:
    return f"{number:,} {one if number == 1 else many}"
