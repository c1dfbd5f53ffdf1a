"""The demo clip at half its frame rate: what is learned and forgotten depends on seconds, not on frames."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from planview.engine.config import Config
from planview.engine.setup import set_up
from planview.engine.stereo import stereo_engine
from planview.evaluation.evaluate import evaluate_tracks
from planview.synthetic.assets import DEMO
from planview.trajectories.table import TrajectoryCollector, read_truth
from stereo.readers import open_recording
from stereo.recording import StereoFrame, StereoRecording


class EverySecondFrame:
    """A recording without its odd frames, with the timestamps of the even ones."""

    def __init__(self, recording: StereoRecording) -> None:
        self._recording = recording

    def __iter__(self) -> Iterator[StereoFrame]:
        for frame in self._recording:
            if frame.index % 2 == 0:
                yield replace(frame, index=frame.index // 2)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._recording, name)


def test_demo_clip_at_half_its_frame_rate_is_tracked_without_a_significant_error() -> None:
    recording, config, tracks = open_recording(DEMO), Config(), TrajectoryCollector()
    for result in stereo_engine(EverySecondFrame(recording), config, setup=set_up(recording, config)):
        tracks.add(result.frame, result.timestamp_s, result.tracks)
    truth = read_truth(DEMO / "truth.csv")
    truth = truth.where(truth.frame % 2 == 0)
    scores = evaluate_tracks(tracks.trajectories(), replace(truth, frame=truth.frame // 2))
    assert not scores.significant
    assert scores.position_error_m.mean() < 0.075
