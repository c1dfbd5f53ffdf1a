"""Likelihood of every pixel given people at some places, and following them by it; for trackers to build on."""
