"""The newest frame of a camera that does not wait."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Generator

from stereo.readers.source import Decoded

KEPT = 2
"""Frames kept while the last one is tracked."""
_WHY = "came while earlier frames were tracked"


def newest(frames: Generator[Decoded, None, None]) -> Generator[Decoded, None, None]:
    """The frames, taken as they come by a background thread; of those that nothing waited for the oldest are dropped.

    A dropped frame is yielded without an image. Leaving the iteration early stops the thread.
    """
    kept: deque[Decoded] = deque()
    state = _State()
    thread = threading.Thread(target=_take, args=(frames, kept, state), daemon=True, name="newest")
    thread.start()
    next_index = 0
    try:
        while True:
            with state.changed:
                state.changed.wait_for(lambda: kept or state.ended)
                if not kept:
                    break
                frame = kept.popleft()
            yield from (Decoded(lost, None, None, _WHY) for lost in range(next_index, frame.index))
            yield frame
            next_index = frame.index + 1
        if state.error is not None:
            raise state.error
    finally:
        state.stop = True
        thread.join(timeout=15.0)


class _State:
    """What the two threads share."""

    def __init__(self) -> None:
        self.changed = threading.Condition()
        self.ended = self.stop = False
        self.error: BaseException | None = None


def _take(frames: Generator[Decoded, None, None], kept: deque[Decoded], state: _State) -> None:
    try:
        for frame in frames:
            with state.changed:
                kept.append(frame)
                while len(kept) > KEPT:
                    kept.popleft()
                state.changed.notify()
            if state.stop:
                break
    except BaseException as error:
        state.error = error
    finally:
        frames.close()
        with state.changed:
            state.ended = True
            state.changed.notify()
