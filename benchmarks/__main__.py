"""The benchmarks' command line: ``python -m benchmarks NAME``."""

from __future__ import annotations

from collections.abc import Sequence

from cyclopts import App, Parameter

from planview.cli import main

BENCHMARKS = {
    "suite": "Render the scenes of a seed, track and score them.",
    "claims": "Compare what tracks say of themselves with the truth of rendered scenes.",
    "real": "Score every real recording with truth, and the baseline of height peaks.",
    "jitter": "Print how far scores spread when times and depths change by less than their errors.",
    "speed": "Time the engine and its start.",
    "counting": "Score counts and occupancy on rendered recordings.",
    "pets": "Score the single-camera trackers on PETS S2-L1 view 1.",
    "calibration": "Score calibration from people, and of several rigs, against known truth.",
    "doctor": "Make faults in healthy recordings and print which of them are named.",
}


def _shown(value: object) -> str | None:
    """A default as the help shows it; None hides that there is none."""
    return str(value) if value else None


def make_app(words: Sequence[str] = ()) -> App:
    """The command tree; a benchmark's module is imported when it is called, or named for its whole help."""
    app = App(
        name="benchmarks",
        help="Measure speed and accuracy on this machine.",
        default_parameter=Parameter(negative_iterable=(), show_default=_shown),
    )
    for name, text in BENCHMARKS.items():
        app.command(f"benchmarks.{name}:{name}", name=name, help=None if name in words else text)
    return app


if __name__ == "__main__":
    main(make=make_app)
