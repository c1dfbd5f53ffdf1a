"""Trajectories of a finished recording, decided over the whole of it: the future is known."""
