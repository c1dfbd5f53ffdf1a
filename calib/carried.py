"""State that is carried from frame to frame, as named values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar


class Carried:
    """An object whose state can be saved and restored, so that an interrupted run resumes."""

    CARRIED: ClassVar[tuple[str, ...]] = ()
    """Names of the attributes that are carried from frame to frame; empty for all of them."""

    def reset(self) -> None:
        """Forget what is carried, where that is of use."""

    def state(self) -> dict[str, Any]:
        """The attributes by name: numbers, strings and arrays, and collections and records of these."""
        return {name: vars(self)[name] for name in self.CARRIED or vars(self)}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Continue from the state of an object with the same parameters."""
        vars(self).update(state)
