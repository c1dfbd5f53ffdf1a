"""Another stereo matcher: OpenCV's plain block matching in place of SGBM.

A matcher is anything that is called with a rectified pair and gives the disparity of the left image
(``planview.Matcher``); there is nothing to inherit from.

Run: python examples/own_matcher.py [RECORDING]
"""

import sys

import cv2
import numpy as np
import numpy.typing as npt

import planview


class BlockMatcher:
    """StereoBM over a fixed number of disparities."""

    def __init__(self, n_disparities: int = 96) -> None:
        self._matcher = cv2.StereoBM.create(n_disparities, 15)

    def __call__(self, left_grey: npt.NDArray[np.uint8], right_grey: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
        """(H, W) float32 disparity [px], NaN where there is none; OpenCV gives sixteenths."""
        disparity = np.asarray(self._matcher.compute(left_grey, right_grey), dtype=np.float32) / np.float32(16)
        return np.where(disparity > 0, disparity, np.float32(np.nan))


def main(recording: str = "data/synthetic/demo", *, frames: int | None = None) -> None:
    """Track with block matching and score against the recording's truth."""
    tracks = planview.run(recording, matcher=BlockMatcher(), frames=frames)
    last = int(tracks.frame.max()) if len(tracks) else 0
    scores = planview.evaluate(tracks, recording, frames=(0, last)).to_json()
    people = set(tracks.track_id[tracks.state == "confirmed"])
    print(f"block matching: {len(people)} people, mota {scores['mota']:.2f}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
