"""Recordings from disk: image folders, video pairs and side-by-side videos."""

from stereo.readers.opening import open_recording, open_video

__all__ = ["open_recording", "open_video"]
