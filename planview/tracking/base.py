"""What every tracker takes and gives, and how its people come and go.

A track is spawned tentative, confirmed on evidence, lost while nothing matches it, reacquired when something does, and
pruned (Harville 2002, section 4; Zhang et al. 2008, section 4; del-Blanco et al. 2012, section V). What counts as
evidence is the tracker's own; when a state changes, what is written down about it and which id it has is decided here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Integral, Real
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol

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
    """What the cameras show in one frame.

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
        """Nothing that is known shows in any camera: no evidence for or against anybody."""
        return bool(self.views) and not any(view.shows for view in self.views)

    @cached_property
    def maps(self) -> PlanViewMaps | None:
        """Plan-view maps, built when they are first read; None for one camera without depth."""
        return None if self.build_maps is None else self.build_maps()


BODY_RADIUS_M = 0.25
"""Half width of the upright prism around a standing person [m]: shoulders 0.45 m wide, and a swinging arm."""
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
    at, r, projection = np.array(people).reshape(-1, 1, 3), BODY_RADIUS_M, camera.projection
    corners = np.array([(x, y, z) for x in (-r, r) for y in (-r, r) for z in (0.0, 1.0)])
    xyz = np.concatenate([at[..., :2] + corners[:, :2], at[..., 2:] * corners[:, 2:]], axis=-1)
    u, v, depth = np.moveaxis(xyz @ projection[:, :3].T + projection[:, 3], -1, 0)
    # Corners of a body nearer to the camera's plane than this are left out [m].
    front, (width, height) = depth > 0.1, camera.size
    with np.errstate(divide="ignore", invalid="ignore"):
        (left, top), (right, bottom) = (
            [least(np.where(front, part / depth, sign * np.inf), axis=1) for part in (u, v)]
            for least, sign in ((np.min, 1), (np.max, -1))
        )
    left, top = np.maximum(left, -0.5), np.maximum(top, -0.5)
    sides = np.minimum(right, width - 0.5) - left, np.minimum(bottom, height - 0.5) - top
    found = zip(*(part.tolist() for part in (left, top, *sides)), strict=True)
    return [(x, y, w, h) if w > 0 and h > 0 else NO_BOX for x, y, w, h in found]


class ScoreTerms(NamedTuple):
    """The weighted terms that a match score is the sum of (Harville 2002, section 4, eq. 4; separation is ours)."""

    height: float = math.nan
    occupancy: float = math.nan
    distance: float = math.nan
    separation: float = math.nan


NO_TERMS = ScoreTerms()


@dataclass(frozen=True)
class Decision:
    """Why a tracker did something: goes to the rerun log and to ``--debug`` output.

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
    """Shapes a tracker wants shown, on the floor [m] or in the image [px].

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
    """What the last update looked at; built on request only, since it costs time.

    Attributes:
        drawings: shapes for the floor and image views.
        tiles: small images by name ("template/3/height"), (h, w) float32 or uint8.
    """

    drawings: tuple[Drawing, ...] = ()
    tiles: dict[str, F32 | U8] = field(default_factory=dict)


Needs = Literal["points", "maps", "image"]
"""What a tracker looks at: the pixels and points of views, the maps made of them, or the image of one camera."""


class Tracker(Protocol):
    """People over time. ``update`` once per frame, in order; ``reset`` forgets everything.

    Attributes:
        needs: a recording whose heads do not give it is refused.
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
        """What the tracker knows about pixels, for ``Foreground``; None when it gives no feedback."""

    def study(self, observations: Iterable[Observation]) -> None:
        """Learn from the beginning of a recording before its first frame is tracked, as far as that is of use; what is
        learned is kept by ``reset``."""


def followed(tracker: Tracker, observation: Observation) -> tuple[TrackState, ...]:
    """What a tracker makes of the next frame. Raises InputError: one's own tracker returns anything but TrackStates."""
    people: object = tracker.update(observation)
    expected = f"expected a sequence of TrackState from {type(tracker).__name__}.update"
    if not isinstance(people, Sequence) or not all(isinstance(person, TrackState) for person in people):
        found = type(people).__name__ if not isinstance(people, Sequence) else "a sequence of something else"
        raise InputError(f"{expected}, found {found}", argument="tracker")
    if not all(isinstance(decision, Decision) for decision in tracker.decisions):
        expected = f"expected Decisions in {type(tracker).__name__}.decisions"
        raise InputError(f"{expected}, found something else", argument="tracker")
    if not type(tracker).__module__.startswith("planview."):  # one's own may return what no table holds, and no boxes
        if unfit := _unfit(people):
            raise InputError(f"{expected} for tracks.csv, found {unfit}", argument="tracker")
        boxes = person_boxes(observation.camera, [(person.x_m, person.y_m, person.height_m) for person in people])
        known = zip(people, boxes, strict=True)
        people = [replace(p, box_px=box) if math.isnan(p.box_px[0]) else p for p, box in known]
    return tuple(people)


