"""Several stereo heads in one world: each separates its foreground, one tracker follows people in the joint maps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from calib.errors import InputError
from calib.world import RIGS_FILE
from planview.checks.check import Check
from planview.engine.boxes import BodyBoxes
from planview.engine.config import Config
from planview.engine.describe import StereoDescription, stereo_camera_info
from planview.engine.engine import FrameResult, HeadResult, StageClock, beyond
from planview.engine.frames import MatchedFrame, Separated
from planview.engine.info import CameraInfo
from planview.engine.pipeline import AHEAD, Pipeline
from planview.engine.setup import set_up_any
from planview.maps.heads import HeadsMapBuilder
from planview.tracking.base import Observation, Tracker
from stereo.readers.multi_rig import HeadsFrame, HeadsRecording, open_heads
from stereo.recording import prefetch


@dataclass(frozen=True, eq=False)
class MatchedHeads:
    """The rectified and matched pairs of one moment; None for a head without a frame."""

    frame: HeadsFrame
    pairs: tuple[MatchedFrame | None, ...]
    stages_ms: dict[str, float]


class HeadsPipeline(StereoDescription):
    """Rectify, match and separate foreground per head, build joint maps and track: an ``Engine`` for several heads.

    Attributes:
        heads: the stages of every head up to its foreground points.
        recording, config, tracker: see ``Engine``.
        stereo: the first head's pair over the joint grid.
    """

    def __init__(self, recording: HeadsRecording, heads: Sequence[Pipeline], tracker: Tracker, config: Config) -> None:
        """Compose the stages.

        Args:
            heads: one engine per head of the recording, with floors in the common world; their trackers are not used.
        """
        self.recording, self.heads, self.tracker, self.config = recording, tuple(heads), tracker, config
        views, grids = [head.maps.view for head in heads], [head.maps.grid for head in heads]
        try:
            self.maps = HeadsMapBuilder(grids, views, config.maps)
        except ValueError as error:
            raise InputError(f"{recording.path}: expected heads of one place, found them far apart: {error}") from error
        self.stereo = replace(heads[0].stereo, grid=self.maps.grid)
        self._boxes = [BodyBoxes(h.stereo.geometry, h.stereo.floor.world_SE3_left) for h in heads]

    @staticmethod
    def from_recording(
        recording: Path | HeadsRecording, tracker: Tracker, config: Config | None = None
    ) -> HeadsPipeline:
        """Get every head of a recording ready, or of a folder with ``rigs.toml``.

        Raises:
            InputError: no such recording, or a head that cannot be opened.
            WorkError: a head has no usable frame or hardly any disparity.
        """
        config = config or Config()
        recording = open_heads(recording) if isinstance(recording, Path) else recording
        heads = []
        for head in recording.heads:
            setup = replace(set_up_any(head.recording, config), floor_source=RIGS_FILE)
            heads.append(Pipeline(head.recording, setup, config, tracker))
        return HeadsPipeline(recording, heads, tracker, config)

    @property
    def checks(self) -> tuple[Check, ...]:
        """See ``Engine``; those of every head under its name."""
        named = zip(self.recording.heads, self.heads, strict=True)
        return tuple(replace(check, name=f"{head.name}: {check.name}") for head, one in named for check in one.checks)

    def camera_info(self) -> CameraInfo:
        """The first head's camera, with those of all heads."""
        every = [
            stereo_camera_info(engine.stereo).model_copy(update={"name": head.name, "at_m": _place(engine)})
            for head, engine in zip(self.recording.heads, self.heads, strict=True)
        ]
        return every[0].model_copy(update={"heads": every})

    def reset(self) -> None:
        """Forget people, background and feedback."""
        self.tracker.reset()
        for head in self.heads:
            head.reset()

    def step(self, frame: HeadsFrame) -> FrameResult:
        """Track the next moment.

        Raises:
            ValueError: images of another size than the calibration's.
        """
        return self.track(self.prepare(frame))

    def __iter__(self) -> Iterator[FrameResult]:
        """``step`` over the recording from its first moment, but matching runs ahead in its own thread."""
        self.reset()
        yield from self.after(-1)

    def memory(self) -> dict[str, object]:
        """See ``Engine``."""
        memory: dict[str, object] = {"tracker": self.tracker}
        for n, head in enumerate(self.heads):
            memory |= {f"{name}{n}": part for name, part in head.memory().items() if name != "tracker"}
        return memory

    def after(self, frame: int) -> Iterator[FrameResult]:
        """See ``Engine``."""
        with closing(prefetch(self._prepared(frame), AHEAD)) as matched:
            for moment in matched:
                yield self.track(moment)

    def prepare(self, frame: HeadsFrame, clock: StageClock | None = None) -> MatchedHeads:
        """Prepare the pairs of a moment; depends on no other frame."""
        stages = dict(clock.stages_ms) if clock else {}
        pairs = [h.prepare(f) if f is not None else None for h, f in zip(self.heads, frame.frames, strict=True)]
        for pair in pairs:
            _add(stages, pair.stages_ms if pair else {})
        return MatchedHeads(frame, tuple(pairs), stages)

    def track(self, matched: MatchedHeads) -> FrameResult:
        """Foreground of every head, joint maps and people of the next moment."""
        frame, stages = matched.frame, dict(matched.stages_ms)
        found: list[Separated | None] = []
        for head, pair in zip(self.heads, matched.pairs, strict=True):
            clock = StageClock()
            found.append(head.separate(pair, clock) if pair else None)
            _add(stages, clock.stages_ms)
        clock = StageClock(stages)
        maps = self.maps([one.points if one else None for one in found])
        clock.record("maps")
        first, own = matched.pairs[0], found[0]
        pairs = zip(self.heads, found, strict=True)
        views = tuple(head.seen(one, frame.timestamp_s) for head, one in pairs if one is not None)
        observation = Observation(
            frame.index, frame.timestamp_s, first.image if first else None, own.mask if own else None, None, maps,
            views=views,
        )  # fmt: skip
        tracks = self.tracker.update(observation)
        boxed = [tuple(boxes(track) for track in tracks) for boxes in self._boxes]
        for head, one, people in zip(self.heads, found, boxed, strict=True):
            if one is not None:
                head.learn(one, people)
        results = tuple(
            HeadResult(
                head.name,
                pair.picture if pair else None,
                one.mask if one else None,
                one.sampled if one else None,
                people,
                len(one.points.xyz) if one else 0,
            )
            for head, pair, one, people in zip(self.recording.heads, matched.pairs, found, boxed, strict=True)
        )
        clock.record("track")
        return FrameResult(
            frame.index, frame.timestamp_s, results[0].tracks, self.tracker.decisions, observation,
            own.sampled if own else None, clock.stages_ms, results, first.thumbnails if first else None,
            own.measured if own else None, first.picture if first else None,
        )  # fmt: skip

    def _prepared(self, after: int) -> Iterator[MatchedHeads]:
        clock = StageClock()
        for frame in beyond(self.recording, after):
            clock.record("read")
            yield self.prepare(frame, clock)
            clock = StageClock()


def _place(engine: Pipeline) -> tuple[float, float]:
    x, y, _ = engine.stereo.floor.world_SE3_left.translation
    return float(x), float(y)


def _add(stages: dict[str, float], more: dict[str, float]) -> None:
    for stage, duration in more.items():
        stages[stage] = stages.get(stage, 0.0) + duration
