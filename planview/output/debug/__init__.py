"""A run again with a parameter changed, up to one frame."""
