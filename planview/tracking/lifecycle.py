"""Ids, states and the log of decisions of all trackers.

A track is spawned tentative, confirmed on evidence, lost while nothing matches it, reacquired when something does, and
pruned (Harville 2002, section 4; Zhang et al. 2008, section 4; del-Blanco et al. 2012, section V). What counts as
evidence is the tracker's own; when a state changes, what is written down about it and which id it has is decided here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from planview.tracking.base import NO_TERMS, Decision, DecisionKind, ScoreTerms
from planview.trajectories.state import State


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
        if not self.confirmed:
            return "tentative"
        return "lost" if self.lost else "confirmed"


class TrackLog:
    """Ids, and the decisions of the current frame.

    Attributes:
        now_s: time of the current frame [s].
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all decisions; ids start again."""
        self._tentative = self._confirmed = 0
        self._log: list[Decision] = []
        self.now_s = math.nan

    def begin(self, now_s: float) -> float:
        """Start a frame with no decisions; the time since the last one [s]. Raises ValueError: time runs backwards."""
        if now_s < self.now_s:
            raise ValueError(f"expected time to advance, got {now_s} s after {self.now_s} s")
        dt = 0.0 if math.isnan(self.now_s) else now_s - self.now_s
        self.now_s, self._log = now_s, []
        return dt

    def tentative_id(self) -> int:
        """-1, -2, ... for a track that may be a person."""
        self._tentative -= 1
        return self._tentative

    def person_id(self) -> int:
        """1, 2, ... for a track that is confirmed now."""
        self._confirmed += 1
        return self._confirmed

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the current frame."""
        return tuple(self._log)

    def note(
        self, track_id: int, kind: DecisionKind, reason: str, value: float = math.nan, terms: ScoreTerms = NO_TERMS,
        was: int = 0,
    ) -> None:  # fmt: skip
        """Write down a decision; ``was`` is the negative number of the track that has this id from now on."""
        self._log.append(Decision(track_id, kind, f"was {was}; {reason}" if was else reason, value, terms, was))


class LifeCycle(TrackLog):
    """Spawns, confirms, loses, reacquires and prunes; every change of state is logged with its reason."""

    def spawn(self, reason: str, value: float = math.nan) -> Existence:
        """A new tentative track, observed now."""
        who = Existence(self.tentative_id(), self.now_s, self.now_s)
        self.note(who.track_id, "spawned", reason, value)
        return who

    def confirm(self, who: Existence, reason: str, value: float = math.nan) -> None:
        """A tentative track is a person."""
        if not who.confirmed:
            was, who.track_id, who.confirmed = who.track_id, self.person_id(), True
            self.note(who.track_id, "confirmed", reason, value, was=was)

    def observe(self, who: Existence, reason: str = "", value: float = math.nan, terms: ScoreTerms = NO_TERMS) -> None:
        """The track is observed in this frame; a lost one is reacquired, for the reason given."""
        if who.lost:
            self.note(who.track_id, "reacquired", reason, value, terms)
        elif reason:
            self.note(who.track_id, "matched", reason, value, terms)
        who.observed, who.observed_s = True, self.now_s

    def miss(self, who: Existence, reason: str, value: float = math.nan, terms: ScoreTerms = NO_TERMS) -> None:
        """The track is not observed in this frame; a confirmed one is lost from now on."""
        if who.confirmed and who.observed:
            self.note(who.track_id, "lost", reason, value, terms)
        who.observed = False

    def pause(self, who: Existence, dt_s: float) -> None:
        """The frame, ``dt_s`` after the last one, shows nothing: nobody has been looked for."""
        self.miss(who, "the frame shows nothing")
        who.observed_s += dt_s

    def prune(self, who: Existence, reason: str, value: float = math.nan) -> None:
        """The track ends; the tracker forgets it."""
        self.note(who.track_id, "pruned", reason, value)

    def unobserved_s(self, who: Existence) -> float:
        """Time since the last observation [s]."""
        return self.now_s - who.observed_s

    def age_s(self, who: Existence) -> float:
        """Time since the track was spawned [s]."""
        return self.now_s - who.spawned_s
