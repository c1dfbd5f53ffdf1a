"""One parameter over a range: how large must the images be?

``planview sweep STUDY.toml`` does this for many parameters and recordings, in processes or on a cluster, and never
computes a run twice (docs/scale.md).

Run: python examples/sweep.py [RECORDING] > sizes.csv
"""

import sys
from collections.abc import Sequence

import planview


def main(
    recording: str = "data/synthetic/demo", *, frames: int | None = None, sizes_px: Sequence[int] = (240, 320, 640)
) -> None:
    """Print a CSV: longest side of the images that are matched, MOTA, mean position error."""
    print("working_px,mota,position_error_m")
    for size_px in sizes_px:
        tracks = planview.run(recording, config={"rectify.working_px": size_px}, frames=frames)
        last = int(tracks.frame.max()) if len(tracks) else 0
        scores = planview.evaluate(tracks, recording, frames=(0, last))
        found = scores.mota, scores.position_error_mean_m  # None where nobody was tracked
        print(size_px, *("" if value is None else f"{value:.3f}" for value in found), sep=",")


if __name__ == "__main__":
    main(*sys.argv[1:2])
