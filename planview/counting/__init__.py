"""Tripwires and zones: what tracks mean for counting."""
