"""One camera calibrated from standing people (Zhang et al. 2008, section 3)."""
