"""Reasons why truth and tracks do not fit together: hypotheses about either table, each undone and scored.

Axes, units, numbers of frames and forms of boxes are tried. A shift in time and an offset in the plane are not tried
but voted for, by pairs of rows that are near each other and by pairs of rows of one frame (as a Hough transform does).
Any other turn or scale is fitted to a track and a person.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, reduce
from itertools import product

import numpy as np

from calib.doubt import Finding, Hypothesis, Score, best
from calib.types import F64
from planview.evaluation.align import complex_places, fit_turn, paths_to_lay
from planview.evaluation.places import (
    CLOSE_M,
    Places,
    near_unit,
    places_of,
    share_near,
    vote_offset,
    vote_shift,
    with_places,
)
from planview.trajectories.table import Trajectories

GOOD = 0.8
"""Share of the truth's rows near a track from which on nothing needs explaining (our choice)."""
LEAST = 0.8 * GOOD
"""Share that a hypothesis must reach, and the factor by which it must exceed the share as given."""
GAIN = 1.3
FEWEST_ROWS = 20
"""Rows of either table from which on they are compared."""
VOTERS = 300
"""Rows of the truth that are tried, spread over the whole."""
VOTED_ON = 1500
"""Rows of the tracks that vote."""
PER_CHANGE = 1.03
"""Odds against each change: the factor by which it must bring more rows near a track (our choice)."""
CHANGES_MAX = 2
"""Changes tried together, besides a shift or an offset."""
ALIKE = 1.01
"""Two hypotheses under which about the same rows are near a track explain them alike."""
RATIOS = "2 3 4 5 6 10 1/2 1/3 1/5 2/3 3/2 3/4 4/3 2/5 5/2 3/5 5/3 4/5 5/4 5/6 6/5"
"""Frames of the tracks per number of the truth: usual frame rates over one another."""
TURNED_DEG = 1.0
"""A turn that is none."""
SCALED = 0.03
"""A change of scale that is none."""


@dataclass(frozen=True, eq=False)
class Reference:
    """The tracks over which a truth is laid."""

    table: Trajectories
    on_floor: bool

    @cached_property
    def unit(self) -> float:
        return near_unit(self.table, self.on_floor)

    @cached_property
    def places(self) -> Places:
        return self.places_of(self.table)

    @cached_property
    def voters(self) -> Places:
        return self.places.spread(VOTED_ON)

    def places_of(self, table: Trajectories) -> Places:
        return places_of(table, self.on_floor, self.unit)


@dataclass(frozen=True, eq=False)
class Tables:
    """Some rows of a truth, and tracks."""

    truth: Trajectories
    tracks: Reference

    @cached_property
    def places(self) -> Places:
        """Places of the truth."""
        return self.tracks.places_of(self.truth)

    @property
    def share(self) -> float:
        """Share of the truth's rows that are near a track."""
        return share_near(self.places, self.tracks.places)


