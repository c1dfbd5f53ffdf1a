"""Runs over recordings: the loop that writes results, the output folder, progress, and what is made of a run."""
