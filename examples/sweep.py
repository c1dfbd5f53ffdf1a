"""One parameter over a range: the recording is set up once, then tracked with every value.

``planview sweep STUDY.toml`` does this for many parameters and recordings, in processes or on a cluster, and never
computes a run twice (docs/scale.md).

Run: python examples/sweep.py [RECORDING] > cells.csv
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import planview


def main(
    recording: str = "data/synthetic/demo", frames: int = 0, cells_m: Sequence[float] = (0.02, 0.04, 0.08)
) -> None:
    """Print a CSV: side of a map cell, MOTA, mean position error."""
    opened = planview.open_recording(Path(recording))
    setup = planview.set_up(opened, planview.Config())
    print("cell_m,mota,position_error_m")
    for cell_m in cells_m:
        config = planview.load_config(overrides=[f"maps.cell_m={cell_m}"])
        tracks = planview.run(planview.stereo_engine(opened, config, setup=setup), frames=frames)
        last = int(tracks.frame.max()) if len(tracks) else 0
        scores = planview.evaluate(tracks, recording, frames=(0, last)).to_json()
        print(f"{cell_m},{scores['mota']:.3f},{scores['position_error_mean_m'] or float('nan'):.3f}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
