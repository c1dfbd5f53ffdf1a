"""Trajectories: one person in one frame, tables of them, and the file layouts they come in."""
