"""Who is who after people were too close to be told apart by place: their colours decide (our choice)."""

from __future__ import annotations

import numpy as np

from calib.types import F32
from planview.tracking.human_model.params import LifeParams
from planview.tracking.human_model.scene import similarity
from planview.tracking.human_model.target import Target


class Mingling:
    """Remembers who was in occlusion with whom, and finds pairs whose colours say that they were swapped."""

    def __init__(self, params: LifeParams) -> None:
        self.params = params
        self._last_s: dict[tuple[int, int], float] = {}
        self._fresh: dict[int, list[F32]] = {}

    def reset(self) -> None:
        """Forget everybody."""
        self._last_s.clear()
        self._fresh.clear()

    def busy(self, track_id: int) -> bool:
        """Whether this person's identity is in doubt, so that its colours must not be learned."""
        return any(track_id in pair for pair in self._last_s)

    def close(self, first: Target, second: Target, now_s: float) -> None:
        """These two cover each other now."""
        self._last_s[min(first.track_id, second.track_id), max(first.track_id, second.track_id)] = now_s
        self._fresh.pop(first.track_id, None)
        self._fresh.pop(second.track_id, None)

    def see(self, target: Target, colours: F32) -> None:
        """Colours of a person seen alone, while its identity is in doubt."""
        self._fresh.setdefault(target.track_id, []).append(colours)

    def swapped(self, targets: list[Target], now_s: float) -> list[tuple[Target, Target, float]]:
        """Pairs to swap and by how much their colours agree better then; settled pairs are forgotten."""
        known = {t.track_id: t for t in targets}
        found: list[tuple[Target, Target, float]] = []
        for pair, last_s in list(self._last_s.items()):
            if any(i not in known for i in pair) or now_s - last_s > self.params.doubt_s:
                self._settle(pair)
            elif all(len(self._fresh.get(i, ())) >= self.params.looks for i in pair):
                first, second = known[pair[0]], known[pair[1]]
                gain = self._gain(first, second)
                if gain >= self.params.swap_gain:
                    found.append((first, second, gain))
                self._settle(pair)
        return found

    def _gain(self, first: Target, second: Target) -> float:
        if first.colours is None or second.colours is None:
            return 0.0
        a, b = (np.mean(self._fresh[t.track_id], axis=0) for t in (first, second))
        stay = similarity(first.colours, a) + similarity(second.colours, b)
        swap = similarity(first.colours, b) + similarity(second.colours, a)
        return float(np.nan_to_num(swap - stay)) / 2

    def _settle(self, pair: tuple[int, int]) -> None:
        del self._last_s[pair]
        for i in pair:
            if not self.busy(i):
                self._fresh.pop(i, None)
