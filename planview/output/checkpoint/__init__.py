"""Checkpoints of a run: what an engine carries from frame to frame, written so that a run can go on after a kill."""
