"""YAML as calibration tools write it, without ever building an object the file names."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import yaml

from calib.text import MAX_DEPTH

_HEADER = re.compile(r"\A%YAML[ :][0-9.]+[^\n]*\n", re.MULTILINE)
MAX_CHARACTERS = 100_000
"""A calibration in YAML has a few thousand; the parser takes a second for so many."""
_OPENCV_TAG = re.compile(r"!!opencv-[a-z-]+")


class _PlainLoader(yaml.SafeLoader):
    """Values only: without references, by which a small file can stand for gigabytes, and of limited depth."""

    _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """One value; those inside it are composed by the same method."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("a reference (*name)")
        if self._depth >= MAX_DEPTH:
            raise yaml.YAMLError(f"values nested deeper than {MAX_DEPTH}")
        self._depth += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1


def parse_yaml(text: str) -> Mapping[str, Any]:
    """A YAML mapping; OpenCV's ``%YAML:1.0`` header (any style) and its tags are taken off first.

    Raises:
        ValueError: not YAML, or no mapping at the top.
    """
    if len(text) > MAX_CHARACTERS:
        raise ValueError(f"expected YAML of up to {MAX_CHARACTERS} characters, found {len(text)}")
    plain = _OPENCV_TAG.sub("", _HEADER.sub("", text.lstrip()))
    try:
        data = yaml.load(plain, _PlainLoader)
    except yaml.YAMLError as error:
        raise ValueError(f"expected YAML, found {' '.join(str(error).split())}") from error
    # PyYAML's own constructors leak these on odd scalars such as "!!bool x" or a day 99, and on deep nesting.
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        raise ValueError(f"expected YAML, found a value that cannot be read ({type(error).__name__})") from error
    if not isinstance(data, Mapping):
        raise ValueError("expected YAML with keys at the top")
    return data
