"""Runs over recordings: the loop that writes results, the output folder, progress, sweeps."""
