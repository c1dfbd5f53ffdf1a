"""People who were lost inside the view and have not been seen to leave it.

Nobody vanishes: people come and go over the border of the view, or through entrances inside it that are learned. Who is
lost elsewhere is still there, and who appears elsewhere was there before (our choice; the paper forgets lost targets).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from calib.types import F64
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.pruning import PERSON_PATIENCE
from planview.tracking.human_model.scene import ModelScene
from planview.tracking.human_model.target import Target

TWICE = 2
"""People who must have appeared at an entrance for it to be one (our choice): one may just have been overlooked."""


class Missing:
    """Keeps in mind who is missing, and where people come in.

    Args:
        params: of the tracker.
        scene: tells what part of a person is inside the image.
    """

    def __init__(self, params: HumanModelParams, scene: ModelScene) -> None:
        self._params, self._scene = params.prune, scene
        self.reset()

    def reset(self) -> None:
        """Nobody is missing, and no entrance is known."""
        self._people: list[Target] = []
        self._hidden: list[Target] = []
        self._appeared: list[F64] = []

    def __iter__(self) -> Iterator[Target]:
        return iter(tuple(self._people))

    @property
    def hidden(self) -> tuple[Target, ...]:
        """Those who may still be in the view, hidden by others."""
        return tuple(self._hidden)

    def keep(self, target: Target) -> bool:
        """Keep a person in mind who is no longer looked for; whether that person may still be in the view."""
        inside = target.existence.lost and target.inside == 1.0
        if not inside or self._at_entrance(target.seen_m):
            return False
        self._people.append(target)
        self._hidden.append(target)
        return True

    def remove(self, target: Target) -> None:
        """A person is no longer missing, if so before."""
        self._people = [person for person in self._people if person is not target]
        self._hidden = [person for person in self._hidden if person is not target]

    def forgotten(self, now_s: float) -> list[Target]:
        """Those who have been missing for as long as a person may stay motionless; they are not kept any longer."""
        limit_s = PERSON_PATIENCE * self._params.inanimate_s
        old = [target for target in self._people if now_s - target.existence.observed_s > limit_s]
        for target in old:
            self.remove(target)
        return old

    def watch(self, observed: Sequence[Target]) -> None:
        """Who is hidden is hidden by somebody: with nobody left within ``prune.vanished_m``, a missing person has gone.

        Such a person left behind others, and is kept in mind all the same, since the scene may hide people, too.
        """
        reach_m, places = self._params.vanished_m, [target.xy_m for target in observed]
        self._hidden = [p for p in self._hidden if any(math.dist(p.seen_m, xy_m) <= reach_m for xy_m in places)]

    def learn(self, newcomer: Target) -> None:
        """A person who appears inside the view while nobody is missing has come in there."""
        xy_m = newcomer.build.origin_m
        if not self._people and not newcomer.splits and self._whole(xy_m):
            self._appeared.append(xy_m)

    def who_appears(
        self, newcomer: Target, lost: Sequence[Target], likeness: Callable[[Target], float]
    ) -> Target | None:
        """The missing person whom a new target shows, the nearest who looks alike; None for a newcomer.

        Args:
            newcomer: not confirmed yet.
            lost: people who are still looked for.
            likeness: of a target's memory to the new target; NaN where it is not known.
        """
        xy_m = newcomer.build.origin_m
        if not self._whole(xy_m) or self._at_entrance(xy_m):
            return None
        since_s = newcomer.existence.spawned_s
        before = [t for t in lost if t.existence.observed_s < since_s and t.inside == 1.0]
        near = sorted((*self._people, *before), key=lambda t: math.dist(t.seen_m, xy_m))
        return next((t for t in near if not likeness(t) < self._params.min_likeness), None)

    def _whole(self, xy_m: F64) -> bool:
        """Whether all of a person at a (2,) floor point is inside the image."""
        return self._scene.visibility(self._scene.model_map.camera.project(np.append(xy_m, 0.0))) == 1.0

    def _at_entrance(self, xy_m: F64) -> bool:
        near = [place for place in self._appeared if math.dist(place, xy_m) <= self._params.vanished_m]
        return len(near) >= TWICE
