"""What parts of the engine are worth: switch them off by name and compare.

``python -m benchmarks ablation`` does the same on many recordings, with intervals.

Run: python examples/ablation.py [RECORDING]
"""

import sys
from collections.abc import Sequence

import planview

CHOSEN = ("height only", "occupancy only", "joint search off")
"""Of ``planview.ABLATIONS``; the first two are those of Harville 2002."""


def main(recording: str = "data/synthetic/demo", frames: int = 0, names: Sequence[str] = CHOSEN) -> None:
    """Print the scores of the engine as it is and of every variant."""
    for name in (None, *names):
        tracks = planview.run(recording, ablation=name, frames=frames)
        last = int(tracks.frame.max()) if len(tracks) else 0
        scores = planview.evaluate(tracks, recording, frames=(0, last)).to_json()
        errors = scores["significant_errors"]["total"]
        print(f"{name or 'as configured':24} mota {scores['mota']:6.2f}  significant errors {errors}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
