"""People: foreground, plan-view maps, trackers, analytics and evaluation."""
