"""The benchmarks' command line: ``python -m benchmarks NAME``."""

from __future__ import annotations

from collections.abc import Sequence

from cyclopts import App, Parameter

from planview.cli import first_lines, main

BENCHMARKS = ("suite", "claims", "real", "jitter", "things", "speed", "counting", "pets", "calibration", "doctor")


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
    lines = first_lines("benchmarks")
    for name in BENCHMARKS:
        app.command(f"benchmarks.{name}:{name}", name=name, help=None if name in words else lines[name])
    return app


if __name__ == "__main__":
    main(make=make_app)
