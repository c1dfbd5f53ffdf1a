"""What an object carries from frame to frame, as values with names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar


class Carried:
    """An object that says what it carries from frame to frame, so that an interrupted run resumes."""

    CARRIED: ClassVar[tuple[str, ...]] = ()
    """Names of the attributes; all of the object where there are none."""

    def state(self) -> dict[str, Any]:
        """By name, numbers, texts and arrays, and groups and records of these."""
        return {name: vars(self)[name] for name in self.CARRIED or vars(self)}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Continue from the state of an object with the same parameters."""
        vars(self).update(state)