def _unfit(people: Sequence[TrackState]) -> str:
    """What tracks.csv cannot hold of one frame's people; empty where it can hold all."""
    ids = [person.track_id for person in people]
    for person in people:
        if not isinstance(person.track_id, Integral) or abs(person.track_id) > KEY_MAX:
            return f"the id {person.track_id!r}"
        if ids.count(person.track_id) > 1:
            return f"the id {person.track_id} twice"
        if person.state not in STATES:
            return f"the state {person.state!r}"
        box: object = person.box_px
        if not isinstance(box, Sequence | np.ndarray) or len(box) != 4 or not all(isinstance(n, Real) for n in box):
            return f"the box {box!r}"
        for name in ("x_m", "y_m", "vx_mps", "vy_mps", "height_m", *LAST_COLUMNS):
            if not isinstance(value := getattr(person, name), Real):
                return f"the {name} {value!r}"
    return ""


def refuse_tracker(tracker: object, names: Sequence[str]) -> None:
    """Raises InputError for a name that is none of ``names``, and for an object that lacks a part of ``Tracker``."""
    if isinstance(tracker, str) and tracker not in names:
        raise InputError(f"expected one of {', '.join(names)}, found {tracker!r}", argument="tracker")
    parts = "update", "decisions", "debug", "reset", "needs"
    missing = [part for part in parts if not isinstance(tracker, str) and not hasattr(tracker, part)]
    if missing or isinstance(tracker, type):
        found = f"{type(tracker).__name__} without {', '.join(missing)}" if missing else "a class in its place"
        raise InputError(f"expected an object with {', '.join(parts)}, found {found}", argument="tracker")


class Living(Protocol):
    """Anybody whose life a ``LifeCycle`` records: a number, negative until they are confirmed, and whether they are."""

    track_id: int
    confirmed: bool


def state_of(confirmed: bool, observed: bool) -> State:
    """As reported in ``tracks.csv``."""
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
        """As reported in ``tracks.csv``."""
        return state_of(self.confirmed, self.observed)


class LifeCycle(Carried):
    """Gives ids, and writes down every change of state with its reason.

    People appear, are confirmed or recognised, and end; whoever is an ``Existence`` is also observed or missed.

    Attributes:
        now_s: time of the current frame [s].
    """

    CARRIED = "_tentative", "_confirmed", "now_s"

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all decisions; ids start again."""
        self._tentative = self._confirmed = 0
        self._log: list[Decision] = []
        self.now_s = math.nan

    def begin(self, now_s: float) -> float:
        """Start a frame without decisions; the time since the last one [s]. Raises ValueError: no time after that."""
        if not math.isfinite(now_s) or now_s <= self.now_s:
            raise ValueError(f"expected time to advance, got {now_s} s after {self.now_s} s")
        dt = 0.0 if math.isnan(self.now_s) else now_s - self.now_s
        self.now_s, self._log = now_s, []
        return dt

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the current frame."""
        return tuple(self._log)

    def note(
        self, who: Living, kind: DecisionKind, reason: str, value: float = math.nan, terms: ScoreTerms = NO_TERMS,
        was: int = 0,
    ) -> None:  # fmt: skip
        """Write down a decision; ``was`` is the negative number that the track had until now."""
        self._log.append(Decision(who.track_id, kind, f"was {was}; {reason}" if was else reason, value, terms, was))

    def appear(self, who: Living, reason: str, value: float = math.nan, kind: DecisionKind = "spawned") -> None:
        """Somebody may be there: -1, -2, ... until confirmed or recognised."""
        self._tentative -= 1
        who.track_id = self._tentative
        self.note(who, kind, reason, value)

    def spawn(self, reason: str, value: float = math.nan) -> Existence:
        """A new tentative track, observed now."""
        who = Existence(0, self.now_s, self.now_s)
        self.appear(who, reason, value)
        return who

    def confirm(self, who: Living, reason: str, value: float = math.nan) -> None:
        """A tentative track is a person: 1, 2, ..."""
        if not who.confirmed:
            self._confirmed += 1
            was, who.track_id, who.confirmed = who.track_id, self._confirmed, True
            self.note(who, "confirmed", reason, value, was=was)

    def recognise(self, who: Living, was: int, reason: str, value: float = math.nan) -> None:
        """A tentative track, which ``was`` a negative number, now has the id of a person known before."""
        who.confirmed = True
        self.note(who, "reacquired", reason, value, was=was)

    def observe(self, who: Existence, reason: str = "", value: float = math.nan, terms: ScoreTerms = NO_TERMS) -> None:
        """The track is observed in this frame; a lost one is reacquired, for the reason given."""
        if who.lost:
            self.note(who, "reacquired", reason, value, terms)
        elif reason:
            self.note(who, "matched", reason, value, terms)
        who.observed, who.observed_s = True, self.now_s

    def miss(self, who: Existence, reason: str, value: float = math.nan, terms: ScoreTerms = NO_TERMS) -> None:
        """The track is not observed in this frame; a confirmed one is lost from now on."""
        if who.confirmed and who.observed:
            self.note(who, "lost", reason, value, terms)
        who.observed = False

    def pause(self, who: Existence, dt_s: float) -> None:
        """The frame, ``dt_s`` after the last one, shows nothing: nobody has been looked for."""
        self.miss(who, "the frame shows nothing")
        who.observed_s += dt_s

    def prune(self, who: Living, reason: str, value: float = math.nan) -> None:
        """The track ends; the tracker forgets it."""
        self.note(who, "pruned", reason, value)

    def unobserved_s(self, who: Existence) -> float:
        """Time since the last observation [s]."""
        return self.now_s - who.observed_s

    def age_s(self, who: Existence) -> float:
        """Time since the track was spawned [s]."""
        return self.now_s - who.spawned_s
