"""Metrics on trajectories only: no images, no maps."""
