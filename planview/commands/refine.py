"""``planview refine``."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

from planview.commands.options import JsonFlag, checked
from planview.offline.refine import RefineParams
from planview.output.finished import refine_run
from planview.output.progress import PlainConsole

_DEFAULTS = RefineParams()


def refine(
    out: Path,
    *,
    join: float = _DEFAULTS.join_s,
    fill: float = _DEFAULTS.fill_s,
    json_output: JsonFlag = False,
) -> None:
    """Improve the tracks of a finished run: the future of a recording is known.

    Tracks begin where the person appeared, gaps are filled, positions are smoothed backwards, and fragments of one
    person are joined. The online tracks stay beside as tracks_online.csv; refinement.csv gives the reason of every
    change. Counts are not made again: planview count does.

    Example: planview refine out

    Parameters
    ----------
    out
        Folder of a finished run.
    join
        Longest time between two fragments of one person, in seconds; 0 joins none.
    fill
        Longest gap that is filled, in seconds; 0 fills none.
    json_output
        Print the number of changes of each kind as one JSON object.
    """
    refined = refine_run(out, checked(RefineParams, join_s=join, fill_s=fill)).refined
    kinds = Counter(change.kind for change in refined.changes)
    counts = {kind: kinds[kind] for kind in ("join", "begin", "fill", "smooth")}
    if json_output:
        print(json.dumps({"changes": counts, "rows": len(refined.tracks)}))
    else:
        text = ", ".join(f"{kind} {number}" for kind, number in counts.items())
        PlainConsole(stderr=True, soft_wrap=True).print(f"{out / 'tracks.csv'}: {text}")
