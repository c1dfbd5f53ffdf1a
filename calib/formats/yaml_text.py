"""YAML as calibration tools write it, without ever building an object the file names."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import yaml

_HEADER = re.compile(r"\A%YAML[ :][0-9.]+[^\n]*\n", re.MULTILINE)
_OPENCV_TAG = re.compile(r"!!opencv-[a-z-]+")


def parse_yaml(text: str) -> Mapping[str, Any]:
    """A YAML mapping; OpenCV's ``%YAML:1.0`` header (any style) and its tags are taken off first.

    Raises:
        ValueError: not YAML, or no mapping at the top.
    """
    plain = _OPENCV_TAG.sub("", _HEADER.sub("", text.lstrip()))
    try:
        data = yaml.safe_load(plain)
    except yaml.YAMLError as error:
        raise ValueError(f"expected YAML, found {' '.join(str(error).split())}") from error
    # PyYAML's own constructors leak these on odd scalars such as "!!bool x" or a day 99, and on deep nesting.
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        raise ValueError(f"expected YAML, found a value that cannot be read ({type(error).__name__})") from error
    if not isinstance(data, Mapping):
        raise ValueError("expected YAML with keys at the top")
    return data