def misfit(truth: Trajectories, tracks: Trajectories, on_floor: bool) -> Finding | None:
    """The hypothesis under which truth and tracks fit; None where they fit as they are, or where none explains it. Rows
    without what is compared are left out."""
    truth = with_places(truth, on_floor)
    tracks = with_places(tracks, on_floor)
    if min(len(truth), len(tracks)) < FEWEST_ROWS:
        return None
    # Rows are sorted by frame, so that every n-th of them are all people's alike.
    thin = np.arange(len(truth)) % max(1, len(truth) // VOTERS) == 0
    tables = Tables(truth.where(thin), Reference(tracks, on_floor))
    now = tables.share
    if now >= GOOD:
        return None

    def score(changed: Tables) -> Score:
        share = changed.share
        return Score(math.log(max(share, 0.01)), f"{share:.0%} of its rows are near a track, in place of {now:.0%}")

    tried = hypotheses(tables, truth)
    return best(tables, tried, score, margin=GAIN, alike=ALIKE, least=math.log(LEAST), ceiling=0.0)


Undo = Callable[[Trajectories], Trajectories]


def _about_truth(clause: str, remedy: str, undo: Undo, odds: float = PER_CHANGE) -> Hypothesis[Tables]:
    def undo_truth(tables: Tables) -> Tables:
        return replace(tables, truth=undo(tables.truth))

    return Hypothesis(f"the truth{clause}", remedy, undo_truth, odds)


def _about_tracks(clause: str, remedy: str, undo: Undo) -> Hypothesis[Tables]:
    def undo_tracks(tables: Tables) -> Tables:
        return replace(tables, tracks=replace(tables.tracks, table=undo(tables.tracks.table)))

    return Hypothesis(f"the tracks{clause}", remedy, undo_tracks, PER_CHANGE)


def _lay(turn: complex, is_mirrored: bool = False, shift: complex = 0.0) -> Undo:
    """Lays places, as complex numbers: mirrors y, then turns and scales, then shifts."""

    def undo(table: Trajectories) -> Trajectories:
        places = complex_places(table)
        if is_mirrored:
            places = places.conj()
        places = turn * places + shift
        return replace(table, x_m=places.real, y_m=places.imag)

    return undo


def _change_boxes(change: Callable[[F64, F64], tuple[F64, F64]]) -> Undo:
    """Makes left, top and size of the first and the last two numbers of a box [px], (N, 2) each."""

    def undo(table: Trajectories) -> Trajectories:
        first, size = change(table.box_px[:, :2], table.box_px[:, 2:])
        return replace(table, box_px=np.column_stack([first, size]))

    return undo


def _scale_frames(ratio: Fraction) -> Hypothesis[Tables]:
    return _about_truth(
        f" has {1 / ratio} times the frame rate of the tracks",
        f"multiply its frames by {ratio}",
        lambda table: replace(table, frame=np.rint(table.frame * float(ratio)).astype(np.int64)),
    )


NUMBERS = (
    *(_scale_frames(Fraction(ratio)) for ratio in RATIOS.split()),
    _about_truth(
        "'s columns of frames and ids are exchanged",
        "exchange them",
        lambda table: replace(table, frame=table.track_id, track_id=table.frame),
    ),
)
AXES = (
    _about_truth("'s x axis is mirrored", "mirror it back", _lay(-1.0, is_mirrored=True)),
    _about_truth("'s y axis is mirrored", "mirror it back", _lay(1.0, is_mirrored=True)),
    _about_truth("'s axes x and y are exchanged", "exchange them", _lay(1.0j, is_mirrored=True)),
)
UNITS = (
    _about_truth("'s unit is feet", "give metres", _lay(0.3048)),
    _about_truth("'s unit is centimetres", "give metres", _lay(0.01)),
    _about_truth("'s unit is millimetres", "give metres", _lay(0.001)),
    _about_tracks("' unit is centimetres", "give metres", _lay(0.01)),
)
FORMS = {
    "given by their middle": _change_boxes(lambda middle, size: (middle - size / 2, size)),
    "given by the middle of their lower edge": _change_boxes(lambda foot, size: (foot - size * [0.5, 1.0], size)),
    "of images half as large": _change_boxes(lambda first, size: (2 * first, 2 * size)),
}
BOXES = [
    about(f"{whose} boxes are {form}", "give left, top and size of people", undo)
    for about, whose in ((_about_truth, "'s"), (_about_tracks, "'"))
    for form, undo in FORMS.items()
]


def _combine(*families: Sequence[Hypothesis[Tables]]) -> list[Hypothesis[Tables]]:
    """Every combination of one to CHANGES_MAX changes, of as many families; fewer ones first."""
    combinations = []
    for chosen in product(*((None, *family) for family in families)):
        changes = [change for change in chosen if change is not None]
        if 0 < len(changes) <= CHANGES_MAX:
            combinations.append(changes)
    combinations.sort(key=len)
    return [reduce(Hypothesis.and_then, changes) for changes in combinations]


ON_FLOOR = _combine(NUMBERS, AXES, UNITS)
IN_IMAGE = _combine(NUMBERS, BOXES)


def hypotheses(tables: Tables, truth: Trajectories) -> Iterator[Hypothesis[Tables]]:
    """Possible faults of tables, and of the whole truth that they have rows of; fewer changes first."""
    yield from _moves(tables)
    for change in ON_FLOOR if tables.tracks.on_floor else IN_IMAGE:
        changed = change.undo(tables)
        size = changed.tracks.places.size
        is_of_one_unit = size / 10 < changed.places.size < 10 * size
        if is_of_one_unit:
            yield change
            for move in _moves(changed):
                yield change.and_then(move)
    if tables.tracks.on_floor:
        yield from _fits(truth, tables.tracks.table)


def _moves(tables: Tables) -> Iterator[Hypothesis[Tables]]:
    """A shift in time, and an offset, as pairs of rows vote for them."""
    tracks = tables.tracks
    yield _later(vote_shift(tables.places, tracks.voters))
    yield _away(vote_offset(tables.places, tracks.voters), tracks)


def _later(frames: int) -> Hypothesis[Tables]:
    """A truth whose numbers are lower or higher than the tracks' by some frames."""
    how = "lower" if frames > 0 else "higher"
    sign = "add" if frames > 0 else "subtract"
    return _about_truth(
        f"'s frames are numbered {abs(frames)} {how} than those of the tracks",
        f"{sign} {abs(frames)}",
        lambda table: replace(table, frame=table.frame + frames),
    )


def _away(offset: F64, tracks: Reference) -> Hypothesis[Tables]:
    """A truth that is shifted against the tracks, which are two changes: across and along."""
    if tracks.on_floor:
        x_m, y_m = (0.0 - CLOSE_M * offset).tolist()
        beside = f" is {x_m:+.2f}, {y_m:+.2f} m from the tracks"
        return _about_truth(beside, "align them", _lay(1.0, shift=-complex(x_m, y_m)), PER_CHANGE**2)
    offset_px = tracks.unit * offset.reshape(2, 2).mean(axis=0)
    x_px, y_px = (0.0 - offset_px).tolist()
    beside = f"'s boxes are {x_px:+.0f}, {y_px:+.0f} px from those of the tracks"
    undo = _change_boxes(lambda first, size: (first + offset_px, size))
    return _about_truth(beside, "move them", undo, PER_CHANGE**2)


def _fits(truth: Trajectories, tracks: Trajectories) -> Iterator[Hypothesis[Tables]]:
    """The truth turned, scaled and mirrored so that one of its people lies on a track."""
    true_places = complex_places(truth)
    track_places = complex_places(tracks)
    for (true_rows, track_rows), is_mirrored in product(paths_to_lay(truth, tracks), (False, True)):
        source = true_places[true_rows]
        if is_mirrored:
            source = source.conj()
        target = track_places[track_rows]
        turn = complex(fit_turn(source, target))
        shift = complex(target.mean() - turn * source.mean())
        degrees = -math.degrees(cmath.phase(turn))
        scale = 1.0 / abs(turn)
        clauses = []
        if is_mirrored:
            clauses.append("is mirrored")
        if abs(degrees) >= TURNED_DEG:
            clauses.append(f"is turned by {degrees:.0f} degrees")
        if abs(scale - 1.0) > SCALED:
            clauses.append(f"has places {scale:.3g} times as far apart")
        if clauses:  # no more than an offset, which was voted for
            is_rigid = clauses == [f"is turned by {degrees:.0f} degrees"]
            remedy = "align them" if is_rigid else "convert it"
            # A turn, a scale and an offset across and along are four changes.
            yield _about_truth(f" {' and '.join(clauses)}", remedy, _lay(turn, is_mirrored, shift), PER_CHANGE**4)
