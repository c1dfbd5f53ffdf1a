"""A recording of several rigs in one world: their frames side by side in time."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

from calib.errors import InputError
from calib.world import load_rigs
from stereo.readers.base import AnyRecording
from stereo.readers.open import open_any, rigs_file
from stereo.recording import RgbdFrame, Skipped, StereoFrame, assumed_clock, prefetch

AnyFrame = StereoFrame | RgbdFrame


@dataclass(frozen=True, eq=False)
class MultiRigFrame:
    """The frames of moment ``index``, from 0: their mean time on the common clock [s since the first frame of the
    earliest rig], and one frame per rig, None for a rig without a frame at that time."""

    index: int
    timestamp_s: float
    frames: tuple[AnyFrame | None, ...]


@dataclass(frozen=True, eq=False)
class RigRecording:
    """One rig of a recording: its folder, its frames on its own clock, and the time of the first on the common one."""

    name: str
    recording: AnyRecording
    start_s: float


class MultiRigRecording:
    """Several stereo recordings of one place; iterate it for its ``MultiRigFrame``.

    Attributes:
        path: the folder with ``rigs.toml``.
        rigs: in the order of ``rigs.toml``; their ``world_SE3_left`` is that of the common world.
        n_frames, fps, skipped: see ``stereo.recording.Recorded``; moments at the rate of the slowest rig.
    """

    def __init__(self, path: Path, rigs: Sequence[RigRecording]) -> None:
        self.path, self.rigs = path, tuple(rigs)
        self.fps = min(rig.recording.fps for rig in rigs)
        self._first_s = min(rig.start_s for rig in rigs)
        ends = [rig.start_s - self._first_s + rig.recording.n_frames / rig.recording.fps for rig in rigs]
        self.n_frames = max(1, round(max(ends) * self.fps))

    def __repr__(self) -> str:
        return f"MultiRigRecording({str(self.path)!r}, {len(self.rigs)} heads, {self.n_frames} frames)"

    @property
    def skipped(self) -> list[Skipped]:
        """Frames that one of the rigs passed over; indices are those of the rig."""
        return [Skipped(s.index, f"{rig.name}: {s.why}") for rig in self.rigs for s in rig.recording.skipped]

    def __iter__(self) -> Iterator[MultiRigFrame]:
        with ExitStack() as stack:
            streams = []
            for rig in self.rigs:
                items: Iterable[AnyFrame] = rig.recording
                frames = stack.enter_context(closing(prefetch(items)))
                streams.append(_Stream(frames, rig.start_s - self._first_s, 1 / rig.recording.fps))
            yield from moments(streams, 1 / self.fps)


class _Stream:
    """A rig's frames with one read ahead."""

    def __init__(self, frames: Generator[AnyFrame, None, None], start_s: float, period_s: float) -> None:
        self._frames, self._start_s = frames, start_s
        self.period_s = period_s
        self.next: AnyFrame | None = next(frames, None)

    @property
    def time_s(self) -> float:
        """Of the next frame on the common clock; infinite after the last."""
        return float("inf") if self.next is None else self.next.timestamp_s + self._start_s

    def take(self, period_s: float) -> AnyFrame | None:
        """The next frame; those after it that come too soon for the common period are passed over."""
        frame, soonest = self.next, self.time_s + period_s - self.period_s / 2
        self.next = next(self._frames, None)
        while self.next is not None and self.time_s < soonest:
            self.next = next(self._frames, None)
        return frame


def moments(streams: Sequence[_Stream], period_s: float) -> Iterator[MultiRigFrame]:
    """Frames by time: the earliest that waits, and those of other rigs taken within 0.6 of the slowest rig's period:
    half of it would let rigs that run half a period apart flicker between together and apart."""
    index = 0
    while any(stream.next is not None for stream in streams):
        until = min(stream.time_s for stream in streams) + 0.6 * period_s
        times = [stream.time_s for stream in streams if stream.time_s <= until]
        frames = tuple(stream.take(period_s) if stream.time_s <= until else None for stream in streams)
        yield MultiRigFrame(index, sum(times) / len(times), frames)
        index += 1


def open_rigs(path: Path) -> MultiRigRecording:
    """Open every rig that ``rigs.toml`` lists."""
    file = rigs_file(path)
    folder, rigs = file.parent, []
    for entry in load_rigs(file):
        if not (folder / entry.folder).exists():
            raise InputError(f"{folder}: expected a recording in {entry.folder!r}, found nothing there")
        recording = open_any(folder / entry.folder)
        recording.world_SE3_left = entry.world_SE3_left
        rigs.append(RigRecording(entry.folder, recording, entry.start_s))
    recordings = [rig.recording for rig in rigs]
    # Recordings without any times have the rate of those that have times, else the lowest.
    fps = min([one.fps for one in recordings if not one.clock.assumed] or [one.fps for one in recordings])
    for recording in recordings:
        if recording.clock.assumed and fps != recording.fps:
            recording.assume(assumed_clock(fps, recording.clock.even, ", as of the other rigs"))
    return MultiRigRecording(folder, rigs)
