"""What parts of the engine are worth: change parameters, or the tracker, and compare.

``python -m benchmarks ablation`` does the same on many recordings, with intervals.

Run: python examples/ablation.py [RECORDING]
"""

import sys
from typing import Literal

import planview

VARIANTS: dict[str, tuple[Literal["joint", "template"], tuple[str, ...]]] = {
    "as configured": ("joint", ()),
    "half the image": ("joint", ("rectify.working_px=320",)),
    "more foreground": ("joint", ("foreground.beta=4",)),
    "template": ("template", ()),
}


def main(recording: str = "data/synthetic/demo", frames: int = 0) -> None:
    """Print the scores of every variant."""
    for name, (tracker, settings) in VARIANTS.items():
        config = planview.load_config(None, settings)
        tracks = planview.run(recording, tracker=tracker, config=config, frames=frames)
        last = int(tracks.frame.max()) if len(tracks) else 0
        scores = planview.evaluate(tracks, recording, frames=(0, last)).to_json()
        errors = scores["significant_errors"]["total"]
        position_m = scores["position_error_mean_m"] or float("nan")
        print(f"{name:16} mota {scores['mota']:6.3f}  position {position_m:.3f} m  significant errors {errors}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
