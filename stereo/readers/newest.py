"""The newest frame of a camera that does not wait."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Generator
from typing import TypeVar

T = TypeVar("T")

KEPT = 2
"""Frames kept while the last one is tracked."""


def newest(
    frames: Generator[T, None, None], kept_max: int = KEPT, dropped: Callable[[T], None] = lambda frame: None
) -> Generator[T, None, None]:
    """The frames, taken as they come by a background thread; of those that nothing waited for the oldest are dropped.

    Leaving the iteration early stops the thread.

    Args:
        kept_max: frames kept while the last one is tracked.
        dropped: takes every frame that is dropped, in the thread.
    """
    kept: deque[T] = deque()
    state = _State()

    def put(frame: T) -> None:
        kept.append(frame)
        while len(kept) > kept_max:
            dropped(kept.popleft())

    thread = threading.Thread(target=_take, args=(frames, put, state), daemon=True, name="newest")
    thread.start()
    try:
        while True:
            with state.changed:
                state.changed.wait_for(lambda: kept or state.ended)
                if not kept:
                    break
                frame = kept.popleft()
            yield frame
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


def _take(frames: Generator[T, None, None], put: Callable[[T], None], state: _State) -> None:
    try:
        for frame in frames:
            with state.changed:
                put(frame)
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
