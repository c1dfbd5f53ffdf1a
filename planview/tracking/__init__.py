"""Trackers behind one protocol."""
