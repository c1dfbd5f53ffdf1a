"""The benchmarks' command line: ``python -m benchmarks NAME``."""

from __future__ import annotations

from collections.abc import Sequence

from cyclopts import App

from planview.cli import main, register_group

BENCHMARKS = {
    "heads": "Align two heads by people who walk, and track with both against each alone.",
    "speed": "Time every stage side by side with plain OpenCV.",
    "accuracy": "Render every committed scene, track it and score it.",
    "suite": "Render challenges drawn from a seed, track and score them.",
    "ablation": "Switch parts of the engine off and compare the variants.",
    "results": "Write the page of results from what suite and ablation measured.",
    "memory": "Watch the memory of a long run.",
    "calibration": "Score board, floor and human calibration against known truth.",
    "counting": "Score counts and occupancy on rendered and real recordings.",
    "foreground": "Share of wrong foreground pixels beside OpenCV, by condition.",
    "pets": "Score the single-camera trackers on PETS S2-L1 view 1.",
    "resume": "Kill runs at random moments, resume them, and compare their results.",
    "tables": "Time count, evaluate and report of a run of many rows.",
    "study": "Time studies on one and two processes, from maps, and finished.",
    "trackers": "Compare the three trackers on the same recordings.",
}


def make_app(words: Sequence[str] = ()) -> App:
    """The command tree."""
    app = App(name="benchmarks", help="Measure speed and accuracy on this machine.", default_parameter=None)
    return register_group(app, "bench", "benchmarks.commands", BENCHMARKS, words)


def main_benchmarks(argv: list[str] | None = None) -> None:
    """Run a benchmark; exit statuses are those of ``planview``."""
    main(argv, make_app)


if __name__ == "__main__":
    main_benchmarks()
