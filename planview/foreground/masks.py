"""Values of the masks that go into and come out of the foreground model."""

from __future__ import annotations

NO_FEEDBACK, PERSON, BACKGROUND = 0, 1, 2
"""Values of a feedback mask: what a tracker knows about each pixel."""

FOREGROUND, NEARER, SHADOW = 255, 191, 127
"""Values of the kernels' mask; background is 0. What is nearer than the background has its colour: only depth tells
it apart. A shadow is one that its colour alone gives away."""
WALKER = 3
"""Feedback for one camera: a person who has left the first place, and so is no ghost of the background."""
