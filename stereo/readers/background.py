"""Decoding in a background thread: a few frames ahead, or the newest ones of a camera that does not wait."""

from __future__ import annotations

import queue
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable
from typing import TypeVar

T = TypeVar("T")

_DEPTH = 8
"""Items decoded ahead: bridges a slow key frame, and holds at most 8 frames of memory."""


class _End:
    def __init__(self, error: BaseException | None) -> None:
        self.error = error


def prefetch(items: Iterable[T], depth: int = _DEPTH) -> Generator[T, None, None]:
    """The same items, made by a background thread at most ``depth`` ahead.

    An exception of the source is raised here, in its place. Leaving the iteration early stops the thread, which closes
    the source where that is a generator.
    """
    ready: queue.Queue[T | _End] = queue.Queue(maxsize=depth)
    stop = threading.Event()
    thread = threading.Thread(target=_work, args=(items, ready, stop), daemon=True, name="prefetch")
    thread.start()
    try:
        while not isinstance(item := ready.get(), _End):
            yield item
        if item.error is not None:
            raise item.error
    finally:
        stop.set()
        thread.join(timeout=5.0)


def _work(items: Iterable[T], ready: queue.Queue[T | _End], stop: threading.Event) -> None:
    error: BaseException | None = None
    iterator = iter(items)
    try:
        for item in iterator:
            if not _put(ready, item, stop):
                break
    except BaseException as caught:
        error = caught
    finally:
        if isinstance(iterator, Generator):
            iterator.close()
    _put(ready, _End(error), stop)


def _put(ready: queue.Queue[T | _End], item: T | _End, stop: threading.Event) -> bool:
    while not stop.is_set():
        try:
            ready.put(item, timeout=0.1)
            return True
        except queue.Full:
            continue
    return False


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
