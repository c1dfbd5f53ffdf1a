"""Our own ``rig.toml`` among the foreign formats."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from calib.formats.source import Choice, Format, Source
from calib.rig import StereoRig, parse_rig, save_rig

_TABLE = re.compile(r"^\s*\[right_SE3_left\]", re.MULTILINE)


def _part(source: Source) -> str | None:
    return "whole" if _TABLE.search(source.text) else None


def _read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    return parse_rig(sources[0].text, sources[0].path.name)


def _write(rig: StereoRig, path: Path) -> list[Path]:
    save_rig(rig, path)
    return [path]


FORMAT = Format("rig", "planview rig.toml", _part, _read, _write, ".toml")
