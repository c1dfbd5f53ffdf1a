"""Plan-view maps of height and occupancy (Harville 2002, section 3)."""
