"""Input and output of every tracker, and how its people come and go.

A track is spawned tentative, confirmed on evidence, lost while nothing matches it, reacquired when something does, and
pruned (Harville 2002, section 4; Zhang et al. 2008, section 4; del-Blanco et al. 2012, section V). What counts as
evidence is the tracker's own; when a state changes, what is written down about it and which id it has is decided here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from numbers import Integral, Real
from typing import TYPE_CHECKING, Literal, NamedTuple, NoReturn, Protocol, runtime_checkable

import numpy as np

from calib.carried import Carried
from calib.errors import InputError
from calib.floor_camera import FloorCamera
from calib.types import F32, U8
from planview.trajectories.state import State, TrackState
from planview.trajectories.table import KEY_MAX, LAST_COLUMNS, STATES

if TYPE_CHECKING:  # its kernels: readers of decisions need no numba
    from planview.maps.plan_view import PlanViewMaps
    from planview.maps.view import View

DecisionKind = Literal[
    "spawned", "confirmed", "matched", "recentred", "lost", "reacquired", "pruned", "split", "state", "identity"
]


@dataclass(frozen=True, eq=False)
class Observation:
    """One frame as a tracker takes it.

    Attributes:
        frame: index in the recording, from 0.
        timestamp_s: seconds since the first frame.
        views: of every rig, or of one camera.
        camera: that of the first rig above the floor, in whose pixels boxes are; None for one camera without depth.
        build_maps: makes the plan-view maps of the views; None for one camera without depth.
    """

    frame: int
    timestamp_s: float
    views: tuple[View, ...] = ()
    camera: FloorCamera | None = None
    build_maps: Callable[[], PlanViewMaps] | None = None

    @property
    def unknown(self) -> bool:
        """True if no camera shows anything: no evidence for or against anybody."""
        return bool(self.views) and not any(view.shows for view in self.views)

    @cached_property
    def maps(self) -> PlanViewMaps | None:
        """Plan-view maps, built when they are first read; None for one camera without depth."""
        return None if self.build_maps is None else self.build_maps()


BODY_RADIUS_M = 0.25
"""Half width of the upright prism around a standing person [m]: shoulders 0.45 m wide, and a swinging arm."""
PRISM_CORNERS = np.array(list(product((-BODY_RADIUS_M, BODY_RADIUS_M), (-BODY_RADIUS_M, BODY_RADIUS_M), (0.0, 1.0))))
"""(8, 3) corners of a prism about its axis [m], heights relative to the person's."""
Box = tuple[float, float, float, float]
NO_BOX: Box = (math.nan, math.nan, math.nan, math.nan)


def person_boxes(camera: FloorCamera | None, people: Sequence[tuple[float, float, float]]) -> list[Box]:
    """Boxes around upright prisms of a person's width, clipped to the image: left, top, width, height [px].

    Args:
        camera: without distortion; None for no boxes.
        people: x, y and height of each [m].
    Returns:
        One of each person; NO_BOX where they are not in view.
    """
    if camera is None or not people:
        return [NO_BOX] * len(people)
    at = np.array(people).reshape(-1, 1, 3)
    xy = at[..., :2] + PRISM_CORNERS[:, :2]
    z = at[..., 2:] * PRISM_CORNERS[:, 2:]
    pixels = camera.project(np.concatenate([xy, z], axis=-1))
    first = np.maximum(np.fmin.reduce(pixels, axis=1), -0.5)  # corners behind the camera are NaN
    last = np.minimum(np.fmax.reduce(pixels, axis=1), np.array(camera.size) - 0.5)
    boxes: list[Box] = []
    for x, y, w, h in np.column_stack([first, last - first]).tolist():
        boxes.append((x, y, w, h) if w > 0 and h > 0 else NO_BOX)
    return boxes


class ScoreTerms(NamedTuple):
    """The weighted terms that a match score is the sum of (Harville 2002, section 4, eq. 4; separation is ours)."""

    height: float = math.nan
    occupancy: float = math.nan
    distance: float = math.nan
    separation: float = math.nan


NO_TERMS = ScoreTerms()


@dataclass(frozen=True)
class Decision:
    """A decision of a tracker and its reason, for decisions.csv and the rerun log.

    Attributes:
        track_id: of the person it concerns.
        kind: what was decided.
        reason: one clause for people, with the numbers that decided it ("score 0.31 < 0.55").
        value: the deciding number, NaN when there is none.
        terms: of a match score, NaN where the value is none.
        was: the negative number that the person had until now, when this gives the id; else 0.
    """

    track_id: int
    kind: DecisionKind
    reason: str
    value: float = math.nan
    terms: ScoreTerms = NO_TERMS
    was: int = 0


