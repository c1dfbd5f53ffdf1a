"""Tripwires, zones, heat maps: what tracks mean for counting."""
