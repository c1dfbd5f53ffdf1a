"""Recordings from disk: one file for each layout, recognised by content."""

from stereo.readers.open import find_layout, find_reader, open_any, open_recording, open_video
from stereo.recording import OpenOptions

__all__ = ["OpenOptions", "find_layout", "find_reader", "open_any", "open_recording", "open_video"]