@dataclass(frozen=True, eq=False)
class Drawing:
    """Shapes that explain a tracker, on the floor [m] or in the image [px].

    Attributes:
        name: layer, e.g. "search" or "particles".
        plane: "floor" or "image".
        strips: line strips (N, 2) float32 (closed by repeating the first point); a single row is a point.
        labels: one per strip, or empty.
    """

    name: str
    plane: Literal["floor", "image"]
    strips: tuple[F32, ...]
    labels: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class TrackerDebug:
    """Shapes and images that explain the last update; built on request only, since it costs time.

    Attributes:
        drawings: shapes for the floor and image views.
        tiles: small images by name ("template/3/height"), (h, w) float32 or uint8.
    """

    drawings: tuple[Drawing, ...] = ()
    tiles: dict[str, F32 | U8] = field(default_factory=dict)


Needs = Literal["points", "maps", "image"]
"""Input of a tracker: the pixels and points of views, the maps made of them, or the image of one camera."""


@runtime_checkable
class Tracker(Protocol):
    """People over time. ``update`` once per frame, in order; ``reset`` forgets everything.

    Attributes:
        needs: a recording whose sensors do not give it is refused.
    """

    @property
    def needs(self) -> Needs: ...

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""

    def update(self, observation: Observation) -> tuple[TrackState, ...]: ...

    def debug(self) -> TrackerDebug:
        """Shapes and tiles that explain the last update."""

    def reset(self) -> None: ...


class ImageTracker(Tracker, Protocol):
    """A tracker that works on the frames of one camera."""

    @property
    def foreground_columns(self) -> int | None:
        """Columns of foreground and motion that are enough; None: those of the image."""

    def feedback(self) -> U8 | None:
        """Labels of pixels for ``Foreground``; None when the tracker gives no feedback."""

    def study(self, observations: Iterable[Observation]) -> None:
        """Learn from the beginning of a recording before its first frame is tracked, as far as that is of use; what is
        learned is kept by ``reset``."""


@runtime_checkable
class Annotated(Protocol):
    """A tracker with remarks on a run."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for run.json."""


def notes_of(tracker: Tracker) -> tuple[str, ...]:
    """Remarks of a tracker on its run; one's own tracker need not have any."""
    return tracker.notes if isinstance(tracker, Annotated) else ()


def track_frame(tracker: Tracker, observation: Observation) -> tuple[TrackState, ...]:
    """Track the next frame. Raises InputError: one's own tracker returns anything but TrackStates."""
    people: object = tracker.update(observation)
    name = type(tracker).__name__
    if not isinstance(people, Sequence) or not all(isinstance(person, TrackState) for person in people):
        _refuse(f"a sequence of TrackState from {name}.update", f"{people!r:.80}")
    if not all(isinstance(decision, Decision) for decision in tracker.decisions):
        _refuse(f"Decisions in {name}.decisions", "something else")
    if not type(tracker).__module__.startswith("planview."):  # one's own may return what no table holds, and no boxes
        unfit = _unfit_for_table(people)
        if unfit:
            _refuse(f"people from {name}.update for tracks.csv", unfit)
        people = _add_boxes(people, observation.camera)
    return tuple(people)


def _refuse(expected: str, found: str) -> NoReturn:
    raise InputError(f"expected {expected}, found {found}", argument="tracker")


def _add_boxes(people: Sequence[TrackState], camera: FloorCamera | None) -> list[TrackState]:
    """People with boxes where they have none."""
    boxes = person_boxes(camera, [(person.x_m, person.y_m, person.height_m) for person in people])
    boxed = []
    for person, box in zip(people, boxes, strict=True):
        has_box = not math.isnan(person.box_px[0])
        boxed.append(person if has_box else replace(person, box_px=box))
    return boxed


def _unfit_for_table(people: Sequence[TrackState]) -> str:
    """The first value of one frame's people that tracks.csv cannot hold; empty if it can hold all."""
    ids = [person.track_id for person in people]
    for person in people:
        if not isinstance(person.track_id, Integral) or abs(person.track_id) > KEY_MAX:
            return f"the id {person.track_id!r}"
        if ids.count(person.track_id) > 1:
            return f"the id {person.track_id} twice"
        if person.state not in STATES:
            return f"the state {person.state!r}"
        if np.shape(person.box_px) != (4,) or not all(isinstance(side, Real) for side in person.box_px):
            return f"the box {person.box_px!r}"
        for name in ("x_m", "y_m", "vx_mps", "vy_mps", "height_m", *LAST_COLUMNS):
            value = getattr(person, name)
            if not isinstance(value, Real):
                return f"the {name} {value!r}"
    return ""


def refuse_tracker(tracker: object, names: Sequence[str]) -> None:
    """Raises InputError for a name that is none of ``names``, and for an object that is not a ``Tracker``."""
    if isinstance(tracker, str):
        if tracker not in names:
            _refuse(f"one of {', '.join(names)}", repr(tracker))
    elif isinstance(tracker, type) or not isinstance(tracker, Tracker):
        _refuse("an object with update, decisions, debug, reset and needs", repr(tracker))


