"""A sensor of one's own: a stereo pair that forgets what is farther away than some metres.

A sensor measures depth, classifies its pixels, and keeps people from becoming background
(``planview.Sensor``). This one wraps the sensor of a pair and changes what it measures; a sensor of your own
would give its depth there. Whoever is farther away is still seen by colour, and followed with a less certain place.

Run: python examples/own_sensor.py [RECORDING]
"""

import sys
from dataclasses import replace
from typing import Any

import numpy as np

import planview


class NearSensor(planview.RigSensor):
    """A pair without depth beyond ``far_m``."""

    def __init__(self, setup: Any, config: planview.Config, far_m: float) -> None:
        super().__init__(setup, config)
        self._least_px = setup.geometry.disparity_at(far_m)

    def measure(self, shot: Any, clock: planview.StageClock) -> planview.Depth:
        """The pair's depth; NaN, as where nothing was matched, for what is too far away."""
        depth = super().measure(shot, clock)
        near = np.where(depth.disparity >= self._least_px, depth.disparity, np.float32(np.nan))
        return replace(depth, disparity=near)


def main(path: str = "data/synthetic/demo", *, far_m: float = 6.0, frames: int = 0) -> None:
    """Track with the sensor of one's own and score against the recording's truth."""
    recording, config = planview.open_recording(path), planview.Config()
    sensor = NearSensor(planview.set_up(recording, config), config, far_m)
    engine = planview.Engine(recording, config, [sensor], planview.JointTracker(config.joint))
    rows = planview.TrajectoryCollector()
    for result in engine:
        if frames and result.frame >= frames:
            break
        rows.add(result.frame, result.timestamp_s, result.tracks)
    tracks = rows.trajectories()
    last = int(tracks.frame.max()) if len(tracks) else 0
    scores = planview.evaluate(tracks, path, frames=(0, last)).to_json()
    print(f"depth up to {far_m} m: mota {scores['mota']:.2f}, switches {scores['switches']}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
