"""The benchmarks' command line: ``python -m benchmarks NAME``."""

from __future__ import annotations

from collections.abc import Sequence

from cyclopts import App

from planview.cli import main

BENCHMARKS = {
    "suite": "Render random challenges of a seed, track and score them.",
    "claims": "Compare what tracks say of themselves with the truth of rendered scenes.",
    "real": "Score every real recording with truth, and the baseline of height peaks.",
    "speed": "Time the engine side by side with plain OpenCV.",
    "counting": "Score counts and occupancy on rendered recordings.",
    "damaged": "Put frames that show nothing into recordings, and score the trackers.",
    "pets": "Score the single-camera trackers on PETS S2-L1 view 1.",
    "calibration": "Score board, floor and human calibration against known truth.",
    "doctor": "Make faults in healthy recordings and print which of them are named.",
}


def make_app(words: Sequence[str] = ()) -> App:
    """The command tree; a benchmark's module is imported when it is called, or named for its whole help."""
    app = App(name="benchmarks", help="Measure speed and accuracy on this machine.", default_parameter=None)
    for name, text in BENCHMARKS.items():
        module = "real" if name == "pets" else name
        app.command(f"benchmarks.{module}:{name}", name=name, help=None if name in words else text)
    return app


def main_benchmarks(argv: list[str] | None = None) -> None:
    """Run a benchmark; exit statuses are those of ``planview``."""
    main(argv, make_app)


if __name__ == "__main__":
    main_benchmarks()
