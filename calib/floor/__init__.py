"""The floor plane in points, and the file that keeps it."""