class Living(Protocol):
    """A track as ``LifeCycle`` needs it: a number, negative until it is confirmed, and whether it is."""

    track_id: int
    confirmed: bool


def state_of(confirmed: bool, observed: bool) -> State:
    """State of a track as in ``tracks.csv``."""
    if not confirmed:
        return "tentative"
    return "confirmed" if observed else "lost"


@dataclass(slots=True, eq=False)
class Existence:
    """The existence of one tracked person.

    Attributes:
        track_id: negative until the track is confirmed, then positive; unique in a run.
        spawned_s: time of the first observation [s].
        observed_s: time of the last observation [s].
        confirmed: the track has been confirmed, and stays so until it is pruned.
        observed: the track is observed in the current frame.
    """

    track_id: int
    spawned_s: float
    observed_s: float
    confirmed: bool = False
    observed: bool = True

    @property
    def lost(self) -> bool:
        """Confirmed, and not observed in the current frame."""
        return self.confirmed and not self.observed

    @property
    def state(self) -> State:
        """State as in ``tracks.csv``."""
        return state_of(self.confirmed, self.observed)


class LifeCycle(Carried):
    """Gives ids, and writes down every change of state with its reason.

    Tracks appear, are confirmed or recognised, and end; an ``Existence`` is also observed or missed.

    Attributes:
        now_s: time of the current frame [s].
    """

    CARRIED = "_tentative", "_confirmed", "now_s"

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all decisions; ids start again."""
        self._tentative = 0
        self._confirmed = 0
        self._log: list[Decision] = []
        self.now_s = math.nan

    def begin(self, now_s: float) -> float:
        """Start a frame without decisions; return the time since the last one [s]. Raises ValueError: no time after
        that."""
        if not math.isfinite(now_s) or now_s <= self.now_s:
            raise ValueError(f"expected time to advance, got {now_s} s after {self.now_s} s")
        dt_s = 0.0 if math.isnan(self.now_s) else now_s - self.now_s
        self.now_s = now_s
        self._log = []
        return dt_s

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the current frame."""
        return tuple(self._log)

    def note(
        self,
        track: Living,
        kind: DecisionKind,
        reason: str,
        value: float = math.nan,
        terms: ScoreTerms = NO_TERMS,
        was: int = 0,
    ) -> None:
        """Write down a decision; ``was`` is the negative number that the track had until now."""
        reason = f"was {was}; {reason}" if was else reason
        self._log.append(Decision(track.track_id, kind, reason, value, terms, was))

    def appear(self, track: Living, reason: str, value: float = math.nan, kind: DecisionKind = "spawned") -> None:
        """Number somebody who may be there: -1, -2, ... until confirmed or recognised."""
        self._tentative -= 1
        track.track_id = self._tentative
        self.note(track, kind, reason, value)

    def spawn(self, reason: str, value: float = math.nan) -> Existence:
        """Begin a tentative track, observed now."""
        track = Existence(0, self.now_s, self.now_s)
        self.appear(track, reason, value)
        return track

    def confirm(self, track: Living, reason: str, value: float = math.nan) -> None:
        """Number a tentative track that is a person: 1, 2, ..."""
        if track.confirmed:
            return
        was = track.track_id
        self._confirmed += 1
        track.track_id = self._confirmed
        track.confirmed = True
        self.note(track, "confirmed", reason, value, was=was)

    def recognise(self, track: Living, was: int, reason: str, value: float = math.nan) -> None:
        """Confirm a tentative track, which ``was`` a negative number, and now has the id of a person seen before."""
        track.confirmed = True
        self.note(track, "reacquired", reason, value, was=was)

    def observe(
        self, track: Existence, reason: str = "", value: float = math.nan, terms: ScoreTerms = NO_TERMS
    ) -> None:
        """Observe a track in this frame; a lost one is reacquired, for the reason given."""
        if track.lost:
            self.note(track, "reacquired", reason, value, terms)
        elif reason:
            self.note(track, "matched", reason, value, terms)
        track.observed = True
        track.observed_s = self.now_s

    def miss(self, track: Existence, reason: str, value: float = math.nan, terms: ScoreTerms = NO_TERMS) -> None:
        """Miss a track in this frame; a confirmed one is lost from now on."""
        if track.confirmed and track.observed:
            self.note(track, "lost", reason, value, terms)
        track.observed = False

    def pause(self, track: Existence, dt_s: float) -> None:
        """Pass a frame, ``dt_s`` after the last one, that shows nothing: nobody has been looked for."""
        self.miss(track, "the frame shows nothing")
        track.observed_s += dt_s

    def prune(self, track: Living, reason: str, value: float = math.nan) -> None:
        """End a track; the tracker forgets it."""
        self.note(track, "pruned", reason, value)

    def unobserved_s(self, track: Existence) -> float:
        """Time since the last observation [s]."""
        return self.now_s - track.observed_s
