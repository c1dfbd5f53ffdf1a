"""``planview report``."""

from __future__ import annotations

from pathlib import Path

from calib.errors import InputError
from planview.output.progress import PlainConsole
from planview.output.report.compare import write_comparison
from planview.output.report.page import write_report


def report(*folders: Path, out: Path | None = None, truth: Path | None = None) -> None:
    """Write report.html of a run again, or one page that compares several runs: settings, errors, time.

    Example: planview report out

    Example of a comparison: planview report out/narrow out/wide --out compare.html

    Parameters
    ----------
    folders
        Output folders of runs.
    out
        Page that compares them; compare.html here when not given. The page of one run is report.html in its folder.
    truth
        True people; truth.csv of each recording when not given.
    """
    if not folders:
        raise InputError("planview report: expected the folder of a run, found none")
    if len(folders) == 1 and out is not None:
        raise InputError("--out: expected several runs with it (the page of one is report.html in its folder)")
    if len(folders) == 1:
        page = write_report(folders[0], truth=truth)
    else:
        page = out or Path("compare.html")
        page.parent.mkdir(parents=True, exist_ok=True)
        write_comparison(folders, page, truth)
    PlainConsole(stderr=True, soft_wrap=True).print(str(page))
